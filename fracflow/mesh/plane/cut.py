"""Cells of a share cut in four, on the rank that has them.

Numbers in a cut mesh follow from those of cells and edges before. So do owners: a node in the middle of an edge has the
owner of the edge, and one inside a cell that of the cell. No rank needs a list of the nodes of others.

Cells come in two groups, of which the first has the lower numbers. Whatever lies on its cells has lower numbers than all
else, at each cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow.mesh.data import Ints
from fracflow.mesh.share import Edges, Share

Pair = tuple[int, int]


@dataclass(frozen=True)
class Counts:
    """How many there are in the whole mesh, on the cells of the first group and elsewhere."""

    nodes: Pair
    edges: Pair
    triangles: Pair
    quads: Pair
    joints: int
    flow_nodes: int

    @property
    def cells(self) -> Pair:
        """Of both shapes."""
        return self.triangles[0] + self.quads[0], self.triangles[1] + self.quads[1]

    def cut(self) -> Counts:
        """The counts once each cell is cut in four."""
        nodes, edges = _Joined(self.nodes, self.edges, self.quads), _halves_and_inner(self)
        return Counts(
            nodes.total, edges.total, _times(4, self.triangles), _times(4, self.quads), 2 * self.joints,
            self.flow_nodes + self.joints,
        )  # fmt: skip


class _Joined:
    """Numbers of things of several kinds, put behind one another, in each group for itself."""

    def __init__(self, *counts: Pair) -> None:
        self.counts, self.total = counts, (sum(near for near, _ in counts), sum(far for _, far in counts))

    def number(self, kind: int, numbers: Ints) -> Ints:
        """Numbers (...) of things of a kind, from their ``numbers`` (...) in it."""
        before, near = self.counts[:kind], self.counts[kind][0]
        low = sum(each for each, _ in before)
        high = self.total[0] + sum(each for _, each in before) - near
        return np.where(numbers < near, numbers + low, numbers + high)


def _times(factor: int, pair: Pair) -> Pair:
    return factor * pair[0], factor * pair[1]


def _halves_and_inner(counts: Counts) -> _Joined:
    return _Joined(_times(2, counts.edges), _times(3, counts.triangles), _times(4, counts.quads))


def cut(share: Share, counts: Counts) -> Share:
    """The share with each cell in four, joint and facet in two; ``counts`` are those of the mesh before.

    Old nodes come first, then those in the middle of edges, then those in the middle of quads. Children of the cell c are
    4 c to 4 c + 3. Those of the joint j are 2 j and 2 j + 1.
    """
    edges = share.edges
    assert edges is not None
    many, is_quad = len(share.node), (share.cells >= 0).sum(axis=1) == 4
    quads = np.flatnonzero(is_quad)
    number = _Joined(counts.nodes, counts.edges, counts.quads)
    centre_number = number.number(2, edges.alike[quads])
    first = share.cells[quads, 0]
    inside = np.full(len(quads), share.rank)
    points = share.points
    middles = 0.5 * (points[edges.ends[:, 0]] + points[edges.ends[:, 1]])
    flow_many = len(share.flow_node)
    cells, side = share.cells, np.where(edges.of_cells >= 0, many + edges.of_cells, -1)
    centre = np.full(len(cells), -1)
    centre[quads] = many + len(edges.number) + np.arange(len(quads))
    middle = many + edges.of_faces  # (j, 2)
    between = np.stack([share.faces[..., 0], middle, middle, share.faces[..., 1]], axis=-1)
    faces = between.reshape(len(share.joint), 2, 2, 2).swapaxes(1, 2)  # (j, child, face, end)
    flow = flow_many + np.arange(len(share.joint))
    along = share.along.mean(axis=1)
    middle = many + edges.of_sides
    facets = np.stack([share.side_facets[:, 0], middle, middle, share.side_facets[:, 1]], axis=1)
    origin = np.concatenate([number.number(0, share.origin), number.number(1, edges.origin), centre_number])
    finer = _cut_edges(share, edges, counts, origin, side, centre)
    cell_of = np.zeros(len(finer.number), dtype=np.int64)
    row, corner = np.nonzero(finer.of_cells >= 0)
    cell_of[finer.of_cells[row, corner]] = row
    return replace(
        share,
        node=np.concatenate([number.number(0, share.node), number.number(1, edges.number), centre_number]),
        points=np.concatenate([points, middles, points[cells[quads]].mean(axis=1)]),
        origin=origin,
        owner=np.concatenate([share.owner, edges.owner, inside]),
        body=np.concatenate([share.body, edges.body, edges.cell_body[quads]]),
        piece=np.concatenate([share.piece, share.piece[edges.ends[:, 0]], share.piece[first]]),
        cell=(4 * share.cell[:, None] + np.arange(4)).ravel(),
        cells=_children(cells, side, centre).reshape(-1, cells.shape[1]),
        cell_rock=np.repeat(share.cell_rock, 4),
        joint=(2 * share.joint[:, None] + np.arange(2)).ravel(),
        faces=faces.reshape(-1, 2, 2),
        fracture=np.repeat(share.fracture, 2),
        along=np.stack([share.along[:, 0], along, along, share.along[:, 1]], axis=1).reshape(-1, 2),
        flow=np.stack([share.flow[:, 0], flow, flow, share.flow[:, 1]], axis=1).reshape(-1, 2),
        flow_node=np.concatenate([share.flow_node, counts.flow_nodes + share.joint]),
        flow_points=np.concatenate([share.flow_points, middles[edges.of_faces[:, 0]]]),
        flow_owner=np.concatenate([share.flow_owner, np.full(len(share.joint), share.rank)]),
        side_facets=facets.reshape(-1, 2),
        side_of=np.repeat(share.side_of, 2),
        side_cell=cell_of[finer.of_sides],
        edges=finer,
    )  # fmt: skip


def _children(corner: Ints, side: Ints, other: Ints) -> Ints:
    """Four children (m, 4, c) of each cell: one at each corner, and of triangles one in the middle.

    corner, side  (m, c)  what is at each corner, and on the edge behind it
    other         (m,)    what quads have in the middle
    """
    children = np.full((len(corner), 4, corner.shape[1]), -1)
    for k in (3, 4):
        rows = np.flatnonzero((corner >= 0).sum(axis=1) == k)
        for i in range(k if len(rows) else 0):
            middle = [] if k == 3 else [other[rows]]
            children[rows, i, :k] = np.stack(
                [corner[rows, i], side[rows, i], *middle, side[rows, (i or k) - 1]], axis=1
            )
        if k == 3 and len(rows):
            children[rows, 3, :3] = side[rows, :3]
    return children


def _cut_edges(share: Share, edges: Edges, counts: Counts, origin: Ints, side: Ints, centre: Ints) -> Edges:
    """Halves of the edges, two by two, the first one at the end of the lower origin; then those inside cells.

    Inside a triangle the edge i joins the middles behind the corners i and i - 1. Inside a quad it joins the middle behind i
    to the centre. Arguments as of ``_children``; origin (n,) of the new nodes.
    """
    number, many, cells = _halves_and_inner(counts), len(edges.number), share.cells
    inner, after = np.full(cells.shape, -1), np.full(cells.shape, -1)
    before, numbers, ends, bodies = 2 * many, [], [], []
    for kind, k in enumerate((3, 4), 1):
        rows = np.flatnonzero((cells >= 0).sum(axis=1) == k)
        if not len(rows):
            continue
        inner[rows, :k] = before + np.arange(k * len(rows)).reshape(-1, k)
        after[rows, :k] = np.roll(cells[rows, :k], -1, axis=1)
        before += k * len(rows)
        numbers.append(number.number(kind, (k * edges.alike[rows][:, None] + np.arange(k)).ravel()))
        here = side[rows, :k]
        there = np.roll(here, 1, axis=1) if k == 3 else np.repeat(centre[rows][:, None], k, axis=1)
        ends.append(np.stack([here, there], axis=-1).reshape(-1, 2))
        bodies.append(np.repeat(edges.cell_body[rows], k))
    middle = len(share.node) + np.arange(many)
    pairs = np.concatenate([np.stack([edges.ends, np.stack([middle, middle], axis=1)], axis=-1).reshape(-1, 2), *ends])
    turned = origin[pairs[:, 0]] > origin[pairs[:, 1]]
    pairs[turned] = pairs[turned][:, ::-1]

    def numbered(of: Ints) -> Ints:
        return np.concatenate([number.number(0, (2 * of[:, None] + np.arange(2)).ravel()), *numbers])

    def half(edge: Ints, node: Ints) -> Ints:
        """The half of each edge at one of its ends."""
        return np.where(edge >= 0, 2 * edge + (node != edges.ends[edge, 0]), -1)

    return Edges(
        number=numbered(edges.number),
        origin=numbered(edges.origin),
        owner=np.concatenate([np.repeat(edges.owner, 2), np.full(sum(map(len, bodies)), share.rank)]),
        body=np.concatenate([np.repeat(edges.body, 2), *bodies]),
        ends=pairs,
        of_cells=_around_children(half(edges.of_cells, cells), half(edges.of_cells, after), inner),
        of_faces=half(edges.of_faces[:, :, None], share.faces).swapaxes(1, 2).reshape(-1, 2),
        of_sides=half(edges.of_sides[:, None], share.side_facets).ravel(),
        alike=(4 * edges.alike[:, None] + np.arange(4)).ravel(),
        cell_body=np.repeat(edges.cell_body, 4),
    )


def _around_children(here: Ints, there: Ints, inner: Ints) -> Ints:
    """Edges (4 m, c) of the children, from those inside each cell (m, c) and the halves at both ends of each of its edges."""
    edges = np.full((len(here), 4, here.shape[1]), -1)
    for k in (3, 4):
        rows = np.flatnonzero((here >= 0).sum(axis=1) == k)
        for i in range(k if len(rows) else 0):
            before = (i or k) - 1
            middle = [inner[rows, i]] if k == 3 else [inner[rows, i], inner[rows, before]]
            edges[rows, i, :k] = np.stack([here[rows, i], *middle, there[rows, before]], axis=1)
        if k == 3 and len(rows):
            edges[rows, 3, :3] = inner[rows][:, [1, 2, 0]]
    return edges.reshape(-1, here.shape[1])
