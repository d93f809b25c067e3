"""Nodes of an explicit step on which more than the rock acts: joints, supports, dashpots, damping, springs and loads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fracflow._petsc import destroy
from fracflow.mesh.data import Floats, Ints
from fracflow.model.dirichlet import PrescribedValues
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.terms.term import MeanDamping, Term, summed
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import AT_ONCE
from fracflow.solve.leapfrog.local import ChangingLoads, LocalMatrix, at_nodes, touched
from fracflow.solve.leapfrog.rock import Rock, rock_of

MOST_KEPT = 4  # lengths of steps whose masses with dashpots are kept


def takes(operators: Operators) -> bool:
    """Whether a scene is one for these steps: plane rock whose nodes move freely, without fluid. Collective."""
    if operators.flow is not None or operators.expand is not None or operators.inward is not None:
        return False
    block, layout = operators.blocks.solid, operators.layout
    own, first = block.unknown[: block.owned].ravel(), int(layout.solid_starts[layout.comm.rank])
    is_plain = operators.blocks.sizes.dim == 2 and np.array_equal(own, first + np.arange(layout.solid_count))
    every = np.arange(block.owned)
    is_nodal = [at_nodes(term.damping, every) is not None for term in operators.terms if term.damping is not None]
    return bool(layout.comm.allreduce(int(not is_plain)) == 0 and all(is_nodal))


class Nodes:
    """Local numbers of unknowns, ``own`` and the like. Their places are in ``every``, which lists all.

    own     those of nodes with supports or dashpots, whose accelerations are found apart from the rest
    mass    (n,) of all local unknowns; ``inverse`` of those in ``every``, 0 where held
    """

    def __init__(self, operators: Operators, scene: Scene, loads: Loads, damping: dict[str, MeanDamping]) -> None:
        """Find the nodes of everything. Collective."""
        self.operators, self.loads, joints = operators, loads, operators.joints
        diagonal = operators.mass.getDiagonal()
        self.mass: Floats = diagonal.getArray().copy()
        diagonal.destroy()
        self.acting: list[Term] = [term for term in operators.terms if term.damping is not None]
        springs = [term.stiffness for term in operators.terms if term.stiffness is not None]
        whole = summed(springs)
        self.rock: Rock = rock_of(operators, scene, whole)
        if len(springs) > 1:
            destroy(whole)
        self.held = loads.held
        is_held = np.zeros(len(self.mass), dtype=bool)
        is_held[self.held] = True
        at_node = np.zeros(len(self.mass) // 2, dtype=bool)
        at_node[self.held // 2] = True
        for term in self.acting:
            at_node[touched(term.damping) // 2] = True
        nodes = np.flatnonzero(at_node)
        self.own: Ints = (2 * nodes[:, None] + np.arange(2)).ravel()
        self.rock.hold(np.repeat(at_node, 2), self.mass)
        self.dashpots = {term.name: _blocks(term.damping, nodes) for term in self.acting}
        self._inverses: dict[float, Floats] = {}

        self.jump = LocalMatrix(joints.jump, touched(joints.jump), square=False)
        self.sizes = LocalMatrix(joints.sizes, self.jump.numbers, square=False)
        self.damping = {
            name: LocalMatrix(each.matrix, touched(each.matrix), square=True) for name, each in damping.items()
        }
        self.springs = {
            term.name: LocalMatrix(term.stiffness, touched(term.stiffness), square=True)
            for term in operators.terms
            if term.stiffness is not None
        }
        self.changing = ChangingLoads(loads, operators.layout)
        local = [self.jump, *self.damping.values(), *self.springs.values()]
        numbers = [self.held, self.own, self.changing.numbers, *(each.numbers for each in local)]
        self.every: Ints = np.unique(np.concatenate(numbers))
        self.places: Ints = self.rock.places[self.every]
        self.is_held = is_held[self.every]
        self.inverse: Floats = np.where(self.is_held, 0.0, 1.0 / self.mass[self.every])
        self.at_held, self.at_own, self.at_jump = (self.find(each) for each in (self.held, self.own, self.jump.numbers))
        self.at_loads = self.find(self.changing.numbers)
        self.at_damped = {name: self.find(each.numbers) for name, each in self.damping.items()}
        self.at_springs = {name: self.find(each.numbers) for name, each in self.springs.items()}
        self.held_of_own = np.searchsorted(self.own, self.held)
        force = operators.layout.solid_vector()
        self.waves = [term for term in self.acting if term.incoming(0.0, AT_ONCE, force) is not None]
        force.destroy()
        self.prestress = np.zeros(self.rock.e.shape)
        self.rock.begin(operators.prestress, self.prestress)

    def find(self, numbers: Ints) -> Ints:
        """Places (n,) of local numbers (n,) in ``every``."""
        return np.searchsorted(self.every, numbers)

    def prescribed(self, value: Callable[[PrescribedValues], float | Floats]) -> Floats:
        """Values (n,) of all supports at their unknowns, one after the other as in ``held``."""
        found = [np.broadcast_to(value(part), part.numbers.shape) for part in self.loads.supports if len(part.numbers)]
        return np.concatenate([np.zeros(0), *found])

    def inverse_with_dashpots(self, dt: float) -> Floats:
        """(M + dt/2 C)^-1 at the nodes of ``own`` (n, 2, 2); nothing where held."""
        if dt not in self._inverses:
            if len(self._inverses) == MOST_KEPT:
                self._inverses.clear()
            matrix, both = np.zeros((len(self.own) // 2, 2, 2)), np.arange(2)
            for blocks in self.dashpots.values():
                matrix += 0.5 * dt * blocks
            matrix[:, both, both] += self.mass[self.own].reshape(-1, 2)
            free = ~self.is_held[self.at_own].reshape(-1, 2)
            kept = free[:, :, None] & free[:, None, :]
            self._inverses[dt] = np.where(kept, np.linalg.inv(np.where(kept, matrix, np.eye(2))), 0.0)
        return self._inverses[dt]

    def destroy(self) -> None:
        """Free matrices. Collective."""
        destroy(self.rock, self.jump, self.sizes, *self.damping.values(), *self.springs.values())


def _blocks(matrix: Any, nodes: Ints) -> Floats:
    blocks = at_nodes(matrix, nodes)
    assert blocks is not None
    return blocks
