"""The mass of fracture walls, moved inward: what stays, what goes, and the first accelerations without it."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping
from fracflow.errors import InputError
from fracflow.integrators import STEPPERS
from fracflow.model.solid import mass
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.solve.request import StepRequest

ROCK = {"youngs_modulus": 1.0, "poissons_ratio": 0.25, "density": 2.0}
JOINT = {"normal_stiffness": 100.0, "shear_stiffness": 50.0, "aperture": 1.0, "friction_coefficient": 0.5}
CROSSING = [
    {"name": "steep", "points": [[0.9, 0.0], [2.1, 2.0]]},
    {"name": "flat", "points": [[0.0, 1.1], [3.0, 0.9]]},
    {"name": "tip", "points": [[2.2, 1.5], [2.7, 1.7]]},
]


def _scene(traces=CROSSING, size=0.2, cells="triangles", joint=JOINT, refine=0, **more):
    data = {
        "units": "none",
        "geometry": {"domain": [0, 0, 3, 2], "fracture": traces, "size": size, "cells": cells, "refine": refine},
        "rock": {"rock": ROCK},
        "fracture": {"default": joint},
        "stage": [{"kind": "dynamic", "time_step": 0.1, "steps": 1}],
    }
    return Scene.from_data({**data, **more})


def _model(**more):
    """Operators with the mass moved, and the mass matrix that there was."""
    scene = _scene(**more)
    ops = prepare(scene, MPI.COMM_WORLD).operators
    return ops, mass(ops.blocks, scene, ops.expand)


def _vector(ops, values):
    """A vector with the values (n, 2) of the nodes of this rank."""
    vector, block = ops.layout.solid_vector(), ops.blocks.solid
    first = block.unknown_starts[ops.layout.comm.rank]
    vector.getArray()[block.unknown[: block.owned] - first] = values
    return vector


def _times(matrix, vector):
    result = vector.duplicate()
    matrix.mult(vector, result)
    return result


def _sums(ops, matrix, field):
    """Per block of rock the two sums (p, 2) of M times a field (n, 2)."""
    return _of_blocks(ops, _times(matrix, _vector(ops, field)))


def _of_blocks(ops, forces):
    """Sums (p, 2) of a vector over each block."""
    block, result = ops.blocks.solid, forces.getArray()
    local = result[block.unknown[: block.owned] - block.unknown_starts[ops.layout.comm.rank]]
    total = np.zeros((len(block.piece_rock), 2))
    np.add.at(total, block.piece[: block.owned], local)
    return ops.layout.comm.allreduce(total)


@pytest.mark.parametrize("cells", ["triangles", "quads"])
@pytest.mark.parametrize(("kind", "refine"), [("lumped", 0), ("lumped", 1), ("consistent", 0)])
def test_each_block_keeps_its_mass_and_first_moments_in_every_direction(cells, kind, refine):
    moved, there = _model(cells=cells, refine=refine, method={"mass": kind})
    assert moved.inward is not None
    points = moved.blocks.solid.points[: moved.blocks.solid.owned]
    assert len(moved.blocks.solid.piece_rock) == 4
    for along in np.eye(2):
        for weight in (np.ones(len(points)), *points.T):
            field = weight[:, None] * along
            new, old = _sums(moved, moved.mass, field), _sums(moved, there, field)
            assert new == pytest.approx(old, abs=1e-13 * np.abs(old).max())


def test_walls_keep_their_mass_along_the_fracture_and_lose_it_across():
    level = [{"name": "inclined", "points": [[0.0, 0.4], [3.0, 1.6]]}]
    moved, there = _model(traces=level)
    normal = np.array([-1.2, 3.0]) / np.hypot(1.2, 3.0)
    along = np.array([normal[1], -normal[0]])
    block = moved.blocks.solid
    on_wall = np.zeros(len(block.points), dtype=bool)
    on_wall[np.concatenate([moved.blocks.joints.bottom.ravel(), moved.blocks.joints.top.ravel()])] = True
    random = np.random.default_rng(3).standard_normal(10_000)
    size = np.where(on_wall, random[block.node_ids], 0.0)[: block.owned, None]
    ghosts = moved.layout.comm.allreduce(int(on_wall[block.owned :].sum()))
    if not ghosts:  # walls of other ranks' joints are not known here
        lost = _times(moved.mass, _vector(moved, size * normal))
        assert lost.norm() < 1e-13 * _times(there, _vector(moved, size * normal)).norm()
    field = _vector(moved, size * along)
    assert field.dot(_times(moved.mass, field)) == pytest.approx(field.dot(_times(there, field)), rel=1e-13)


def test_no_motion_has_negative_kinetic_energy():
    moved, _ = _model(cells="quads")
    size = moved.mass.getSize()[0]
    if moved.layout.comm.size == 1:
        mass = moved.mass[:, :]
        values = np.linalg.eigvalsh(mass)
        assert values[0] > -1e-13 * values[-1]
        assert (values < 1e-12 * values[-1]).sum() < size / 2


@pytest.mark.parametrize("opens", [True, False])
def test_walls_that_never_part_keep_theirs(opens):
    springs = {"law": "linear", "normal_stiffness": 100.0, "shear_stiffness": 50.0}
    ops = prepare(_scene(joint=JOINT if opens else springs), MPI.COMM_WORLD).operators
    assert (ops.inward is not None) == opens


@pytest.mark.parametrize(
    ("side", "moves"),
    [
        ({"absorbing": [{"on": ["west"]}]}, False),
        ({"support": [{"on": ["west"], "components": ["x"]}]}, True),
        ({"support": [{"on": ["west"], "components": ["y"]}]}, False),
    ],
    ids=["damped", "held along", "held across"],
)
def test_walls_on_a_side_that_damps_or_holds_them_keep_theirs(side, moves):
    """The walls at the end of a level fracture, whichever ranks have them."""
    ops = prepare(
        _scene(traces=[{"name": "flat", "points": [[0.0, 1.0], [3.0, 1.0]]}], **side), MPI.COMM_WORLD
    ).operators
    block, comm = ops.blocks.solid, ops.layout.comm
    points = block.points[: block.owned]
    at_end = np.isclose(points[:, 1], 1.0) & np.isin(points[:, 0], (0.0, 3.0))
    starts, _, values = ops.inward.getValuesCSR()
    counts = np.diff(np.concatenate([[0], np.cumsum(values != 0.0)])[starts])
    rows = block.unknown[: block.owned, 1] - block.unknown_starts[comm.rank]
    found = comm.allgather(list(zip(points[at_end, 0], counts[rows[at_end]] > 1, strict=True)))
    ends = [end for part in found for end in part]
    assert sorted(ends) == sorted([(0.0, moves), (3.0, True)] * 2)


def test_blocks_too_thin_keep_theirs():
    """One cell across: no node is inside."""
    ops = prepare(_scene([{"name": "a", "points": [[0, 1], [3, 1]]}], 1.0, "quads"), MPI.COMM_WORLD).operators
    assert ops.inward is None


@pytest.mark.parametrize("stepper", ["newmark", "hht", "generalised-alpha", "implicit-euler"])
def test_every_block_falls_from_the_first_instant_and_walls_with_it(stepper):
    """The centre of mass of each block is accelerated by the force on it; walls go with what carries their mass."""
    sides = ["west", "east", "south", "north"]
    pressed = {"initial_stress": {"xx": -10, "yy": -10}, "load": [{"on": sides, "traction": "initial-stress"}]}
    model = prepare(_scene(method={"stepper": stepper}, body_force={"x": 0.6, "y": -1.4}, **pressed), MPI.COMM_WORLD)
    stepping, rule, state, ops = Stepping(model), STEPPERS[stepper](), equilibrium_state(model), model.operators
    state = stepping.enter(state, rule, 0.1)
    one = np.ones((ops.blocks.solid.owned, 1))
    masses = _sums(ops, ops.mass, one * [1.0, 1.0])
    assert _of_blocks(ops, _times(ops.mass, state.motion.acceleration)) == pytest.approx(
        masses * [0.3, -0.7], rel=1e-11
    )
    for step in range(1, 41):
        state, _ = stepping.step(state, StepRequest(0.1 * step, 0.1, {}, stepping.model.loads), rule)
        followed = _times(ops.inward, state.motion.acceleration).getArray()
        assert state.motion.acceleration.getArray() == pytest.approx(followed, abs=1e-12)
        assert np.abs(followed).max(initial=0.0) < 1.5  # nothing rings
    stepping.destroy()


def test_lumped_where_walls_need_their_mass():
    fluid = {"viscosity": 1e-3, "specific_weight": 1.0}
    assert _scene().method.contact == "redistributed"
    assert _scene(fluid=fluid).method.contact == "lumped"
    assert _scene(model="report").method.contact == "lumped"
    assert _scene(method={"stepper": "explicit"}).method.contact == "lumped"
    with pytest.raises(InputError, match=r'method\.contact.* fluid.* use "lumped"'):
        _scene(fluid=fluid, method={"contact": "redistributed"})
    with pytest.raises(InputError, match=r'method\.contact.*stepper = "explicit", which needs "lumped"'):
        _scene(method={"contact": "redistributed", "stepper": "explicit"})
