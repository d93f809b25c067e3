"""A saved mesh that ranks take in slices: the same numbers, blocks and checks as of one that rank 0 has whole."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from resealed import resealed
from test_cut import _grid
from test_near_cells import LAW, SCENE, _assert_same

from fracflow._petsc import MPI
from fracflow.cli.check import set_up
from fracflow.diagnostics import pre_run_checks
from fracflow.diagnostics.joints import gather
from fracflow.errors import InputError
from fracflow.mesh.distribute import distribute
from fracflow.mesh.near_cells import with_near_first
from fracflow.mesh.rock_cells import RockCells
from fracflow.mesh.slices.bisection import bisected
from fracflow.mesh.slices.gathering import sliced_parts, with_all_cells, with_sums_of_cells
from fracflow.mesh.slices.merging import merged_slices
from fracflow.mesh.slices.near_first import with_near_first as near_of
from fracflow.mesh.slices.reading import SavedMesh, frame_of, read, slices_of
from fracflow.mesh.slices.shares import distribute_slices
from fracflow.mesh.split import groups, merged_faces, split
from fracflow.mesh.store import load_mesh, load_split, save_mesh
from fracflow.mesh.whole import blocks_with
from fracflow.model.setup import fractures_of, looked_at, place, places_of
from fracflow.output.catalogue import fault_ends
from fracflow.reduction.prepare import prepare, read_uncut
from fracflow.reduction.sliced import InFile
from fracflow.reduction.unloaded_blocks import parts
from fracflow.reduction.unresolved import unresolved
from fracflow.scene.scene import Scene, load

COMM = MPI.COMM_WORLD
NAMES = ("crossings", "report_5_5", "hard corner")


def _whole(name):
    """A mesh as it is split, its scene and rigid rocks, on every rank."""
    if name == "hard corner":
        scene = Scene.from_data(SCENE | {"mesh": {"file": "grid.h5"}})
        return scene, split(_grid()), ["hard"]
    scene = load(f"meshes/{name}/scene.toml")
    mesh = COMM.bcast(read_uncut(scene)[1] if COMM.rank == 0 else None, root=0)
    return scene, mesh, [name for name, rock in scene.rock.items() if rock.rigid]


def _saved(mesh, path):
    if COMM.rank == 0:
        save_mesh(mesh, path)
    COMM.barrier()
    return path


def _sliced(scene, path, near=-1):
    """Near cells, slices and blocks by the slices of a file."""
    raw = read(COMM, SavedMesh(path, near=near))
    frame = frame_of(raw, fractures_of(scene))
    return near_of(raw, COMM.bcast(places_of(scene, frame) if COMM.rank == 0 else None, root=0))


@pytest.fixture(params=NAMES)
def sliced(request, shared_tmp):
    scene, whole, rigid = _whole(request.param)
    near, slices = _sliced(scene, _saved(whole, shared_tmp / "kept.h5"))
    blocks = distribute_slices(near, slices, rigid)
    return (
        scene,
        with_near_first(whole, looked_at(scene, whole)),
        rigid,
        with_sums_of_cells(near, blocks),
        slices,
        blocks,
    )


def test_numbers_are_those_of_a_whole_mesh_with_its_near_cells_first(sliced):
    _, whole, _, near, slices, blocks = sliced
    if near is not None:
        nodes = len(near.points)
        for name, values in vars(whole).items():
            if name not in ("points", "origin", "cells", "cell_rock", "sums"):
                _assert_same(getattr(near, name), values)
        for name, count in (("points", nodes), ("origin", nodes), ("cells", whole.near), ("cell_rock", whole.near)):
            assert np.array_equal(getattr(near, name), getattr(whole, name)[:count])
    assert np.array_equal(slices.points, whole.points[slices.nodes.numbers])
    assert np.array_equal(slices.cells, whole.cells[slices.number])
    found = with_all_cells(near, blocks)
    if COMM.rank == 0:
        _assert_same(found, whole)


def test_blocks_are_those_of_shares_from_rank_0(sliced):
    _, whole, rigid, _, _, blocks = sliced
    rank = np.empty(len(whole.cells), dtype=np.int64)
    for number, ids in enumerate(COMM.allgather(blocks.solid.cell_ids)):
        rank[ids] = number
    same = distribute(whole if COMM.rank == 0 else None, COMM, rigid, cell_rank=rank)
    for part in ("solid", "joints", "flow", "sizes"):
        _assert_same(getattr(blocks, part), getattr(same, part))
        for name, values in vars(getattr(same, part)).items():
            if isinstance(values, np.ndarray):
                assert getattr(getattr(blocks, part), name).dtype == values.dtype


def test_checks_on_near_cells_are_those_on_all(sliced):
    scene, whole, _, near, _, blocks = sliced
    wells = place(scene, whole).wells
    cells = RockCells.of(blocks.solid, blocks.solid.cell_ids, COMM)
    lines = unresolved(scene, near, wells, cells)
    if near is None:
        return
    _assert_same(place(scene, near), place(scene, whole))
    assert lines == unresolved(scene, whole, wells)
    _assert_same(gather(scene, near, wells), gather(scene, whole, wells))
    _assert_same(pre_run_checks(scene, near, wells), pre_run_checks(scene, whole, wells))
    _assert_same(*(fault_ends(scene, mesh, np.zeros(0, dtype=int)) for mesh in (near, whole)))
    for rock in range(len(whole.rocks)):
        assert np.array_equal(blocks_with(near, rock), blocks_with(whole, rock))
    for tied in (np.zeros((0, 2), dtype=np.int64), np.array([whole.side_facets[0]])):
        (part, piece), (asked, of_nodes) = parts(near, tied), parts(whole, tied)
        assert np.array_equal(part, asked) and np.array_equal(piece, of_nodes[: len(piece)])


def test_a_run_that_goes_on_keeps_its_numbers(sliced, shared_tmp):
    """A mesh as a run leaves it in its folder: near cells first, and no others even where places have moved."""
    scene, whole, rigid, _, slices, blocks = sliced
    near, again = _sliced(scene, _saved(whole, shared_tmp / "mesh.h5"), whole.near)
    same = distribute_slices(near, again, rigid)
    assert np.array_equal(same.solid.cell_ids, blocks.solid.cell_ids)
    assert np.array_equal(same.solid.node_ids, blocks.solid.node_ids)
    assert again.total == slices.total and again.near == whole.near
    if whole.near < len(whole.cells):
        far = whole.points[whole.cells[whole.near][:3]].mean(axis=0)
        raw = read(COMM, SavedMesh(shared_tmp / "mesh.h5", near=whole.near))
        assert near_of(raw, far[None]) is None
        assert near_of(read(COMM, SavedMesh(shared_tmp / "kept.h5")), far[None]) is not None


def test_the_file_of_a_run_is_that_of_the_whole_mesh(sliced, shared_tmp):
    from fracflow.mesh.slabs import on_rank_0

    _, whole, _, near, _, blocks = sliced
    with on_rank_0(COMM, sliced_parts(blocks)) as found:
        if found is not None:
            root = save_mesh(near, shared_tmp / "mesh.h5", found)
            assert root == save_mesh(whole, shared_tmp / "whole.h5")
            _assert_same(load_mesh(shared_tmp / "mesh.h5", root), whole)


def test_cells_are_cut_alike_whichever_rank_has_read_them():
    random = np.random.default_rng(3)
    middle = np.concatenate([random.normal(size=(500, 2)), np.repeat(random.normal(size=(50, 2)), 2, axis=0)])
    middle[:300, 0] = np.round(middle[:300, 0])  # many at one coordinate
    own = np.arange(len(middle)) * COMM.size // len(middle) == COMM.rank
    other = random.integers(COMM.size, size=len(middle)) == COMM.rank
    found = np.zeros((2, len(middle)), dtype=np.int64)
    for row, here in zip(found, (own, other), strict=True):
        row[here] = bisected(middle[here], COMM)
        COMM.Allreduce(MPI.IN_PLACE, row)
    assert np.array_equal(*found)
    assert np.array_equal(found[0][500::2], found[0][501::2])
    counts = np.bincount(found[0], minlength=COMM.size)
    assert np.ptp(counts) <= 4


def _square(count):
    """A mesh of one rock with ``count`` squared cells and a side, on every rank."""
    _, whole, _ = _whole("hard corner")
    at = np.arange(count + 1.0)
    points = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    cells = np.stack([corner, corner + count + 1, corner + count + 2, corner + 1], axis=1)
    none = np.zeros(0, dtype=np.int64)
    return replace(
        whole, points=points, origin=np.arange(len(points)), cells=cells, cell_rock=np.zeros(len(cells), dtype=np.int64),
        joint_bottom=none.reshape(-1, 2), joint_top=none.reshape(-1, 2), joint_cells=none.reshape(-1, 2),
        joint_flow=none.reshape(-1, 2), joint_fracture=none, joint_along=np.zeros((0, 2)), flow_origin=none,
        side_facets=np.stack([np.arange(count), np.arange(1, count + 1)], axis=1), side_cell=np.arange(count),
        side_of=np.zeros(count, dtype=np.int64), named_points={},
    )  # fmt: skip


def test_no_rank_has_more_than_its_part(shared_tmp):
    """Memory of each rank while it reads and distributes 22 500 cells, those at a side near: so much for a cell of its own."""
    large = _square(150)
    path, cells, points = _saved(large, shared_tmp / "large.h5"), large.cells, large.points
    tracemalloc.start()
    near, slices = near_of(read(COMM, SavedMesh(path)), np.zeros((0, 2)))
    blocks = distribute_slices(near, slices)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert blocks.sizes.cells == len(cells) and len(blocks.solid.cells) < 1.1 * len(cells) / COMM.size
    longest = max(len(each) for each in vars(slices).values() if isinstance(each, np.ndarray))
    assert longest <= 1.1 * len(points) / COMM.size
    assert peak < 650 * len(cells) / COMM.size


def test_near_cells_do_not_grow_with_a_rock_that_is_supported(shared_tmp):
    """Rank 0 has the cells at the side and one at the farthest node from it: 21 of 400, 41 of 1600."""
    stage = [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}]
    scene = Scene.from_data({
        "mesh": {"file": "kept.h5"}, "rock": SCENE["rock"], "fracture": {"default": LAW}, "stage": stage,
        "support": [{"on": "soft"}], "load": [{"on": "soft", "force": [1.0, 0.0]}],
    })  # fmt: skip
    for count in (20, 40):
        path = _saved(_square(count), shared_tmp / f"kept{count}.h5")
        near, _, blocks = InFile(SavedMesh(path)).taken(scene, COMM)
        assert blocks.sizes.cells == count**2
        assert near is None or len(near.cells) == count + 1


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("cells", lambda values: values + len(values), "cells has numbers that are not from -1"),
        ("points", lambda values: values + np.inf, "points has values that are no numbers"),
        ("points", lambda values: values[:, :1], "points are no points"),
        ("cell_rock", lambda values: values[1:], "cell_rock has the shape"),
        ("joint_cells", lambda values: values + 10**6, "joint_cells has numbers"),
        ("origin", lambda values: np.roll(values, 1), "copies of copies"),
        ("joint_cells", lambda values: values[:, ::-1], "not on the cells that they name"),
        ("side_cell", lambda values: np.roll(values, 3), "not on the cells that they name"),
        ("joint_top", lambda values: values[:, ::-1], "walls of a joint not at one place"),
        ("joint_flow", lambda values: values[:, ::-1], "joint_flow has nodes that are not at the ends"),
    ],
)
def test_files_of_others_are_refused_on_every_rank(name, change, says, shared_tmp):
    """In slices, and by rank 0."""
    path = _saved(split(_grid()), shared_tmp / "kept.h5")
    if COMM.rank == 0:
        with resealed(path) as (arrays, _):
            arrays[name] = change(arrays[name])
    COMM.barrier()
    with pytest.raises(InputError, match=says):
        read(COMM, SavedMesh(path))
    if COMM.rank == 0 and name != "origin":
        with pytest.raises(InputError, match=says):
            load_split(path)


@pytest.mark.parametrize("fewest", [0, 10**9], ids=["sliced", "whole"])
def test_cells_that_cannot_be_computed_on_are_refused_on_every_rank(fewest, shared_tmp, monkeypatch):
    """One has its nodes clockwise, which its rank alone sees; in the other mesh a node is on no cell."""
    monkeypatch.setattr("fracflow.mesh.slices.reading.FEWEST", fewest)
    whole = split(_grid())
    cells = whole.cells.copy()
    cells[-1] = cells[-1, ::-1]
    lost = {"points": np.vstack([whole.points, [[0.3, 0.3]]]), "origin": np.append(whole.origin, len(whole.points))}
    for changes, says in (({"cells": cells}, r"the cell at \(.*\) is flat"), (lost, "mesh: 1 node that no cell has")):
        path = _saved(replace(whole, **changes), shared_tmp / "kept.h5")
        with pytest.raises(InputError, match=says):
            prepare(Scene.from_data(SCENE | {"mesh": {"file": str(path)}}), COMM)
        COMM.barrier()


def test_a_mesh_that_was_changed_is_refused_on_every_rank(shared_tmp):
    import h5py

    path = _saved(split(_grid()), shared_tmp / "kept.h5")
    if COMM.rank == 0:
        with h5py.File(path, "r+") as file:
            file["points"][3, 0] += 1.0
    COMM.barrier()
    with pytest.raises(InputError, match="points, rows 0 to"):
        read(COMM, SavedMesh(path))


@pytest.mark.parametrize(
    ("there", "says"), [("none.h5", "no such file"), ("other.h5", "another file there than rank 0")]
)
def test_a_rank_that_finds_another_file_stops_all(there, says, shared_tmp):
    whole = split(_grid())
    _saved(whole, shared_tmp / "kept.h5")
    _saved(replace(whole, notes=("another",)), shared_tmp / "other.h5")
    link = shared_tmp / f"{COMM.rank}.h5"
    is_last = COMM.rank == COMM.size - 1 and (COMM.size > 1 or there == "none.h5")
    link.symlink_to(there if is_last else "kept.h5")
    if COMM.size == 1 and there != "none.h5":
        assert read(COMM, SavedMesh(link)).cells.total == len(whole.cells)
        return
    with pytest.raises(InputError, match=says):
        read(COMM, SavedMesh(link))


def test_walls_are_merged_on_pieces_as_in_a_whole_mesh(sliced):
    _, whole, rigid, near, _, blocks = sliced
    chosen = groups(whole) == groups(whole)[0] if len(whole.fractures) else np.zeros(0, dtype=bool)
    without = merged_faces(whole, chosen)
    found, slices = merged_slices(near, blocks, chosen)
    assert np.array_equal(slices.points, without.points[slices.nodes.numbers])
    assert np.array_equal(slices.origin, without.origin[slices.nodes.numbers])
    assert np.array_equal(slices.cells, without.cells[slices.number])
    same = distribute_slices(found, slices, rigid)
    again = with_all_cells(with_sums_of_cells(found, same), same)
    if COMM.rank == 0:
        assert len(without.joint_bottom) < len(whole.joint_bottom) or not len(whole.fractures)
        _assert_same(again, without)


@pytest.mark.serial
def test_large_meshes_in_the_plane_are_taken_in_slices(tmp_path, monkeypatch):
    mesh = split(_grid())
    save_mesh(mesh, tmp_path / "kept.h5")
    assert slices_of(tmp_path / "kept.h5") is None
    monkeypatch.setattr("fracflow.mesh.slices.reading.FEWEST", len(mesh.cells))
    assert slices_of(tmp_path / "kept.h5") == SavedMesh(tmp_path / "kept.h5")
    assert slices_of(tmp_path / "kept.h5", "") is None  # a run that began with it has numbers of the file
    save_mesh(replace(mesh, near=len(mesh.cells)), tmp_path / "mesh.h5")
    assert slices_of(tmp_path / "mesh.h5", "ab") == SavedMesh(tmp_path / "mesh.h5", "ab", len(mesh.cells))
    save_mesh(replace(mesh, near=len(mesh.cells), cuts=1), tmp_path / "cut.h5")
    assert slices_of(tmp_path / "cut.h5", "ab") is None
    assert len(load_split(tmp_path / "mesh.h5").cells) == len(mesh.cells)
    with pytest.raises(InputError, match="write one with"):
        slices_of(tmp_path / "none.h5")


@pytest.mark.serial
def test_the_sizes_that_check_names_are_those_of_all_cells(monkeypatch):
    """It had an assertion fail on every mesh that ranks take in slices."""
    scene = load("meshes/crossings/scene.toml")
    sizes, moved, numbers = set_up(scene)[:3]
    monkeypatch.setattr("fracflow.mesh.slices.reading.FEWEST", 0)
    sliced = set_up(scene)
    same = [name for name in sizes if not name.startswith(("memory", "time"))]
    assert "cells" in same and [sliced[0][name] for name in same] == [sizes[name] for name in same]
    assert sliced[1] == moved
    _assert_same(sliced[2], numbers)
