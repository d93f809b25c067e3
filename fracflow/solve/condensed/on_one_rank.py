"""The sections of all ranks, solved for by rank 0, which holds their whole compliance."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.mesh.data import Floats, Ints
from fracflow.model.operators import Operators
from fracflow.scene.scene import Scene
from fracflow.solve.clusters import Batch, Clusters, Exchange
from fracflow.solve.problem import StepProblem
from fracflow.solve.sections import FlowOnJoints, SectionSolver

MOST_CHANGES = 10  # of statuses in a step: Newton's method on all unknowns has more means against cycling


class CondensedFlow(FlowOnJoints):
    """Fracture flow of an implicit step: its balance holds at the end of the step."""

    def given(self, problem: StepProblem) -> PETSc.Vec:  # type: ignore[override]  # never that of an explicit step
        """Sources less the flow that walls displace at their present velocity, in a new vector. Collective."""
        network, speed, result = self.operators.flow, problem.velocity(), problem.source.copy()
        assert network is not None
        speed.axpy(-problem.alphas.a1, problem.increment)
        squeezed = result.duplicate()
        network.storage_coupling.multTranspose(speed, squeezed)
        result.axpy(-1.0, squeezed)
        destroy(speed, squeezed)
        return result


class CondensedSections(SectionSolver):
    """All sections at once; those with the elastic moduli cost no time."""

    flow_kind, most_changes = CondensedFlow, MOST_CHANGES

    def __init__(self, scene: Scene, operators: Operators, compliance: Floats, elastic: Floats) -> None:
        """Bring this rank's rows (s dim, S dim) of the ``compliance`` to rank 0; moduli (s, dim, dim). Collective."""
        clusters = _one_cluster(compliance, elastic.shape[:2], operators.layout.comm)
        super().__init__(scene, operators, clusters, elastic)
        self._like = alike(operators, clusters.exchange)

    def _answer(self, compliance: Floats, moduli: Floats, right: Floats) -> Floats:
        compliance, moduli, right = compliance[0], moduli[0], right[0]
        (there, summed), dim = summed_alike(moduli, self._like), moduli.shape[1]
        if not len(there):
            return right[None]
        rows = (there[:, None] * dim + np.arange(dim)).ravel()
        flat = compliance.reshape(len(right), -1)[:, rows]
        own = np.einsum("xmi,mij->xmj", flat[rows].reshape(len(rows), -1, dim), summed).reshape(len(rows), -1)
        try:
            answer = np.linalg.solve(np.eye(len(rows)) + own, right[rows])
        except np.linalg.LinAlgError:
            answer = np.full((len(rows), right.shape[1]), np.nan)
        pulled = np.matmul(summed, answer.reshape(-1, dim, right.shape[1])).reshape(len(rows), -1)
        return np.asarray(right - flat @ pulled)[None]


def alike(operators: Operators, exchange: Exchange) -> Ints:
    """For each section (S,) that came by ``exchange`` the first with its motion, where joints meet at a node. Collective."""
    motion = operators.layout.solid_vector()
    first, last = motion.getOwnershipRange()
    motion.setArray(np.random.default_rng(first).random(last - first))  # which no two places share
    strains = exchange.there(operators.joints.strain(motion))
    motion.destroy()
    _, index, inverse = np.unique(np.round(strains, 9), axis=0, return_index=True, return_inverse=True)
    return np.asarray(index[inverse.ravel()], np.int64)


def summed_alike(moduli: Floats, like: Ints) -> tuple[Ints, Floats]:
    """Sections c with moduli, those ``like`` (S,) another as one, and the sums (c, dim, dim) of their moduli (S, dim, dim)."""
    changed = np.flatnonzero(moduli.any(axis=(1, 2)))
    there, to = np.unique(like[changed], return_inverse=True)
    summed = np.zeros((len(there), *moduli.shape[1:]))
    np.add.at(summed, to, moduli[changed])
    return there, summed


def _one_cluster(compliance: Floats, shape: tuple[int, ...], comm: MPI.Comm) -> Clusters:
    """All sections of all ranks, of this one ``shape`` = (s, dim), as one cluster that rank 0 solves for. Collective."""
    here, dim = shape
    counts = np.array(comm.allgather(here), dtype=np.int64)
    sent, received = np.zeros(comm.size, dtype=np.int64), np.zeros(comm.size, dtype=np.int64)
    sent[0] = here
    if comm.rank == 0:
        received = counts
    exchange = Exchange(comm, np.arange(here), sent, received)
    whole = exchange.there(compliance.reshape(here, dim * compliance.shape[1])).reshape(-1, compliance.shape[1])
    all_sections = np.arange(counts.sum())[None]
    return Clusters(exchange, (Batch(all_sections, whole[None]),) if comm.rank == 0 else ())
