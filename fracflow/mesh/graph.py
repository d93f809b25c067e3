"""Graphs of vertices and edges: what hangs together, and the ways through. SciPy's import alone costs more than a small run."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Floats, Ints


def components(first: Ints, second: Ints, total: int) -> Ints:
    """Component (total,) of each vertex of the graph with edges ``first``-``second`` (e,), numbered by lowest vertices.

    Each tree of vertices is hung below one that it has an edge to and whose root is lower, all of them at once, until no
    edge joins two trees (Shiloach and Vishkin 1982).
    """
    root = np.arange(total)
    while len(first):
        one, other = root[first], root[second]
        apart = one != other
        first, second, one, other = first[apart], second[apart], one[apart], other[apart]
        root[np.maximum(one, other)] = np.minimum(one, other)
        while (up := root[root]).tobytes() != root.tobytes():
            root = up
    return np.asarray((np.cumsum(root == np.arange(total)) - 1)[root])


def distances(tail: Ints, head: Ints, length: Floats, start: Ints, total: int) -> Floats:
    """Shortest way (total,) from any of the vertices ``start`` along edges (e,) from tail to head; infinite without any."""
    order = np.argsort(tail, kind="stable")
    tail, head, length = tail[order], head[order], length[order]
    begin = np.searchsorted(tail, np.arange(total + 1))
    away = np.full(total, np.inf)
    away[start] = 0.0
    front = np.unique(start)
    while len(front):
        count = begin[front + 1] - begin[front]
        edges = np.repeat(begin[front] - np.cumsum(count) + count, count) + np.arange(count.sum())
        reached = away[tail[edges]] + length[edges]
        is_nearer = reached < away[head[edges]]
        np.minimum.at(away, head[edges][is_nearer], reached[is_nearer])
        front = np.unique(head[edges][is_nearer])
    return away
