"""All that rank 0 finds on the near cells of a mesh, and ranks on their own cells, is as on the whole mesh."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from test_cut import _grid

from fracflow._petsc import MPI
from fracflow.diagnostics import pre_run_checks
from fracflow.diagnostics.joints import gather
from fracflow.diagnostics.well_parts import parts_with_wells
from fracflow.errors import InputError
from fracflow.mesh.cut_mesh import cut_mesh, near_mesh
from fracflow.mesh.distribute import distribute
from fracflow.mesh.near_cells import with_near_first
from fracflow.mesh.rock_cells import RockCells
from fracflow.mesh.split import split
from fracflow.mesh.store import load_mesh, save_mesh
from fracflow.model.setup import fitting, looked_at, place
from fracflow.output.catalogue import fault_ends
from fracflow.reduction.unresolved import WeakJoints, unresolved
from fracflow.scene.scene import Scene

COMM = MPI.COMM_WORLD
LAW = {
    "law": "slip-weakening", "normal_stiffness": 1e9, "shear_stiffness": 1e9, "aperture": 1e-3,
    "friction_coefficient": 0.6, "dynamic_friction_coefficient": 0.3, "slip_weakening_distance": 1e-4,
}  # fmt: skip
SCENE = {
    "mesh": {"file": "grid.msh", "refine": 2},
    "rock": {
        "soft": {"youngs_modulus": 1e9, "poissons_ratio": 0.25, "density": 2500.0},
        "hard": {"rigid": True, "density": 3000.0},
    },
    "initial_stress": {"xx": -5e5, "yy": -8e5, "zz": -6e5, "xy": 1e5},
    "fluid": {"viscosity": 1e-3, "specific_weight": 9810.0, "flow_depth": 1.0},
    "fracture": {"default": LAW},
    "support": [{"on": ["west"]}, {"on": ["south"]}],
    "absorbing": [{"on": ["west"]}],
    "well": [
        {"name": "in", "at": {"fracture": "steep", "end": "start"}, "flow_rate": 1e-3},
        {"name": "out", "at": {"fracture": "short", "end": "end"}, "pressure": 1e5},
    ],
    "probe": [
        {"name": "rock", "at": [1.6, 4.1]},
        {"name": "corner", "at": "corner"},
        {"name": "on it", "at": [2.1, 2.5], "on": "flat"},
    ],
    "stage": [{"kind": "auto", "time_step": 1.0, "dynamic_time_step": 1e-4, "end": 1.0}],
}  # fmt: skip


def _meshes(scene):
    """Near cells, and all cells without a trace of how they were made."""
    coarse = replace(split(_grid()), cuts=2)
    coarse = with_near_first(coarse, looked_at(scene, coarse))
    return near_mesh(coarse), replace(cut_mesh(coarse), coarse=None)


def _assert_same(one, other):
    if is_dataclass(one) and not isinstance(one, type):
        for field in fields(one):
            _assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            _assert_same(one[key], other[key])
    elif isinstance(one, tuple | list):
        assert len(one) == len(other)
        for each in zip(one, other, strict=True):
            _assert_same(*each)
    elif isinstance(one, np.ndarray) and one.dtype.kind in "fib":
        np.testing.assert_allclose(one, other, rtol=1e-12)
    else:
        assert one == other or one == pytest.approx(other, rel=1e-12)


@pytest.mark.serial
def test_places_and_checks():
    scene = Scene.from_data(SCENE)
    near, whole = _meshes(scene)
    assert len(near.cells) < 0.9 * len(whole.cells)
    placed = place(scene, near)
    _assert_same(placed, place(scene, whole))
    _assert_same(gather(scene, near, placed.wells), gather(scene, whole, placed.wells))
    _assert_same(pre_run_checks(scene, near, placed.wells), pre_run_checks(scene, whole, placed.wells))
    _assert_same(parts_with_wells(near, placed.wells), parts_with_wells(whole, placed.wells))
    _assert_same(*(fault_ends(scene, mesh, np.zeros(0, dtype=int)) for mesh in (near, whole)))


def test_each_rank_measures_its_cells():
    scene = Scene.from_data(SCENE)
    near, whole = _meshes(scene)
    wells = place(scene, whole).wells
    blocks = distribute(near if COMM.rank == 0 else None, COMM, ["hard"])
    cells = RockCells.of(blocks.solid, blocks.solid.cell_ids, COMM)
    asked, found = RockCells.of(whole), []
    scale = np.array([2.0, 1.0])
    for each in (cells, asked):
        size, rock, middle = each.largest(scale)
        found.append(
            [size, rock, *middle, *each.used(), *(each.exceeded_in(share) for share in (0.01, 0.1, 0.5, 0.97))]
        )
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    order = np.argsort(asked.size)
    area = np.cumsum(asked.area[order])
    assert found[1][-1] == asked.size[order][np.searchsorted(area, 0.03 * area[-1])]
    lines = unresolved(scene, near if COMM.rank == 0 else None, wells, cells)
    if COMM.rank == 0:
        assert lines == unresolved(scene, whole, wells) != []
    joints, reach = whole.points[whole.joint_bottom].mean(axis=1), np.full(len(whole.joint_flow), 2.0)
    weak = WeakJoints(joints, 0.1 * reach, whole.joint_fracture, reach, len(whole.fractures))
    ours, theirs = weak.beside(cells), weak.beside(asked)
    assert ours.growth == pytest.approx(theirs.growth, rel=1e-12) and (theirs.growth > 0.0).all()
    assert np.array_equal(ours.reach, theirs.reach)


@pytest.mark.serial
def test_a_place_among_other_cells_takes_all_of_them():
    """A probe that was moved in the scene of a run folder."""
    scene = Scene.from_data(SCENE | {"probe": []})
    near, whole = _meshes(scene)
    assert fitting(scene, near) is near
    moved = Scene.from_data(SCENE | {"probe": [{"name": "rock", "at": [1.6, 4.1]}]})
    with pytest.raises(InputError, match="outside the mesh"):
        place(moved, near)
    _assert_same(place(moved, fitting(moved, near)), place(moved, whole))


@pytest.mark.serial
@pytest.mark.parametrize("near", [-2, 10, 10**6])
def test_a_saved_mesh_whose_near_cells_do_not_come_first(tmp_path, near):
    coarse = _meshes(Scene.from_data(SCENE))[0].uncut
    save_mesh(coarse, tmp_path / "mesh.h5")
    _assert_same(load_mesh(tmp_path / "mesh.h5"), near_mesh(coarse))
    save_mesh(replace(coarse, near=near), tmp_path / "mesh.h5")
    with pytest.raises(InputError, match="near is no number of cells that come first"):
        load_mesh(tmp_path / "mesh.h5")
