"""Where a model takes its mesh from: a file that ranks read in slices, or a mesh that rank 0 has whole.

Rank 0 has a small one whole, and a coarse one that ranks cut. Ranks take a large one from a file: that of ``fracflow mesh``,
that of a run, or a temporary one that a process of its own writes.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import gettempdir
from typing import TYPE_CHECKING, Protocol

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.agreement import on_root
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Ints, SplitMesh, is_unmeshed
from fracflow.mesh.read import SPLIT, MeshSource
from fracflow.mesh.slabs import Distributed
from fracflow.mesh.slices.gathering import sliced_parts, with_sums_of_cells
from fracflow.mesh.slices.reading import SavedMesh, frame_of, is_large, read, slices_of
from fracflow.mesh.split import split
from fracflow.mesh.store import load_mesh, load_split, save_mesh
from fracflow.model.setup import (
    Model,
    Placed,
    fitting,
    fractures_of,
    made_ready,
    place,
    places_of,
    source_of,
    split_of,
)
from fracflow.scene.scene import Scene
from fracflow.storage.child import temporary_folder
from fracflow.storage.sealed import SealedFile

if TYPE_CHECKING:
    from fracflow.mesh.slices.near_first import Slices

Taken = tuple[SplitMesh | None, Placed, Blocks | None]
"""The mesh on rank 0, with its near cells alone where ranks have blocks already; the scene's places; and those blocks."""


class Kept(Protocol):
    """A mesh that a model is made on, on every rank."""

    @property
    def has_cells(self) -> bool:
        """Whether it is of rock that is meshed."""

    def taken(self, scene: Scene, comm: MPI.Comm) -> Taken:
        """The mesh with the places of a scene. Raises InputError, on every rank. Collective."""

    def partition(self, arrays: SealedFile | None) -> Ints | None:
        """Rank (cells,) of each cell before cells are cut, as a run recorded it, on rank 0; None where ranks find it again."""


@dataclass(frozen=True)
class Whole:
    """A mesh that rank 0 has whole, or of which it has the near cells where ranks cut it. It is None on other ranks."""

    mesh: SplitMesh | None
    has_cells: bool

    @classmethod
    def of(cls, mesh: SplitMesh | None, comm: MPI.Comm) -> Whole:
        """That of a mesh on rank 0. Collective."""
        return cls(mesh, comm.bcast(mesh is not None and not is_unmeshed(mesh.cells), root=0))

    def taken(self, scene: Scene, comm: MPI.Comm) -> Taken:
        """The mesh with the places of a scene. Raises InputError, on every rank. Collective."""
        return _placed(scene, comm, on_root(comm, lambda: self.mesh and fitting(scene, self.mesh)))

    def partition(self, arrays: SealedFile | None) -> Ints | None:
        """Rank (cells,) of each cell before cells are cut, as a run recorded it, on rank 0."""
        return None if arrays is None or self.mesh is None else arrays.each("cell_rank", self.mesh.children)


@dataclass(frozen=True)
class InFile:
    """A file that ranks take slices of."""

    saved: SavedMesh
    has_cells: bool = True

    def taken(self, scene: Scene, comm: MPI.Comm) -> Taken:
        """Near cells on rank 0, places and blocks; as ``Whole`` where places lie in other cells than those near in the file.

        Raises InputError, on every rank. Collective.
        """
        from fracflow.mesh.slices.near_first import with_near_first  # few runs need it

        saved = self.saved
        raw = read(comm, saved)
        names = raw.facets.rows
        scene.check_mesh_names(names.rocks, names.fractures, names.sides, tuple(names.named_points))
        frame = frame_of(raw, fractures_of(scene))
        places = comm.bcast(on_root(comm, lambda: None if frame is None else places_of(scene, frame)), root=0)
        assert places is not None
        found = with_near_first(raw, places)
        del raw  # which is as large as the slices
        if found is None:
            return _placed(scene, comm, on_root(comm, lambda: fitting(scene, load_mesh(saved.path, saved.root))))
        near, slices = found
        return distributed(scene, on_root(comm, lambda: near and _made_ready(scene, near, saved)), slices)

    def partition(self, arrays: SealedFile | None) -> Ints | None:
        """None in place of the ranks (cells,), which are found again."""
        return None


@dataclass(frozen=True)
class InPieces:
    """Slices that ranks have made of others, and the near cells on rank 0; None elsewhere."""

    near: SplitMesh | None
    slices: Slices
    has_cells: bool = True

    def taken(self, scene: Scene, comm: MPI.Comm) -> Taken:
        """Near cells on rank 0, places and blocks. Raises InputError, on every rank. Collective."""
        return distributed(scene, self.near, self.slices)

    def partition(self, arrays: SealedFile | None) -> Ints | None:
        """None in place of the ranks (cells,), which are found again."""
        return None


