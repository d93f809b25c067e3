"""Fractures without a mesh of the rock around them: their traces cut into joints, and a wall on each side of these.

The cells are the walls themselves, lines of two nodes: first those below, then those above. Walls that enclose rock cut out a
block.
"""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.plane.sizes import Source
from fracflow.mesh.plane.traces import TraceNetwork
from fracflow.mesh.split import arc_length

FINER = 4.0  # samples of the mesh size, in a joint
MAP = 48  # squares along a map
NEARLY = 0.01  # of a joint: a trace that is so much longer takes no joint more


def cut(
    network: TraceNetwork, around: list[Source], fine: float, growth: float, halvings: int
) -> tuple[Floats, Ints, Ints]:
    """Points (n, 2), joints (f, 2) along their traces, and the trace (f,) of each.

    around    sizes, and the points that have them within half of it; from there they grow by ``growth`` to ``fine``
    halvings  of all joints at the end
    """
    own = network.owner >= 0
    used, edges = np.unique(network.edges[own], return_inverse=True)
    points, facets, owners, count = [network.points[used]], [], [], len(used)
    for (start, end), owner in zip(edges.reshape(-1, 2), network.owner[own], strict=True):
        ends = points[0][[start, end]]
        along = _division(ends, around, fine, growth)
        parts = 2**halvings
        along = np.interp(np.arange((len(along) - 1) * parts + 1) / parts, np.arange(len(along)), along)
        inner = count + np.arange(len(along) - 2)
        count += len(inner)
        chain = np.concatenate([[start], inner, [end]])
        points.append(ends[0] + along[1:-1, None] * (ends[1] - ends[0]))
        facets.append(np.stack([chain[:-1], chain[1:]], axis=1))
        owners.append(np.full(len(chain) - 1, owner))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(points), np.concatenate(facets)[order], np.concatenate(owners)[order]


def _division(ends: Floats, around: list[Source], fine: float, growth: float) -> Floats:
    """Places (k + 1,) from 0 to 1 that divide an edge (2, 2) into joints of the mesh size there."""
    from scipy.spatial import cKDTree  # imports much

    length = float(np.linalg.norm(ends[1] - ends[0]))
    trees = [(size, cKDTree(places)) for size, places in around]

    def size_at(along: Floats) -> Floats:
        spots = ends[0] + along[:, None] * (ends[1] - ends[0])
        found = [size + growth * np.maximum(tree.query(spots)[0] - size / 2, 0.0) for size, tree in trees]
        return np.minimum(np.min(found, axis=0), fine) / length

    along = np.linspace(0.0, 1.0, 2 + int(length / fine))
    while True:
        size = size_at(along)
        wide = np.flatnonzero(np.diff(along) > np.minimum(size[1:], size[:-1]) / FINER)
        if not len(wide):
            break
        along = np.insert(along, wide + 1, (along[wide] + along[wide + 1]) / 2)
    joints = np.concatenate([[0.0], np.cumsum(np.diff(along) * (1.0 / size[1:] + 1.0 / size[:-1]) / 2)])
    wanted = max(int(np.ceil(joints[-1] - NEARLY)), 1)
    return np.asarray(np.interp(np.linspace(0.0, joints[-1], wanted + 1), joints, along))


def with_walls(
    points: Floats, facets: Ints, fracture_of: Ints, names: tuple[str, ...], rock: str, notes: tuple[str, ...]
) -> SplitMesh:
    """The mesh of joints ``facets`` (f, 2) alone, of fractures (f,), with a copy of a node for each sector between joints.

    The first copy keeps the node's number. Around blocks of finite size walls run counter-clockwise.
    """
    node, heading = facets.T.ravel(), np.diff(points[facets], axis=1)[:, 0]
    angle = np.concatenate([np.arctan2(heading[:, 1], heading[:, 0]), np.arctan2(-heading[:, 1], -heading[:, 0])])
    order = np.lexsort([angle, node])  # the arms of each node, counter-clockwise
    first, count = np.searchsorted(node[order], np.arange(len(points))), np.bincount(node, minlength=len(points))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order)) - first[node[order]]

    extra = len(points) + np.cumsum(count - 1) - (count - 1)  # number of the second copy of each node

    def copy(sector: Ints) -> Ints:
        sector = sector % count[node]
        return np.where(sector == 0, node, extra[node] + sector - 1).reshape(2, -1).T

    after, before = copy(place), copy(place - 1)  # the sectors on both sides of each arm, seen from its node
    top = np.stack([after[:, 0], before[:, 1]], axis=1)
    bottom = np.stack([before[:, 0], after[:, 1]], axis=1)
    origin = np.concatenate([np.arange(len(points)), np.repeat(np.arange(len(points)), count - 1)])
    joints = np.arange(len(facets))
    return SplitMesh(
        points=points[origin],
        origin=origin,
        cells=np.concatenate([bottom[:, ::-1], top]),
        cell_rock=np.zeros(2 * len(facets), dtype=np.int64),
        rocks=(rock,),
        joint_bottom=bottom,
        joint_top=top,
        joint_cells=np.stack([joints, joints + len(joints)], axis=1),
        joint_flow=facets,
        joint_fracture=fracture_of,
        joint_along=arc_length(points, facets, fracture_of),
        fractures=names,
        flow_origin=np.arange(len(points)),
        side_facets=np.zeros((0, 2), dtype=np.int64),
        side_cell=np.zeros(0, dtype=np.int64),
        side_of=np.zeros(0, dtype=np.int64),
        sides=(),
        named_points={},
        notes=notes,
    )


def map_cells(mesh: SplitMesh) -> tuple[Floats, Ints]:
    """Points (n, 2) and squares (m, 4) of a map around fractures, half as wide again."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    wide = (high - low).max()
    size = 1.5 * wide / MAP
    count = np.ceil((high - low + 0.5 * wide) / size - 1e-9).astype(np.int64)
    x, y = ((low[k] + high[k] - size * count[k]) / 2 + size * np.arange(count[k] + 1) for k in (0, 1))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    first = (np.arange(count[0]) + (count[0] + 1) * np.arange(count[1])[:, None]).ravel()
    return points, first[:, None] + np.array([0, 1, count[0] + 2, count[0] + 1])
