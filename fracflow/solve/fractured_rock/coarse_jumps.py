"""Jumps of long wavelength: hat functions of a coarse grid, cut by the fractures (Hansbo and Hansbo 2004).

The support of a hat is parted where fractures cut it. Each part moves alone, so that parts jump, slide and open. The hats of a
part sum to 1 and to its coordinates, and every block of rock can also move rigidly.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.graph import components
from fracflow.model.layout import Layout, add_blocks, create_matrix
from fracflow.solve.fractured_rock.shared import Shared


@dataclass(frozen=True)
class Hats:
    """The hats at local nodes, 2^dim each.

    number  (n, 2^dim) of the hat on the grid, -1 where it is zero or far from all fractures
    value   (n, 2^dim) of the hat at the node
    count   of the grid
    """

    number: Ints
    value: Floats
    count: int


def hats(blocks: Blocks, size: float) -> Hats:
    """Products of linear functions on a grid of cells of ``size``, at the local nodes. Collective."""
    points, comm = blocks.solid.points, blocks.comm
    dim = blocks.sizes.dim
    extremes = np.stack([points.min(axis=0), -points.max(axis=0)]) if len(points) else np.full((2, dim), np.inf)
    low, high = np.min(comm.allgather(extremes), axis=0) * [[1.0], [-1.0]]
    shape = np.floor((high - low) / size).astype(np.int64) + 2
    cell = np.floor((points - low) / size).astype(np.int64)
    within = (points - low) / size - cell
    number = np.zeros((len(points), 2**dim), dtype=np.int64)
    value = np.ones((len(points), 2**dim))
    for corner, sides in enumerate(product((0, 1), repeat=dim)):
        number[:, corner] = np.ravel_multi_index((cell + sides).T, shape)
        for axis, side in enumerate(sides):
            value[:, corner] *= within[:, axis] if side else 1.0 - within[:, axis]
    number[value < 1e-9] = -1
    return Hats(number, value, int(shape.prod()))


def coarse_jumps(blocks: Blocks, layout: Layout, nodes: Shared, wall: Bools, size: float, held: Ints) -> PETSc.Mat:
    """W: unknowns of a step from the parts of cut hats, ``dim`` components each, and from all pressures.

    nodes  shares values of nodes; wall (n,) local nodes that are walls; size of the grid's cells [length];
    held  numbers of unknowns that no part moves

    The caller destroys W. Collective.
    """
    block, dim, comm = blocks.solid, blocks.sizes.dim, blocks.comm
    found = hats(blocks, size)
    number, corners = found.number, 2**dim
    own = np.diff(np.linspace(0, found.count, comm.size + 1).astype(np.int64))[comm.rank]
    here, place = np.unique(number[number >= 0], return_inverse=True)
    of_hats = Shared(comm, int(own), found.count, here)
    touches = np.zeros(len(here))
    np.maximum.at(touches, place, np.broadcast_to(wall[:, None], number.shape)[number >= 0])
    is_near = np.zeros(number.shape, dtype=bool)
    is_near[number >= 0] = (of_hats.largest(touches) > 0.0)[place]
    label = _labels(blocks, nodes, np.where(is_near, number, -1))
    least, most = np.full(len(here), -np.inf), np.full(len(here), -np.inf)
    near = is_near[number >= 0]
    np.maximum.at(most, place[near], label[is_near])
    np.maximum.at(least, place[near], -label[is_near])
    is_cut = np.zeros(number.shape, dtype=bool)
    is_cut[number >= 0] = (of_hats.largest(most) != -of_hats.largest(least))[place] & near
    of_hats.destroy()

    mine = np.arange(len(number)) < block.owned
    entry = block.node_global[:, None] * corners + np.arange(corners)
    is_root = is_cut & mine[:, None] & (label == entry)
    parts = np.array(comm.allgather(int(is_root.sum())))
    sizes = dim * parts + np.array(comm.allgather(layout.flow_count))
    starts = np.concatenate([[0], np.cumsum(sizes)])
    first = np.full(number.shape, -1.0)
    first[is_root] = starts[comm.rank] + dim * np.arange(parts[comm.rank])
    chosen = is_cut & mine[:, None] & (block.body < 0)[:, None]
    roots, which = np.unique(label[chosen].astype(np.int64), return_inverse=True)
    of_entries = Shared(comm, block.owned * corners, blocks.sizes.nodes * corners, roots)
    column = of_entries.of_owners(first[: block.owned].ravel()).astype(np.int64)[which]
    of_entries.destroy()

    rows_here = layout.solid_count + layout.flow_count, layout.total
    result = create_matrix((rows_here, (int(sizes[comm.rank]), int(starts[-1]))), corners, comm)
    node, corner = np.nonzero(chosen)
    rows = layout.solid_numbers(block.unknown[node]).reshape(-1, 1)
    cols = (column[:, None] + np.arange(dim)).reshape(-1, 1)
    values = np.repeat(found.value[node, corner], dim)
    values[np.isin(rows[:, 0], held)] = 0.0
    add_blocks(result, rows, cols, values.reshape(-1, 1, 1))
    pressure = np.arange(layout.flow_count)
    rows, cols = layout.start + layout.solid_count + pressure, starts[comm.rank] + dim * parts[comm.rank] + pressure
    add_blocks(result, rows[:, None], cols[:, None], np.ones((len(rows), 1, 1)))
    result.assemble()
    return result


def _labels(blocks: Blocks, nodes: Shared, number: Ints) -> Floats:
    """Of each hat at each node (n, 2^dim), the first entry of the part of its support that the node is in. Collective.

    Entries are counted by node in PETSc's order, then by corner. Nodes of a cell are in one part.
    """
    corners = number.shape[1]
    entry = (blocks.solid.node_global[:, None] * corners + np.arange(corners)).astype(float)
    part = _local_parts(blocks.solid.cells, number)
    label, count = entry.copy(), int(part.max(initial=-1)) + 1
    while True:
        least = np.full(count, np.inf)
        np.minimum.at(least, part[number >= 0], label[number >= 0])
        now = label.copy()
        now[number >= 0] = least[part[number >= 0]]
        for corner in range(corners):
            now[:, corner] = -nodes.largest(-now[:, corner])
        if not blocks.comm.allreduce(bool((now != label).any()), op=MPI.LOR):
            return now
        label = now


def _local_parts(cells: Ints, number: Ints) -> Ints:
    """Numbers (n, 2^dim) of the connected parts of supports as this rank's cells (m, c) connect them."""
    corners = number.shape[1]
    cells = cells[((number[cells] >= 0).any(axis=2) & (cells >= 0)).any(axis=1)]
    entries = np.where(cells[:, :, None] >= 0, cells[:, :, None] * corners + np.arange(corners), -1)
    which = np.where(cells[:, :, None] >= 0, number[cells], -1).reshape(len(cells), -1)
    entries = entries.reshape(len(cells), -1)
    order = np.argsort(which, axis=1, kind="stable")
    which, entries = np.take_along_axis(which, order, axis=1), np.take_along_axis(entries, order, axis=1)
    joins = (which[:, 1:] == which[:, :-1]) & (which[:, 1:] >= 0)
    one, other = entries[:, 1:][joins], entries[:, :-1][joins]
    return components(one, other, number.size).reshape(number.shape)