def kept_mesh(comm: MPI.Comm, path: Path, root: str = "") -> Kept:
    """The mesh of a run folder, with the ``root`` of its seal where that is known.

    Raises InputError, on every rank. Collective.
    """
    saved = comm.bcast(on_root(comm, lambda: slices_of(path, root)), root=0)
    return InFile(saved) if saved is not None else Whole.of(on_root(comm, lambda: load_mesh(path, root)), comm)


def taken(scene: Scene, comm: MPI.Comm, kept: Kept | None) -> Taken:
    """The mesh of a scene, or the one ``kept`` of it, with its places. Raises InputError, on every rank. Collective."""
    if kept is not None:
        return kept.taken(scene, comm)
    with ExitStack() as folders:
        saved, mesh = _read(scene, comm, folders)
        if saved is not None:
            return InFile(saved).taken(scene, comm)
    return _placed(scene, comm, on_root(comm, lambda: mesh and made_ready(scene, mesh)))


def _read(scene: Scene, comm: MPI.Comm, folders: ExitStack) -> tuple[SavedMesh | None, SplitMesh | None]:
    """The file that ranks take slices of, on every rank; without one, the split mesh on rank 0.

    folders  what removes the folder of a file that is written for the run, on rank 0

    Raises InputError, on every rank. Collective.
    """
    saved, mesh = on_root(comm, lambda: _read_on_root(scene, folders)) or (None, None)
    return comm.bcast(saved, root=0), mesh


def _read_on_root(scene: Scene, folders: ExitStack) -> tuple[SavedMesh | None, SplitMesh | None]:
    """As ``_read``. Cells that ranks cut come to them from rank 0, which need not have split them itself."""
    if scene.is_unbounded:
        return None, split_of(scene)
    path = scene.mesh_path
    if path is not None and path.suffix == SPLIT:
        saved = None if scene.refine else slices_of(path)
        return saved, split_of(scene) if saved is None else None
    source = source_of(scene).sized()
    mesh = None if is_large(source.expected) else split(source.raw())
    if mesh is not None and (scene.refine or not is_large(len(mesh.cells))):
        return None, mesh
    file = _written(source, mesh, folders)
    saved = None if scene.refine else slices_of(file)
    return (None, load_split(file)) if saved is None else (replace(saved, is_passed_on=True), None)


def _written(source: MeshSource, mesh: SplitMesh | None, folders: ExitStack) -> Path:
    """A temporary file of a split mesh, or of that of a source, which a process of its own makes. Raises InputError."""
    from fracflow.mesh.slices.making import made  # few runs need it

    try:
        folder = folders.enter_context(temporary_folder("mesh"))
        if mesh is None:
            return made(source, folder)
        save_mesh(mesh, file := folder / "mesh.h5")
        return file
    except OSError as error:
        where = f"{error.filename or gettempdir()}: {error.strerror or error}"
        raise InputError(f"mesh: cannot be written for ranks to read: {where}; make room, or set TMPDIR") from None


def distributed(scene: Scene, near: SplitMesh | None, slices: Slices) -> Taken:
    """The blocks of slices, with near cells and places. Raises InputError, on every rank. Collective."""
    from fracflow.mesh.slices.shares import distribute_slices  # few runs need it

    comm = slices.comm
    placed: Placed = comm.bcast(on_root(comm, lambda: None if near is None else place(scene, near)), root=0)
    rigid = [name for name, rock in scene.rock.items() if rock.rigid]
    blocks = distribute_slices(near, slices, rigid, placed.ties)
    return with_sums_of_cells(near, blocks), placed, blocks


def _placed(scene: Scene, comm: MPI.Comm, mesh: SplitMesh | None) -> Taken:
    """A mesh that rank 0 has, and the scene's places on it. Raises InputError, on every rank. Collective."""
    placed: Placed = comm.bcast(on_root(comm, lambda: place(scene, mesh) if mesh is not None else None), root=0)
    return mesh, placed, None


def _made_ready(scene: Scene, near: SplitMesh, saved: SavedMesh) -> SplitMesh:
    return near if saved.near >= 0 else made_ready(scene, near)


def kept_parts(model: Model) -> dict[str, Distributed]:
    """The parts of the mesh that the run began with that rank 0 has not, for the file of a run; none where it has all.

    Collective.
    """
    blocks = (model.whole or model).operators.blocks
    mesh = None if model.mesh is None else model.stated_mesh
    has_sums = blocks.comm.bcast(mesh is not None and mesh.sums is not None, root=0)
    return sliced_parts(blocks) if has_sums else {}
