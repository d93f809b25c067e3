"""Parts of the rock that nothing loads: they are in balance from the start, and are held there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Bools, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.distribute import pieces_of_rock
from fracflow.mesh.graph import components
from fracflow.mesh.near_cells import near_nodes
from fracflow.mesh.slices.directory import Route
from fracflow.mesh.whole import blocks_with
from fracflow.model.dirichlet import PrescribedValues
from fracflow.model.setup import Model
from fracflow.reduction.decision import Decision, ReductionInput, UnloadedBlocks
from fracflow.scene.boundary import Support
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable


def moves(support: Support) -> bool:
    """Whether a support ever prescribes another displacement than none."""
    entries = (entry for row in support.displacement_gradient or () for entry in row)
    tables = (*(support.displacement or {}).values(), *entries)
    return any(value != 0.0 for table in tables for value in table.values)


def loaded_names(scene: Scene) -> Iterator[str]:
    """Sides, rocks and points on which something acts beside the initial stress."""
    for load in scene.load:
        if load.traction != "initial-stress":
            yield from load.on
    for support in scene.support:
        if moves(support):
            yield from support.on
    for term in scene.terms:
        if term.waves:
            yield from term.on


def idle_pieces(model: Model) -> tuple[Bools, UnloadedBlocks]:
    """Which pieces of rock (p,) are of parts that nothing loads, and how many parts there are. On rank 0.

    Cuts change neither: nodes are those of the uncut mesh, which near ones have the numbers of.
    """
    scene, placed = model.scene, model.placed
    assert model.mesh is not None
    fine, mesh = model.mesh, model.mesh.uncut
    tied = placed.ties // mesh.points.shape[1]
    part_of, piece = parts(mesh, tied[(tied < near_nodes(mesh)).all(axis=1)])
    part, count = part_of[piece], int(part_of.max(initial=-1)) + 1
    none = np.zeros(0, dtype=bool)
    at_rest = scene.initial is None and not scene.equilibrates and not scene.carries_unbalanced
    if count < 2 or scene.model != "default" or not at_rest:
        return none, UnloadedBlocks(count, count)
    loaded = np.zeros(count, dtype=bool)
    for name in loaded_names(scene):
        loaded[part[_side_nodes(model, mesh, name)]] = True
        if name in mesh.rocks:
            loaded[part_of[blocks_with(mesh, mesh.rocks.index(name))]] = True
    flow = np.array([node for nodes in placed.wells.values() for node in nodes], dtype=np.int64)
    driven = (scene.drains(name) or scene.fracture_named(name).pressure is not None for name in mesh.fractures)
    held = [scene.has_flow and each for each in driven]
    drives = np.isin(fine.joint_flow, flow).any(axis=1) | np.array(held, dtype=bool)[fine.joint_fracture]
    loaded[part[mesh.joint_bottom[np.flatnonzero(drives) // fine.pieces].ravel()]] = True
    if not loaded.any():  # the purpose of a run without loads is unknown
        return none, UnloadedBlocks(count, count)
    return ~loaded[part_of], UnloadedBlocks(count, int(loaded.sum()))


def parts(mesh: SplitMesh, tied: Ints) -> tuple[Ints, Ints]:
    """The part (p,) of each block of rock, which joints or ``tied`` nodes (m, 2) hold together, and the block (n,) of nodes.

    Rock that is not meshed is around all of them.
    """
    if is_unmeshed(mesh.cells):
        return np.zeros(1, dtype=np.int64), np.zeros(len(mesh.points), dtype=np.int64)
    if mesh.sums is not None:
        piece, count = mesh.sums.piece, len(mesh.sums.piece_rock)
    else:
        piece, rock, _ = pieces_of_rock(mesh)
        count = len(rock)
    one = np.concatenate([mesh.joint_bottom.ravel(), tied[:, 0]])
    other = np.concatenate([mesh.joint_top.ravel(), tied[:, 1]])
    return components(piece[one], piece[other], count), piece


def _side_nodes(model: Model, mesh: SplitMesh, name: str) -> Ints:
    """Nodes (n,) of a side or a point; a name may be of both."""
    chosen = [np.zeros(0, dtype=np.int64)]
    if name in mesh.sides:
        chosen.append(mesh.side_facets[mesh.side_of == mesh.sides.index(name)].ravel())
    if name in model.placed.points:
        chosen.append(model.placed.points[name])
    return np.concatenate(chosen)


def without_idle(model: Model) -> tuple[Model, UnloadedBlocks]:
    """The model with the parts held that nothing loads. Collective."""
    comm, block = model.operators.layout.comm, model.operators.blocks.solid
    idle, found = comm.bcast(on_root(comm, lambda: idle_pieces(model)), root=0)
    if found.loaded == found.count:
        return model, found
    here = idle[block.piece]
    bodies = np.unique(block.body[here & (block.body >= 0)])
    unknowns = np.concatenate([block.unknown[here].ravel(), block.body_unknown[bodies].ravel()])
    unknowns, starts = unknowns[unknowns >= 0].astype(np.int64), block.unknown_starts
    numbers = np.unique(Route(comm, owner_of(starts, unknowns)).send(unknowns))  # of this rank
    loads, mine = model.loads, numbers - starts[comm.rank]
    resting = np.setdiff1d(loads.resting, mine)
    free = np.setdiff1d(mine, np.concatenate([part.numbers for part in loads.supports]))
    held = replace(
        loads,
        supports=(*loads.supports, PrescribedValues(free, TimeTable.constant(0.0))),
        resting=resting,
        has_resting=bool(comm.allreduce(len(resting), op=MPI.SUM)),
    )
    return replace(model, loads=held), replace(found, unknowns=int(comm.allreduce(len(free), op=MPI.SUM)))


def decide_parts(facts: ReductionInput) -> Iterator[Decision]:
    """How many of them there are, and how many are held."""
    parts = facts.parts
    idle = parts.count - parts.loaded
    value = f"{parts.loaded} of {parts.count}" if parts.count > 1 else "all of it is one"
    saves = f"{parts.unknowns} unknowns, which are held" if idle else "nothing: each part is loaded"
    criterion = "parts of the rock that hang together, and carry a load, a support that moves, a wave or a well"
    part = "parts of the rock that nothing loads"
    yield Decision(part, idle > 0, criterion, value, "all parts", "none: exact", saves)
