"""Tips in meshed rock: the stiffness of ``elements.tip`` taken off the rock's, each found from the cells around it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracflow.elements.tip import REACH, Excess, at_tip
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.operators import Operators
from fracflow.model.solid import deformable, elasticity, nodal_layout, node_unknowns, projected
from fracflow.model.terms.term import Term
from fracflow.remarks import note
from fracflow.scene.scene import Scene


class Around(NamedTuple):
    """Cells of one rank around one tip: numbers (m,), corners (m, k) in the split mesh, -1 pads, and their places (m, k, 2).

    moduli  (m, 3, 3) [stress]
    """

    ids: Ints
    nodes: Ints
    places: Floats
    moduli: Floats


class Tips(Term):
    """Less stiffness of the first joint at all tips of a scene; its work is what cells there store too much."""

    name = entry = "tips"
    stores = True

    def __init__(self, operators: Operators, found: list[tuple[Ints, Floats]], missing: int) -> None:
        """Of local nodes (2,), right and left, and their excess (2, 2), at this rank's tips; how many have none. Collective."""
        blocks, self._missing = operators.blocks, missing
        nodes = np.array([walls for walls, _ in found], dtype=np.int64).reshape(-1, 2)
        excess = np.array([modulus for _, modulus in found], dtype=float).reshape(-1, 2, 2)
        both = np.array([[-1.0, 1.0], [1.0, -1.0]])
        values = np.einsum("ab,nij->naibj", both, excess).reshape(-1, 4, 4)
        numbers = node_unknowns(blocks, nodes).reshape(-1, 4)
        matrix = create_matrix((nodal_layout(blocks), nodal_layout(blocks)), 4, blocks.comm)
        add_blocks(matrix, numbers, numbers, values)
        matrix.assemble()
        self.stiffness = projected(matrix, operators.expand)

    @property
    def notes(self) -> tuple[str, ...]:
        """A line on tips that stay as their cells have them."""
        if not self._missing:
            return ()
        why = "other fractures, sides or two rocks beside them, or under three joints"
        return (note(f'method.tips = "corrected": {self._missing} ends of fractures stay plain: {why}'),)


class Unmeshed(Term):
    """The entry of the balance in rock that is not meshed, whose tips need nothing here."""

    name = entry = "tips"
    stores = True


def tips(operators: Operators, scene: Scene) -> tuple[Term, ...]:
    """The term of a scene whose tips are corrected, if it has tips. Raises InputError in space, on every rank. Collective."""
    blocks = operators.blocks
    if scene.method.tips == "plain":
        return ()
    if scene.is_unbounded:  # an event may mesh the rock, and entries of the balance stay
        return (Unmeshed(),) if scene.has_dynamics else ()
    if blocks.sizes.dim != 2:
        raise InputError('method.tips = "corrected": holds for meshes in the plane alone; leave it out')
    found = excesses(blocks, scene)
    ends = int(np.count_nonzero(blocks.joints.bottom == blocks.joints.top))
    count, corrected = blocks.comm.allreduce(np.array([ends, len(found)])).tolist()
    return (Tips(operators, found, count - corrected),) if count else ()


def excesses(blocks: Blocks, scene: Scene) -> list[tuple[Ints, Floats]]:
    """Local nodes (2,) beside each tip of this rank's joints, right and left, and the excess (2, 2). Collective."""
    joints, solids, comm = blocks.joints, blocks.solid, blocks.comm
    joint, end = np.nonzero(joints.bottom == joints.top)
    tip, first = joints.bottom[joint, end], joints.bottom[joint, 1 - end]
    place = solids.points[tip]
    reach = REACH * np.linalg.norm(solids.points[first] - place, axis=1)
    asked = comm.allgather((place, reach))
    here = _Cells.of(blocks, scene)
    parts = comm.alltoall([[here.around(*each) for each in zip(*there, strict=True)] for there in asked])
    local = {int(number): at for at, number in enumerate(solids.node_ids)}
    found = []
    for k, number in enumerate(solids.node_ids[tip].tolist()):
        excess = _excess(number, [part[k] for part in parts])
        if excess is not None:
            found.append((np.array([local[wall] for wall in excess.walls]), excess.modulus))
    return found


class _Cells(NamedTuple):
    """This rank's cells, and its nodes in the order of x."""

    blocks: Blocks
    moduli: Floats
    order: Ints
    of_node: tuple[Ints, Ints]

    @classmethod
    def of(cls, blocks: Blocks, scene: Scene) -> _Cells:
        """Those of rock that deforms; moduli of rigid rock are NaN."""
        solids = blocks.solid
        moduli = np.full((len(solids.cells), 3, 3), np.nan)
        soft = deformable(blocks, scene)
        moduli[soft] = elasticity(blocks, scene)[soft]
        cell, corner = np.nonzero(solids.cells >= 0)
        node = solids.cells[cell, corner]
        by_node = np.argsort(node, kind="stable")
        starts = np.searchsorted(node[by_node], np.arange(len(solids.points) + 1))
        return cls(blocks, moduli, np.argsort(solids.points[:, 0], kind="stable"), (starts, cell[by_node]))

    def around(self, place: Floats, reach: float) -> Around:
        """Those with a node within ``reach`` of a place (2,)."""
        solids, (starts, cells) = self.blocks.solid, self.of_node
        x = solids.points[self.order, 0]
        low, high = np.searchsorted(x, place[0] - reach), np.searchsorted(x, place[0] + reach, side="right")
        near = self.order[low:high]
        near = near[np.linalg.norm(solids.points[near] - place, axis=1) <= reach]
        chosen = np.unique(np.concatenate([cells[:0], *(cells[starts[node] : starts[node + 1]] for node in near)]))
        corners = solids.cells[chosen]
        ids = np.where(corners >= 0, solids.node_ids[corners], -1)
        return Around(solids.cell_ids[chosen], ids, solids.points[corners], self.moduli[chosen])


def _excess(tip: int, parts: list[Around]) -> Excess | None:
    """That of a tip, by its number, among the cells that ranks have around it; None in rock of two kinds."""
    width = max(part.nodes.shape[1] for part in parts)
    wide = [np.pad(part.nodes, ((0, 0), (0, width - part.nodes.shape[1])), constant_values=-1) for part in parts]
    order = np.argsort(np.concatenate([part.ids for part in parts]))
    cells = np.concatenate(wide)[order]
    moduli = np.concatenate([part.moduli for part in parts])[order]
    if not (moduli == moduli[0]).all():
        return None
    points_of = {
        node: place
        for part in parts
        for nodes, places in zip(part.nodes.tolist(), part.places, strict=True)
        for node, place in zip(nodes, places, strict=True)
        if node >= 0
    }
    numbers = sorted(points_of)
    local = np.where(cells >= 0, np.searchsorted(numbers, cells), -1)
    found = at_tip(np.array([points_of[number] for number in numbers]), local, numbers.index(tip), moduli[0])
    return found and found._replace(walls=(numbers[found.walls[0]], numbers[found.walls[1]]))
