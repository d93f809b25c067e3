"""Distance along a fracture, from its start."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from fracflow.mesh.data import Floats, Ints


def arc_length(points: Floats, facets: Ints, fracture_of: Ints) -> Floats:
    """Distance (f, 2) of both ends of each facet from the start of its fracture, along the trace [length].

    points (n, dim); facets (f, 2), each head to tail in the direction of its trace; fracture_of (f,). A fracture in
    several pieces starts anew on each; a closed loop starts at the tail of its first facet.
    """
    if not len(facets):
        return np.zeros((0, 2))
    key = fracture_of[:, None] * (facets.max() + 1) + facets
    vertex, place = np.unique(key, return_inverse=True)
    tail, head = place.reshape(facets.shape).T
    step = np.linalg.norm(points[facets[:, 1]] - points[facets[:, 0]], axis=1)
    graph = sparse.csr_matrix((step, (tail, head)), shape=(len(vertex), len(vertex)))
    piece = connected_components(graph, directed=False)[1]
    is_start = np.zeros(len(vertex), dtype=bool)
    is_start[tail] = True
    is_start[head] = False
    first_facet = np.unique(piece[tail], return_index=True)[1]
    is_loop = ~np.isin(piece[tail[first_facet]], piece[is_start])
    is_start[tail[first_facet[is_loop]]] = True
    distance = dijkstra(graph, indices=np.flatnonzero(is_start), min_only=True)
    ends = np.stack([distance[tail], distance[tail] + step], axis=1)
    return np.asarray(ends, dtype=np.float64)
