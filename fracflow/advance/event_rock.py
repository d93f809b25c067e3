"""A state handed from rock without a mesh to the same fractures in meshed rock, or back: jumps, tractions and fluid go on.

The displacement of the meshed rock is u = u_J + E v. Walls that move by u_J make the jumps; E v moves all walls of a node as
one. The rock is in equilibrium for E' (K u + F_s(sigma_0) - R) = 0. Rock without a mesh has the walls alone, the first of each
node held. The walls then carry another traction than before. The difference is frozen: its forces are added to those of the
initial stress. So nothing slips by the change of rock itself. Strain energy by which both rocks differ is an entry of the
energy balance.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.elements import facet
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.shared import Shared
from fracflow.model.balance import static_balance
from fracflow.model.energy import CHANGE_OF_ROCK
from fracflow.model.layout import matrix_of
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.model.solid import nodal_force
from fracflow.model.state import Forces, Motion, PreviousStep, Sections, State
from fracflow.solve.initial_rates import with_diagonal
from fracflow.solve.options import solver_of


@dataclass(frozen=True)
class Handed:
    """A state in the other rock, and what it has left behind.

    mean    of the frozen traction along the fractures, root of its mean square [stress]
    most    of it at a node [stress]
    energy  strain energy of this rock above that of the rock before [energy per thickness]
    """

    state: State
    mean: float
    most: float
    energy: float


def handed_over(old: Model, new: Model, state: State) -> Handed:
    """A state at rest of ``old``, on the joints of ``new``, whose initial stress takes up the difference.

    It changes ``new.operators.prestress``, which has nothing frozen in it. Raises SolveError. Collective.
    """
    ops, before = new.operators, old.operators
    loads = new.loads.standing()
    load = ops.layout.solid_vector()
    loads.force(state.time, state.controls, load)
    displacement, velocity = (_at_walls(old, new, each) for each in (state.motion.displacement, state.motion.velocity))
    if not new.scene.is_unbounded:
        still, nothing, walls = load.copy(), ops.layout.solid_vector(), (displacement, velocity)
        still.axpy(-1.0, ops.prestress)
        rock = _Rock(ops, loads.held)
        displacement, velocity = (rock.around(*each) for each in zip(walls, (still, nothing), strict=True))
        rock.destroy()
        destroy(still, nothing, *walls)

    pressure = _moved_flow(before, ops, state.pressure)
    sections = _moved_sections(before, ops, state.sections)
    term = displacement.duplicate()
    ops.rock_force(displacement, term)
    stored = 0.5 * float(term.dot(displacement)) + float(ops.prestress.dot(displacement))
    left = static_balance(ops, displacement, sections.traction, pressure, load)
    support = left.copy()
    loads.release(left)
    support.axpy(-1.0, left)
    ops.prestress.axpy(-1.0, left)
    mean, most = as_traction(ops, left)
    destroy(left, term)

    on_sides = 0.0 if old.scene.is_unbounded else _work_on_sides(before, state.motion.displacement)
    of_terms = _stored_by_terms(ops, displacement)
    was_stored = sum(state.energy[entry] for entry in ("rock_strain", *of_terms))
    more = stored - (was_stored - on_sides)
    energy = {**state.energy, **of_terms, "rock_strain": stored - sum(of_terms.values())}
    energy[CHANGE_OF_ROCK] = state.energy.get(CHANGE_OF_ROCK, 0.0) - more
    energy["work_boundaries"] -= on_sides
    forces = Forces(
        load, support, *(_moved_flow(before, ops, each) for each in (state.forces.conduction, state.forces.source))
    )
    handed = replace(
        state,
        motion=Motion(displacement, velocity, ops.layout.solid_vector()),
        pressure=pressure,
        sections=sections,
        forces=forces,
        energy=energy,
        friction=_of_sections(before, ops, state.friction),
        previous_step=PreviousStep(),
        uptake=None if state.uptake is None else _moved_flow(before, ops, state.uptake),
        memory={name: _of_joints(before, ops, values) for name, values in state.memory.items()},
    )
    return Handed(handed, mean, most, more)


class Unslipped(NamedTuple):
    """Rock without a mesh as an event takes it, on this rank.

    displacement  of its walls (n,) [length]
    traction      (s, dim) of sections [stress]
    """

    displacement: Floats
    traction: Floats

    @classmethod
    def of(cls, state: State) -> Unslipped:
        """Copies of what a state in that rock has."""
        return cls(state.motion.displacement.getArray(readonly=True).copy(), state.sections.traction.copy())

    def share(self, ops: Operators, after: State, frozen: PETSc.Vec) -> float:
        """Frozen forces on walls over the stress drop of the event that has led to ``after``, both weighted by slip.

        sum |f.D|/sum w (t - t').D over nodes and sections, with the jumps D of the event; those at nodes are of both signs, and
        none makes up for another. Infinite where no stress dropped. Collective.
        """
        moved = after.motion.displacement.duplicate()
        moved.setArray(after.motion.displacement.getArray(readonly=True) - self.displacement)
        at_node = (
            (frozen.getArray(readonly=True) * moved.getArray(readonly=True)).reshape(-1, ops.joints.dim).sum(axis=1)
        )
        drop = ((self.traction - after.sections.traction) * ops.joints.strain(moved)).sum(axis=1)
        moved.destroy()
        sums = ops.layout.comm.allreduce(np.array([np.abs(at_node).sum(), ops.joints.weights @ drop]))
        return float(sums[0] / sums[1]) if sums[1] > 0.0 else np.inf


def frozen_since(ops: Operators, prestress: PETSc.Vec) -> PETSc.Vec:
    """Forces on walls that are frozen now, and were not with an earlier ``prestress`` of that rock. New vector. Collective."""
    more = prestress.copy()
    more.axpy(-1.0, ops.prestress)
    return more


def _at_walls(old: Model, new: Model, vector: PETSc.Vec) -> PETSc.Vec:
    """Displacements of the walls of ``old`` as those of ``new``, none elsewhere, in a new vector. Collective.

    In rock without a mesh they are those beside the first wall of each node.
    """
    ops, before = new.operators, old.operators
    there, here = (np.concatenate([o.blocks.joints.bottom, o.blocks.joints.top], axis=1) for o in (before, ops))
    block, result = ops.blocks.solid, ops.layout.solid_vector()
    values = np.full(block.points.shape, -np.inf)
    values[here] = _of_joints(before, ops, before.at_nodes(vector)[there])
    nodes = Shared(ops.layout.comm, block.owned, ops.blocks.sizes.nodes, block.node_global)
    walls = np.stack([nodes.largest(each)[: block.owned] for each in values.T], axis=1)  # of other ranks' joints too
    nodes.destroy()
    if new.scene.is_unbounded:
        ids, first = block.node_ids[: block.owned], block.origin[: block.owned]
        known = np.where(np.isfinite(walls), walls, 0.0)
        walls = walls - _by_ids(ops.layout.comm, ops.blocks.sizes.nodes, ids, known, first)
    own = np.flatnonzero(np.isfinite(walls).all(axis=1))
    result.getArray()[block.unknown[own] - result.getOwnershipRange()[0]] = walls[own]
    return result


class _Rock:
    """The rock whose walls at a node move as one: E' K E, factored. ``held`` are local numbers of held unknowns."""

    def __init__(self, ops: Operators, held: Ints) -> None:
        """Collective."""
        self.ops, block, comm = ops, ops.blocks.solid, ops.layout.comm
        start, last = (int(block.unknown_starts[comm.rank + k]) for k in (0, 1))
        own = block.node_ids[: block.owned]
        copies = np.flatnonzero(own != block.origin[: block.owned])
        numbers = _by_ids(comm, ops.blocks.sizes.nodes, own, block.unknown[: block.owned], block.origin[copies])
        column = np.arange(start, last)
        column[(block.unknown[copies] - start).ravel()] = numbers.ravel()
        sizes = ops.stiffness.getSizes()
        self.walls = matrix_of(sizes, (np.arange(last - start + 1), column, np.ones(last - start)), comm)
        self.still = np.union1d(held, (block.unknown[copies] - start).ravel())
        product = ops.stiffness.PtAP(self.walls)
        self.stiff = with_diagonal(product)
        self.stiff.zeroRowsColumns((start + self.still).astype(PETSc.IntType), 1.0)
        product.destroy()
        self.solver = solver_of(self.stiff, "handed_")

    def around(self, walls: PETSc.Vec, force: PETSc.Vec) -> PETSc.Vec:
        """The displacement that has the jumps of ``walls``, in equilibrium with a force, in a new vector. Collective."""
        pull, right, moved = walls.duplicate(), walls.duplicate(), walls.duplicate()
        self.ops.stiffness.mult(walls, pull)
        pull.aypx(-1.0, force)
        self.walls.multTranspose(pull, right)
        right.getArray()[self.still] = 0.0
        self.solver.solve(right, moved)
        self.walls.mult(moved, right)
        right.axpy(1.0, walls)
        destroy(pull, moved)
        return right

    def destroy(self) -> None:
        """Collective."""
        destroy(self.walls, self.stiff, self.solver)


def as_traction(ops: Operators, force: PETSc.Vec) -> tuple[float, float]:
    """Root of the mean square, and the largest, of the traction (4.4b) that forces on walls stand for. Collective."""
    size = _length_of_walls(ops)
    on = size.getArray()
    here = on > 0.0
    traction = force.getArray(readonly=True)[here] / on[here]
    sums = ops.layout.comm.allreduce(np.array([on[here] @ traction**2, on[here].sum()]))
    most = ops.layout.comm.allreduce(float(np.abs(traction).max(initial=0.0)), op=MPI.MAX)
    size.destroy()
    return float(np.sqrt(sums[0] / max(sums[1], 1e-300))), most


def _stored_by_terms(ops: Operators, displacement: PETSc.Vec) -> dict[str, float]:
    """Energy u'K u/2 of each term that stores some of the rock, none where it has no K, by its entry. Collective."""
    found = {}
    for term in ops.terms:
        if term.stores:
            found[term.entry] = 0.0
            if term.stiffness is not None:
                force = displacement.duplicate()
                term.stiffness.mult(displacement, force)
                found[term.entry] = 0.5 * float(force.dot(displacement))
                force.destroy()
    return found


def _length_of_walls(ops: Operators) -> PETSc.Vec:
    """Length of the walls that each unknown stands for, none inside the rock and on its sides, in a new vector. Collective."""
    blocks = ops.blocks
    faces = np.concatenate([blocks.joints.bottom, blocks.joints.top], axis=1)
    _, length = facet.frame(blocks.solid.points[blocks.joints.bottom])
    half = np.broadcast_to(0.5 * length[:, None, None], (*faces.shape, blocks.sizes.dim))
    return nodal_force(blocks, faces, half.copy(), ops.expand)


def _work_on_sides(ops: Operators, displacement: PETSc.Vec) -> float:
    """Work of the initial stress on sides that have moved in an event; rock without a mesh has none. Collective."""
    size = _length_of_walls(ops)
    apart = size.getArray(readonly=True) == 0.0
    size.destroy()
    work = float(ops.prestress.getArray(readonly=True)[apart] @ displacement.getArray(readonly=True)[apart])
    return float(ops.layout.comm.allreduce(work))


def _by_ids(comm: MPI.Comm, total: int, ids: Ints, values: NDArray[Any], wanted: Ints) -> NDArray[Any]:
    """Rows (n, ...) of the numbers wanted (n,), of rows (m, ...) that ranks have by their numbers (m,). Collective.

    total  of the numbers; each is one rank's
    """
    kept = np.diff(np.linspace(0, total, comm.size + 1).astype(np.int64))[comm.rank]
    shared, none = Shared(comm, int(kept), total, np.concatenate([ids, wanted])), np.zeros(len(wanted))
    columns = values.reshape(len(ids), int(np.prod(values.shape[1:]))).T
    found = [shared.summed(np.concatenate([each, none]))[len(ids) :] for each in columns]
    shared.destroy()
    return np.stack(found, axis=1).reshape(len(wanted), *values.shape[1:]).astype(values.dtype)


def _moved_flow(old: Operators, new: Operators, vector: PETSc.Vec) -> PETSc.Vec:
    result = new.layout.flow_vector()
    if new.flow is not None:
        local = vector.getArray(readonly=True)
        ids, total = new.blocks.flow.ids, new.blocks.sizes.flow_nodes
        result.setArray(_by_ids(new.layout.comm, total, old.blocks.flow.ids, local, ids))
    return result


def _of_joints(old: Operators, new: Operators, values: NDArray[Any]) -> NDArray[Any]:
    """Rows (j, ...) of the joints that this rank has now. Collective."""
    ids, total = new.blocks.joints.ids, new.blocks.sizes.joints
    return _by_ids(new.layout.comm, total, old.blocks.joints.ids, values, ids)


def _of_sections(old: Operators, new: Operators, values: NDArray[Any]) -> NDArray[Any]:
    """Likewise, values (s, ...) of sections."""
    of_joint = values.reshape(len(old.blocks.joints.ids), old.joints.points, *values.shape[1:])
    found = _of_joints(old, new, of_joint)
    return found.reshape(len(found) * old.joints.points, *values.shape[1:])


def _moved_sections(old: Operators, new: Operators, sections: Sections) -> Sections:
    parts = {f.name: getattr(sections, f.name) for f in fields(Sections) if f.name != "history"}
    moved: dict[str, Any] = {name: _of_sections(old, new, values) for name, values in parts.items()}
    history = []
    for before, group, past in zip(old.joints.laws, new.joints.laws, sections.history, strict=True):
        known = {}
        for name, values in past.items():
            everywhere = np.zeros((len(old.joints.weights), *values.shape[1:]))
            everywhere[before.sections] = values
            known[name] = _of_sections(old, new, everywhere)[group.sections]
        history.append(known)
    return Sections(history=tuple(history), **moved)
