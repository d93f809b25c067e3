"""Nodes of an explicit step on which more than the rock acts: joints, supports, dashpots, damping, springs and loads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracflow._petsc import destroy
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.dirichlet import PrescribedValues
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.terms.term import MeanDamping, Term, summed
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import AT_ONCE
from fracflow.solve.leapfrog.damping import damping_of
from fracflow.solve.leapfrog.local import (
    BlockDiagonal,
    ChangingLoads,
    LocalMatrix,
    block_diagonal,
    bodies_of,
    groups_of,
    touched,
)
from fracflow.solve.leapfrog.rock import Rock, rock_of

MOST_KEPT = 4  # lengths of steps whose masses with dashpots are kept


def is_plain(operators: Operators) -> bool:
    """Whether rock is plane and each of its nodes has two unknowns of its own, in the order of nodes. Collective."""
    block, layout = operators.blocks.solid, operators.layout
    own, first = block.unknown[: block.owned].ravel(), int(layout.solid_starts[layout.comm.rank])
    here = operators.blocks.sizes.dim == 2 and np.array_equal(own, first + np.arange(layout.solid_count))
    return operators.expand is None and bool(layout.comm.allreduce(int(not here)) == 0)


class Nodes:
    """Local numbers of unknowns, ``own`` and the like. Their places are in ``every``, which lists all.

    Those come first whose outer forces change: of damping, then of loads, joints and springs. Damped ones lie side by side.

    own     those of nodes with supports or dashpots, and of rigid bodies, whose accelerations are found apart from the rest
    no_support  zeros, where no rank holds an unknown; else None. PETSc keeps their norm
    groups  places (c, m) in ``own`` of unknowns whose masses or dashpots are coupled, by their number
    mass    (n,) diagonal, of all local unknowns
    pushed  places in ``every`` of unknowns that changing loads or joints push, and of rigid bodies
    free    places in ``pushed`` of what is neither held nor on a body; ``by_loads`` and ``by_joints`` of what those push
    bodies  (b, r) places in ``pushed`` of rigid bodies; their inverse masses (b, r, r), 0 where held
    pushed_own  places in ``pushed`` of those in ``own``, which are ``own_pushed`` there
    inverse  (p,) of the masses of ``pushed``, 0 where held and on bodies
    """

    def __init__(self, operators: Operators, scene: Scene, loads: Loads, damping: dict[str, MeanDamping]) -> None:
        """Find the nodes of everything. Collective."""
        self.operators, self.loads, joints = operators, loads, operators.joints
        diagonal = operators.mass.getDiagonal()
        self.mass: Floats = diagonal.getArray().copy()
        diagonal.destroy()
        self.acting: list[Term] = [term for term in operators.terms if term.damping is not None]
        springs = [term.stiffness for term in operators.terms if term.stiffness is not None]
        whole, plain = summed(springs), is_plain(operators)
        self.rock: Rock = rock_of(operators, scene, whole, plain)
        if len(springs) > 1:
            destroy(whole)
        self.held = loads.held
        is_free = not operators.layout.comm.allreduce(len(self.held))
        self.no_support = operators.layout.solid_vector() if is_free else None
        bodies = bodies_of(operators)
        is_held, is_own, self.on_body = (np.zeros(len(self.mass), dtype=bool) for _ in range(3))
        is_held[self.held] = is_own[self.held] = self.on_body[bodies] = is_own[bodies] = True
        for term in self.acting:
            is_own[touched(term.damping)] = True
        if plain:
            is_own = np.repeat(is_own.reshape(-1, 2).any(axis=1), 2)
        self.own: Ints = np.flatnonzero(is_own)
        self.rock.hold(is_own, self.mass)
        self.groups = groups_of(operators, self.own, plain)
        self.inertia = block_diagonal(operators.mass, self.own, self.groups)
        self.dashpots = {term.name: block_diagonal(term.damping, self.own, self.groups) for term in self.acting}
        self._inverses: dict[float, BlockDiagonal] = {}

        self.jump = LocalMatrix(joints.jump, touched(joints.jump), square=False)
        self.sizes = LocalMatrix(joints.sizes, self.jump.numbers, square=False)
        self.damping = {
            name: damping_of(each.matrix, _of_nodes(touched(each.matrix), plain), plain)
            for name, each in damping.items()
        }
        self.springs = {
            term.name: LocalMatrix(term.stiffness, touched(term.stiffness), square=True)
            for term in operators.terms
            if term.stiffness is not None
        }
        self.changing = ChangingLoads(loads, operators.layout)
        damped, sprung = ([each.numbers for each in those.values()] for those in (self.damping, self.springs))
        forced = _and_others(
            _and_others(np.zeros(0, np.int64), damped), [self.changing.numbers, self.jump.numbers, *sprung]
        )
        self.every: Ints = _and_others(forced, [self.held, self.own])
        self._sorted = np.argsort(self.every)
        self.places: Ints = self.rock.places[self.every]
        self.is_held, self.on_body = is_held[self.every], self.on_body[self.every]
        self.at_held, self.at_own, self.at_jump = (self.find(each) for each in (self.held, self.own, self.jump.numbers))
        self.at_loads = self.find(self.changing.numbers)
        self.at_damped = {name: _as_slice(self.find(each.numbers)) for name, each in self.damping.items()}
        self.at_springs = {name: self.find(each.numbers) for name, each in self.springs.items()}
        self.places_forced, self.places_own = self.places[: len(forced)], self.places[self.at_own]
        self._find_pushed(operators, bodies)
        self.free_bodies = np.flatnonzero((self.on_body & ~self.is_held)[self.at_own])
        self.held_of_own = np.searchsorted(self.own, self.held)
        force = operators.layout.solid_vector()
        self.waves = [term for term in self.acting if term.incoming(0.0, AT_ONCE, force) is not None]
        force.destroy()
        self.prestress = np.zeros(self.rock.e.shape)
        self.rock.begin(operators.prestress, self.prestress)

    def _find_pushed(self, operators: Operators, bodies: Ints) -> None:
        self.pushed: Ints = np.unique(np.concatenate([self.at_loads, self.at_jump, self.find(bodies).ravel()]))
        self.places_pushed: Ints = self.places[self.pushed]
        is_held = self.is_held[self.pushed]
        is_free = ~is_held & ~self.on_body[self.pushed]
        self.inverse = np.zeros(len(self.pushed))
        self.inverse[is_free] = 1.0 / self.mass[self.every[self.pushed[is_free]]]
        self.free = np.flatnonzero(is_free)
        self.by_loads, self.by_joints = (np.searchsorted(self.pushed, each) for each in (self.at_loads, self.at_jump))
        self.bodies = np.searchsorted(self.pushed, self.find(bodies))
        whole = block_diagonal(operators.mass, np.arange(len(self.mass)), [bodies]).blocks[0]
        self.inverse_of_bodies = _inverted(whole, ~is_held[self.bodies])
        both = np.intersect1d(self.pushed, self.at_own)
        self.pushed_own, in_order = np.searchsorted(self.pushed, both), np.argsort(self.at_own)
        self.own_pushed = in_order[np.searchsorted(self.at_own, both, sorter=in_order)]

    def find(self, numbers: Ints) -> Ints:
        """Places (n,) of local numbers (n,) in ``every``."""
        return np.asarray(self._sorted[np.searchsorted(self.every, numbers, sorter=self._sorted)])

    def prescribed(self, value: Callable[[PrescribedValues], float | Floats]) -> Floats:
        """Values (n,) of all supports at their unknowns, one after the other as in ``held``."""
        found = [np.broadcast_to(value(part), part.numbers.shape) for part in self.loads.supports if len(part.numbers)]
        return np.concatenate([np.zeros(0), *found])

    def accelerated(self, force: Floats) -> Floats:
        """M^-1 times forces (n,) at ``pushed``; nothing where held."""
        result = self.inverse * force
        if len(self.bodies):
            result[self.bodies] = np.einsum("bij,bj->bi", self.inverse_of_bodies, force[self.bodies])
        return result

    def inverse_with_dashpots(self, dt: float) -> BlockDiagonal:
        """(M + dt/2 C)^-1 at ``own``; nothing where held."""
        if dt not in self._inverses:
            if len(self._inverses) == MOST_KEPT:
                self._inverses.clear()
            found, is_held = [], self.is_held[self.at_own]
            for i, (members, mass) in enumerate(zip(self.groups, self.inertia.blocks, strict=True)):
                matrix = np.zeros(mass.shape)
                for dashpot in self.dashpots.values():
                    matrix += 0.5 * dt * dashpot.blocks[i]
                found.append(_inverted(matrix + mass, ~is_held[members]))
            self._inverses[dt] = BlockDiagonal(self.groups, found)
        return self._inverses[dt]

    def destroy(self) -> None:
        """Free matrices. Collective."""
        destroy(self.no_support, self.rock, self.jump, self.sizes, *self.damping.values(), *self.springs.values())


def _and_others(numbers: Ints, more: list[Ints]) -> Ints:
    """Numbers (n,) in their order, and behind them all others of some lists."""
    return np.concatenate([numbers, np.setdiff1d(np.concatenate([numbers, *more]), numbers)])


def _of_nodes(numbers: Ints, by_nodes: bool) -> Ints:
    """Unknowns (n,), with the other one of each node where there are two a node."""
    if not by_nodes:
        return numbers
    return np.asarray((2 * np.unique(numbers // 2)[:, None] + np.arange(2)).ravel())


def _as_slice(places: Ints) -> Ints | slice:
    """Places (n,) one after the other as a slice, which needs no copy; others as they are."""
    first = int(places[0]) if len(places) else 0
    return slice(first, first + len(places)) if np.array_equal(places, first + np.arange(len(places))) else places


def _inverted(matrix: Floats, free: Bools) -> Floats:
    """Inverse of matrices (c, m, m) on what is free (c, m); nothing elsewhere."""
    kept = free[:, :, None] & free[:, None, :]
    found: Floats = np.where(kept, np.linalg.inv(np.where(kept, matrix, np.eye(matrix.shape[1]))), 0.0)
    return found
