"""Jumps of long wavelength: hat functions of a coarse grid, cut by the fractures (Hansbo and Hansbo 2004).

The support of a hat is parted where fractures cut it. Each part moves alone, so that parts jump, slide and open. The hats of a
part sum to 1 and to its coordinates, and every block of rock can also move rigidly.

Hats cover the whole rock, since rock as far away as its wavelength resists a slip. Hats along the fractures alone resist it too
much, by the ratio of that wavelength to their size. Iterations then grow with the root of that ratio.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import Blocks, owner_of, petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.graph import components
from fracflow.mesh.shared import Shared
from fracflow.model.layout import Layout, create_matrix

AT_CROSSINGS = 4  # joints at a flow node, each of which may part a hat in another way


@dataclass(frozen=True)
class Hats:
    """The hats of a grid at local nodes, 2^dim each.

    number  (n, 2^dim) of the hat on the grid, -1 where it is zero
    value   (n, 2^dim) of the hat at the node
    count   of the grid
    """

    number: Ints
    value: Floats
    count: int


def hats(blocks: Blocks, size: float) -> Hats:
    """Products of linear functions on a grid of cells of ``size``, at the local nodes. Collective."""
    points, dim = blocks.solid.points, blocks.sizes.dim
    low, high = _extent(blocks)
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


def _extent(blocks: Blocks) -> Floats:
    """Lowest and highest coordinates (2, dim) of the mesh. Collective."""
    points = blocks.solid.points
    extremes = np.stack([points.min(axis=0), -points.max(axis=0)]) if len(points) else np.inf
    found = blocks.comm.allgather(np.broadcast_to(extremes, (2, blocks.sizes.dim)))
    return np.min(found, axis=0) * np.array([[1.0], [-1.0]])


def grid_sizes(blocks: Blocks, wall: Bools, length: float, nodes: float) -> list[float]:
    """Cells of the grids [length], ascending: at joints of a mean ``length``, then about four times as large each.

    wall (n,) local nodes that are walls; nodes of the mesh along an edge of a cell

    The last serves the whole rock, and there is no other where the mesh is about as fine everywhere. Collective.
    """
    low, high = _extent(blocks)
    mean = (float(np.prod(high - low)) / blocks.sizes.nodes) ** (1.0 / blocks.sizes.dim)
    if not blocks.comm.allreduce(bool(wall.any()), op=MPI.LOR):
        return [nodes * mean]
    ratio = max(mean / length, 1.0)
    steps = round(np.log(ratio) / np.log(4.0))
    return [nodes * length * ratio ** (step / max(steps, 1)) for step in range(steps + 1)]


def coarse_jumps(
    blocks: Blocks, layout: Layout, nodes: Shared, wall: Bools, sizes: list[float], held: Ints
) -> PETSc.Mat:
    """W: unknowns of a step from the parts of hats, ``dim`` components each, and from pressures in the fractures between them.

    nodes  shares values of nodes; wall (n,) local nodes that are walls
    held   numbers of unknowns, of this rank and of its joints, that no part moves
    sizes  of the grids' cells [length], the last for all rock, others for hats that fractures cut

    Each part of a hat but the first has a pressure, on the joints between it and parts before it. So no pressure is without an
    opening that it acts on, and a stiffness. The caller destroys W. Collective.
    """
    block, joints, dim, comm = blocks.solid, blocks.joints, blocks.sizes.dim, blocks.comm
    corners, has_flow = 2**dim, int(layout.flow_starts[-1]) > 0
    entry = block.node_global[:, None] * corners + np.arange(corners)
    is_mine = (np.arange(len(block.points)) < block.owned)[:, None]
    grids, widths = [], []
    for size in sizes:
        found = hats(blocks, size)
        label, least = _parts(blocks, nodes, wall, found, only_cut=size < sizes[-1])
        grids.append((label, found.value))
        widths.append(np.where((label == entry) & is_mine, dim + (has_flow & (label > least)), 0))
    before = np.cumsum([0, *(int(width.sum()) for width in widths)])
    counts = np.array(comm.allgather(int(before[-1])))
    starts = np.concatenate([[0], np.cumsum(counts)])

    own = np.flatnonzero(owner_of(block.unknown_starts, block.unknown) == comm.rank)
    is_moved = np.zeros(block.unknown.shape, dtype=bool)  # tied nodes share an unknown: it has the value of the first
    is_moved.flat[own[np.unique(block.unknown.flat[own], return_index=True)[1]]] = True
    rows_here = layout.solid_count + layout.flow_count, layout.total
    room = np.repeat([1, AT_CROSSINGS], [layout.solid_count, layout.flow_count]) * corners * len(grids)
    result = create_matrix((rows_here, (int(counts[comm.rank]), int(starts[-1]))), room, comm)

    def place(rows: Ints, cols: Ints, values: Floats) -> None:
        values = np.where(np.isin(rows, held), 0.0, values)
        places = petsc_ints(rows[:, None]), petsc_ints(cols[:, None])
        if len(rows):  # each joint says anew what its ends have
            result.setValuesRCV(*places, values.reshape(-1, 1, 1), PETSc.InsertMode.INSERT)

    for (label, value), width, earlier in zip(grids, widths, before[:-1], strict=True):
        first = np.where(
            width > 0, starts[comm.rank] + earlier + (np.cumsum(width) - width.ravel()).reshape(width.shape), -1
        )
        labels, which = np.unique(label[label >= 0.0].astype(np.int64), return_inverse=True)
        of_entries = Shared(comm, block.owned * corners, blocks.sizes.nodes * corners, labels)
        column = np.full(label.shape, -1)
        column[label >= 0.0] = of_entries.of_owners(first[: block.owned].ravel().astype(float))[which]
        of_entries.destroy()
        node, corner = np.nonzero(label >= 0.0)
        moved = is_moved[node]
        cols = (column[node, corner][:, None] + np.arange(dim))[moved]
        values = np.broadcast_to(value[node, corner][:, None], moved.shape)[moved]
        place(layout.solid_numbers(block.unknown[node][moved]), cols, values)
        below, above = label[joints.bottom], label[joints.top]
        parted = np.nonzero((below != above) & has_flow)
        later = np.where(below > above, column[joints.bottom], column[joints.top])[parted]
        place(layout.flow_numbers(joints.flow[parted[:2]]), later + dim, value[joints.bottom][parted])
    result.assemble()
    return result


def _parts(blocks: Blocks, nodes: Shared, wall: Bools, found: Hats, only_cut: bool) -> tuple[Floats, Floats]:
    """Of each hat at each node (n, 2^dim), the first entry of the part that the node is in, and of all parts; -1 for none.

    only_cut  leave out hats that no fracture parts

    Entries are counted by node in PETSc's order, then by corner. Hats that touch no fracture have one part. Collective.
    """
    comm, number, is_used = blocks.comm, found.number, found.number >= 0
    slots = min(found.count, number.shape[1] * blocks.sizes.nodes)  # hats that share one are at most taken for cut
    own = np.diff(np.linspace(0, slots, comm.size + 1).astype(np.int64))[comm.rank]
    here, place = np.unique(number[is_used], return_inverse=True)
    of_hats = Shared(comm, int(own), slots, here % slots)

    def largest(values: Floats) -> Floats:
        result = np.full(len(here), -np.inf)
        np.maximum.at(result, place, values)
        return of_hats.largest(result)[place]

    is_near = np.zeros(number.shape, dtype=bool)
    is_near[is_used] = largest(np.broadcast_to(wall[:, None], number.shape)[is_used].astype(float)) > 0.0
    connected = _labels(blocks, nodes, np.where(is_near, number, -1))
    label, least = np.full(number.shape, -1.0), np.full(number.shape, -1.0)
    least[is_used], most = -largest(-connected[is_used]), largest(connected[is_used])
    of_hats.destroy()
    label[is_used] = np.where(is_near, connected, least)[is_used]
    if only_cut:
        label[is_used] = np.where(is_near[is_used] & (least[is_used] != most), label[is_used], -1.0)
    return label, least


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
