"""A scene whose saved mesh no rank has whole: which scenes that are, and their near cells and blocks."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, SplitMesh, is_unmeshed
from fracflow.mesh.read import SPLIT
from fracflow.mesh.slabs import Distributed
from fracflow.mesh.slices.gathering import sliced_parts, with_sums_of_cells
from fracflow.mesh.slices.reading import SavedMesh, read, slices_of
from fracflow.mesh.store import load_mesh
from fracflow.model.setup import Model, Placed, made_ready, place, places_of
from fracflow.scene.scene import Scene

Kept = SplitMesh | SavedMesh
"""The mesh of a run that goes on, or the file that ranks take it from in slices."""


def kept_mesh(path: Path, root: str = "") -> Kept:
    """The mesh of a run folder, with the ``root`` of its seal where that is known, on one rank. Raises InputError."""
    return slices_of(path, root) or load_mesh(path, root)


def whole_of(kept: Kept) -> SplitMesh:
    """That mesh as one rank has it. Raises InputError."""
    return load_mesh(kept.path, kept.root) if isinstance(kept, SavedMesh) else kept


def has_no_cells(kept: Kept) -> bool:
    """Whether it is of rock that is not meshed."""
    return not isinstance(kept, SavedMesh) and is_unmeshed(kept.cells)


def in_slices(scene: Scene, comm: MPI.Comm, kept: Kept | None) -> tuple[SplitMesh | None, Placed, Blocks] | None:
    """Near cells on rank 0, places and blocks of a scene whose mesh comes in slices; None where rank 0 takes it all.

    kept  the mesh of a run that goes on, on rank 0

    Raises InputError, on every rank. Collective.
    """
    saved = comm.bcast(on_root(comm, lambda: _saved(scene, kept)), root=0)
    if saved is None:
        return None
    from fracflow.mesh.slices.near_first import with_near_first  # few runs need it
    from fracflow.mesh.slices.shares import distribute_slices

    raw = read(comm, saved)
    asked = comm.bcast(on_root(comm, partial(_asked, scene, raw.frame)), root=0)
    found = with_near_first(raw, *asked)
    del raw  # which is as large as the slices
    if found is None:
        return None
    near, slices = found
    mesh = on_root(comm, lambda: near if near is None or saved.near >= 0 else made_ready(scene, near))
    placed: Placed = comm.bcast(on_root(comm, lambda: None if mesh is None else place(scene, mesh)), root=0)
    rigid = [name for name, rock in scene.rock.items() if rock.rigid]
    blocks = distribute_slices(mesh, slices, rigid, placed.ties)
    return with_sums_of_cells(mesh, blocks), placed, blocks


def kept_parts(model: Model) -> dict[str, Distributed]:
    """The parts of the mesh that the run began with that rank 0 has not, for the file of a run; none where it has all.

    Collective.
    """
    blocks = (model.whole or model).operators.blocks
    mesh = None if model.mesh is None else model.stated_mesh
    has_sums = blocks.comm.bcast(mesh is not None and mesh.sums is not None, root=0)
    return sliced_parts(blocks) if has_sums else {}


def _saved(scene: Scene, kept: Kept | None) -> SavedMesh | None:
    """The file that ranks take slices of, if they do. Raises InputError."""
    if kept is not None:
        return kept if isinstance(kept, SavedMesh) else None
    path = scene.mesh_path
    if path is None or path.suffix != SPLIT or scene.refine:  # cells that ranks cut come to them few and large
        return None
    return slices_of(path)


def _asked(scene: Scene, frame: SplitMesh | None) -> tuple[Floats, list[int]]:
    """Places (p, dim) whose cells are near, and the numbers of rocks of which all are. Raises InputError."""
    assert frame is not None
    scene.check_mesh_names(frame.rocks, frame.fractures, frame.sides, tuple(frame.named_points))
    places, rocks = places_of(scene, frame)
    return places, [number for number, name in enumerate(frame.rocks) if name in rocks]
