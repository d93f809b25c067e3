"""A scene made ready: mesh sizes where it states none, its mesh, and the model of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from fracflow._petsc import MPI, PETSc, timed
from fracflow.diagnostics.well_parts import unconnected_wells
from fracflow.mesh.agreement import on_root
from fracflow.mesh.cut_mesh import whole_mesh
from fracflow.mesh.data import Ints, SplitMesh
from fracflow.mesh.rock_cells import RockCells
from fracflow.model.setup import Model, made_ready, naming, place, read_sized, set_up, split_of
from fracflow.reduction.far_sides import assessed, is_left_out, near_sides, without_sides
from fracflow.reduction.mesh_size import proposed
from fracflow.reduction.sliced import Kept, taken
from fracflow.reduction.unresolved import unresolved
from fracflow.scene.scene import Scene
from fracflow.solve.options import set_defaults

NONE: Mapping[str, str] = MappingProxyType({})


def read_uncut(scene: Scene) -> tuple[Scene, SplitMesh]:
    """The scene with sizes of a mesh that fit it where it states none, and that mesh, split, before its cells are cut.

    Raises InputError.
    """
    with naming(scene):
        sized = scene.with_geometry(_open_sizes(scene)[0])
        return sized, split_of(sized)


def read_split(scene: Scene) -> SplitMesh:
    """The mesh of ``read_uncut`` with all of its cells cut, and ends of fractures joined by wells. Raises InputError."""
    return cut_for(*read_uncut(scene))


def cut_for(scene: Scene, mesh: SplitMesh) -> SplitMesh:
    """The same of a mesh that ``read_uncut`` has read for a scene. Raises InputError."""
    with naming(scene):
        return whole_mesh(made_ready(scene, mesh))


def with_sizes(scene: Scene, comm: MPI.Comm) -> Scene:
    """The scene with the mesh sizes that it leaves open, and notes why they are so. Raises InputError, on every rank.

    Collective.
    """
    with naming(scene):
        keys, notes = comm.bcast(on_root(comm, lambda: _open_sizes(scene)), root=0)
    return scene.with_geometry(keys, notes)


def _open_sizes(scene: Scene) -> tuple[dict[str, float], list[str]]:
    def build(trial: Scene) -> tuple[SplitMesh, Mapping[str, tuple[int, ...]]]:
        mesh = read_sized(trial)
        return mesh, place(trial, mesh).wells

    return proposed(scene, build)


@timed("FracSetUp", "Set up")
def prepare(
    scene: Scene,
    comm: MPI.Comm,
    saved: Kept | None = None,
    cell_rank: Ints | None = None,
    begins: bool = True,
    undone: Mapping[str, str] = NONE,
) -> Model:
    """Mesh, blocks, operators and loads of a scene. Raises InputError, on every rank. Collective.

    saved      mesh of an earlier run, or one that was made of it
    cell_rank  its ranks (cells,), on rank 0, as of ``set_up``
    begins     whether the run begins, and notes list the lengths that its mesh does not resolve
    undone     decisions that an earlier try of the same run has undone
    """
    with naming(scene):
        PETSc.garbage_cleanup(comm)  # models of earlier runs: on several ranks petsc4py only sets them aside
        set_defaults(scene.petsc)
        sides = assessed(scene)
        if not comm.bcast(on_root(comm, lambda: is_left_out(sides, saved, undone)), root=0):
            saved = saved if saved is None or saved.has_cells != scene.is_unbounded else None
            return _with_note(replace(_prepare(scene, comm, saved, cell_rank, begins), sides=sides))
        model = _prepare(without_sides(scene), comm, saved, cell_rank, begins)
        return _with_note(replace(model, sides=sides, bounded=scene))


def _with_note(model: Model) -> Model:
    """The model with a line on sides that are near, or on the mesh that its events would have. Collective."""
    if not model.scene.is_unbounded:
        notes = (*model.placed.notes, *near_sides(model))
        return replace(model, placed=replace(model.placed, notes=notes))
    from fracflow.reduction.event_mesh import before_events  # few runs need it

    notes = (*model.placed.notes, *before_events(model.scene, model.bounded))
    return replace(model, placed=replace(model.placed, notes=notes))


def _prepare(scene: Scene, comm: MPI.Comm, saved: Kept | None, cell_rank: Ints | None, begins: bool) -> Model:
    scene = with_sizes(scene, comm)
    mesh, placed, blocks = taken(scene, comm, saved)
    wells = placed.wells
    apart = on_root(comm, lambda: unconnected_wells(scene, mesh, wells) if mesh is not None else []) or []
    model = set_up(scene, comm, mesh, replace(placed, apart=tuple(apart)), cell_rank, blocks)
    block = model.operators.blocks.solid
    coarse = unresolved(scene, mesh, wells, RockCells.of(block, block.cell_ids, comm)) if begins else []
    notes = (*scene.notes, *coarse, *apart, *model.placed.notes)
    return replace(model, placed=replace(model.placed, notes=notes))
