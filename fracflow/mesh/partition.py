"""Which rank holds which cell: PTScotch on the graph of cells, with the two cells of a joint kept together."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Ints, SplitMesh
from fracflow.mesh.facets import half_facets, match

JOINT_WEIGHT = 1000  # a cut joint costs ghosts on both faces; a cut facet next to nothing


def cell_graph(mesh: SplitMesh) -> sparse.csr_matrix:
    """Symmetric graph of cells (m, m): weight 1 for two cells that share a facet, JOINT_WEIGHT across a joint."""
    count, dim = len(mesh.cells), mesh.points.shape[1]
    half = half_facets(mesh.cells, dim)
    one, other = half.cell[match(half, np.zeros((0, dim), dtype=np.int64)).inside].T
    below, above = mesh.joint_cells.T
    row = np.concatenate([one, other, below, above])
    col = np.concatenate([other, one, above, below])
    weight = np.concatenate([np.ones(2 * len(one)), np.full(2 * len(below), float(JOINT_WEIGHT))])
    graph = sparse.csr_matrix((weight, (row, col)), shape=(count, count))
    graph.sum_duplicates()
    return graph


def partition_cells(mesh: SplitMesh | None, comm: MPI.Comm) -> Ints | None:
    """Rank of each cell, on rank 0 (the mesh lives there); None elsewhere. Collective."""
    if comm.size == 1:
        assert mesh is not None
        return np.zeros(len(mesh.cells), dtype=np.int64)
    chunks: Any = None
    if mesh is not None:
        graph = cell_graph(mesh)
        cuts = np.linspace(0, graph.shape[0], comm.size + 1).astype(int)
        chunks = [
            (
                graph.shape[0],
                graph.indptr[a : b + 1] - graph.indptr[a],
                graph.indices[graph.indptr[a] : graph.indptr[b]],
                graph.data[graph.indptr[a] : graph.indptr[b]],
            )
            for a, b in pairwise(cuts)
        ]
    total, indptr, indices, weights = comm.scatter(chunks, root=0)
    local = len(indptr) - 1
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), weights)
    adjacency = PETSc.Mat().createAIJ(((local, total), (local, total)), csr=csr, comm=comm)
    adjacency.convert("mpiadj")
    options = PETSc.Options()
    options["mat_partitioning_use_edge_weights"] = None
    partitioner = PETSc.MatPartitioning().create(comm)
    partitioner.setAdjacency(adjacency)
    partitioner.setType("ptscotch")
    partitioner.setFromOptions()
    result = PETSc.IS().create(comm)
    partitioner.apply(result)
    parts = comm.gather(result.getIndices().astype(np.int64), root=0)
    options.delValue("mat_partitioning_use_edge_weights")
    for thing in (result, partitioner, adjacency):
        thing.destroy()
    return None if parts is None else np.concatenate(parts)
