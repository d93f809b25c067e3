"""The whole nonlinear step on the fractures alone, with the rock condensed to their jumps.

The rock with elastic joints, A = alpha_0 M + K_s + alpha_1 C + G' W D_0 G, is factored once. Nothing that slips, opens or
flows changes A: all of that acts on the rock through the joints alone, u = A^-1 (r - G' q). The jumps are
e = G u_free - G A^-1 G' q, q = W (t(e, p) - t_old - D_0 de). One dense compliance couples jumps and pressures, which Newton's
method of ``sections`` solves for; one more solve with the factors of A recovers the rock. Newton's method on all unknowns then
checks the full balances, and solves the step itself where they do not hold.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.errors import InputError, NotConverged
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import local_rows
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import StepReport
from fracflow.scene.scene import Scene
from fracflow.solve.clusters import Batch, Clusters, Exchange
from fracflow.solve.condensed_cost import Condensing, Key, fits, key_of
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.monolithic import Auto, Monolithic
from fracflow.solve.problem import StepProblem
from fracflow.solve.sections import FlowOnJoints, SectionSolver

BLOCK = 64  # right sides at once: with more of them each takes no less time


class CondensedRock:
    """Factors of A and the compliance G A^-1 G' of all sections, dense, on rank 0."""

    @timed("FracCondense")
    def __init__(self, matrix: JoinedMatrix, loads: Loads, alphas: Alphas, elastic: Floats) -> None:
        """Factor and condense; ``elastic`` is D_0 (s, dim, dim). Raises NotConverged, on every rank. Collective."""
        self.operators, self.held = matrix.operators, loads.held
        matrix.fill(alphas, elastic, None, 1.0, "solid")
        self.matrix = matrix.matrix.copy()
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        self.solver = PETSc.KSP().create(comm=matrix.layout.comm)
        self.solver.setOptionsPrefix("condensed_")
        alone = matrix.layout.comm.size == 1 and PETSc.Sys.hasExternalPackage("suitesparse")
        self.solver.getPC().setType("cholesky")
        self.solver.getPC().setFactorSolverType("cholmod" if alone else "mumps")  # 1/3 of the time of MUMPS for a solve
        self.solver.setFromOptions()
        self.solver.setOperators(self.matrix)
        nothing = self.operators.layout.solid_vector()
        try:
            self.solve(nothing)
        except (NotConverged, PETSc.Error) as error:  # CHOLMOD is on one rank, where all errors are agreed on
            self.destroy()
            raise NotConverged("the rock with elastic joints has no factors: nothing holds it") from error
        finally:
            nothing.destroy()
        self.clusters = _one_cluster(self._compliance(), len(elastic), self.operators.layout.comm)

    def solve(self, force: PETSc.Vec) -> Floats:
        """A^-1 times a force on the solid unknowns: this rank's displacements (n,), nothing where held.

        Raises NotConverged, on every rank. Collective.
        """
        layout, scales = self.operators.layout, self.operators.scales
        right, found = layout.joined_vector(), layout.joined_vector()
        local = right.getArray()
        local[: layout.solid_count] = force.getArray(readonly=True) / scales.force
        local[self.held] = 0.0
        self.solver.solve(right, found)
        result: Floats = found.getArray()[: layout.solid_count] * scales.displacement
        destroy(right, found)
        if self.solver.getConvergedReason() < 0:
            raise NotConverged("no solution of the rock with elastic joints")
        return result

    def _compliance(self) -> Floats | None:
        """G A^-1 G' on rank 0, in blocks of right sides. Collective."""
        layout, jump, scales = self.operators.layout, self.operators.joints.jump, self.operators.scales
        turned = jump.transpose(PETSc.Mat())
        rows = local_rows(turned)
        turned.destroy()
        moves = ~np.isin(rows.rows, self.held)
        count = jump.getSize()[0]
        whole = np.empty((count, count)) if layout.comm.rank == 0 else None
        right = _dense(layout.solid_count + layout.flow_count, layout.total, layout.comm)
        found = _dense(layout.solid_count + layout.flow_count, layout.total, layout.comm)
        rock = _dense(layout.solid_count, int(layout.solid_starts[-1]), layout.comm)
        factors = self.solver.getPC().getFactorMatrix()
        for first in range(0, count, BLOCK):
            here = moves & (rows.cols >= first) & (rows.cols < first + BLOCK)
            local = right.getDenseArray()
            local[:] = 0.0
            local[rows.rows[here], rows.cols[here] - first] = rows.values[here]
            right.assemble()
            factors.matSolve(right, found)
            rock.getDenseArray()[:] = found.getDenseArray()[: layout.solid_count]
            rock.assemble()
            strains = jump.matMult(rock)
            columns = layout.comm.gather(strains.getDenseArray()[:, : count - first], root=0)
            if columns is not None and whole is not None:
                whole[:, first : first + BLOCK] = np.vstack(columns)
            strains.destroy()
        destroy(right, found, rock)
        if whole is not None:
            whole *= scales.displacement / scales.force
        return whole

    def destroy(self) -> None:
        """Free the factors. Collective."""
        destroy(self.solver, self.matrix)


def _dense(here: int, total: int, comm: MPI.Comm) -> PETSc.Mat:
    matrix = PETSc.Mat().createDense(((here, total), (None, BLOCK)), comm=comm)
    matrix.setUp()
    matrix.assemble()
    return matrix


def _one_cluster(compliance: Floats | None, here: int, comm: MPI.Comm) -> Clusters:
    """All sections of all ranks, of which this one has ``here``, as one cluster that rank 0 solves for. Collective."""
    counts = np.array(comm.allgather(here), dtype=np.int64)
    sent, received = np.zeros(comm.size, dtype=np.int64), np.zeros(comm.size, dtype=np.int64)
    sent[0] = here
    if comm.rank == 0:
        received = counts
    exchange = Exchange(comm, np.arange(here), sent, received)
    all_sections = np.arange(counts.sum())[None]
    return Clusters(exchange, () if compliance is None else (Batch(all_sections, compliance[None]),))


MOST_KEPT = 4  # factors and compliances, of as many lengths of steps
MOST_CYCLES = 3  # each removes the round-off of the one before
NEARLY = 10.0  # times the required accuracy, where flow is small: a solve for all unknowns has no more digits


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

    flow_kind, most_changes = CondensedFlow, 10  # Newton's method on all unknowns has more means against cycling

    def __init__(self, scene: Scene, operators: Operators, clusters: Clusters, elastic: Floats) -> None:
        """Keep what is constant. Collective."""
        super().__init__(scene, operators, clusters, elastic)
        self._like = _alike(operators, clusters)

    def _answer(self, compliance: Floats, moduli: Floats, right: Floats) -> Floats:
        compliance, moduli, right = compliance[0], moduli[0], right[0]
        changed, dim = np.flatnonzero(moduli.any(axis=(1, 2))), moduli.shape[1]
        if not len(changed):
            return right[None]
        there, like = np.unique(self._like[changed], return_inverse=True)
        summed = np.zeros((len(there), dim, dim))
        np.add.at(summed, like, moduli[changed])
        rows = (there[:, None] * dim + np.arange(dim)).ravel()
        flat = compliance.reshape(len(right), -1)[:, rows]
        own = np.einsum("xmi,mij->xmj", flat[rows].reshape(len(rows), -1, dim), summed).reshape(len(rows), -1)
        try:
            answer = np.linalg.solve(np.eye(len(rows)) + own, right[rows])
        except np.linalg.LinAlgError:
            answer = np.full((len(rows), right.shape[1]), np.nan)
        pulled = np.matmul(summed, answer.reshape(-1, dim, right.shape[1])).reshape(len(rows), -1)
        return np.asarray(right - flat @ pulled)[None]


def _alike(operators: Operators, clusters: Clusters) -> Ints:
    """For each section (S,) of these clusters the first one with the same motion, where joints meet at a node. Collective."""
    motion = operators.layout.solid_vector()
    first, last = motion.getOwnershipRange()
    motion.setArray(np.random.default_rng(first).random(last - first))  # which no two places share
    strains = clusters.exchange.there(operators.joints.strain(motion))
    motion.destroy()
    _, index, inverse = np.unique(np.round(strains, 9), axis=0, return_index=True, return_inverse=True)
    return np.asarray(index[inverse.ravel()], np.int64)


Kept = tuple[CondensedRock, CondensedSections]


class Condensed:
    """Steps of the lengths that stages state are condensed, others are solved for all unknowns.

    Where the program chose to condense, only those are that pay by their number, and only while something changes from step
    to step. All of it is known from scene and state, so that a run that is resumed does the same.
    """

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make matrix and solver of the full balances, kept for the whole run.

        Raises InputError, on every rank, where the compliance would be larger than the rock's own factors. Collective.
        """
        joints, scales, unknowns = operators.joints, operators.scales, int(operators.layout.solid_starts[-1])
        self._jumps = operators.layout.comm.allreduce(len(joints.weights)) * joints.dim
        if not fits(unknowns, self._jumps):
            raise InputError(
                f'method.coupling = "condensed": {self._jumps} jumps of joints are too many beside {unknowns} displacements:'
                ' the compliance would take more memory than the rock; use "monolithic"'
            )
        self.scene, self.operators, self.loads = scene, operators, loads
        self.full = (Monolithic if operators.flow is None else Auto)(scene, operators, loads)
        self._is_asked = scene.method.coupling == "condensed"
        self._damps = operators.damping is not None and not loads.at_rest
        self._planned = Condensing({}, np.inf)
        self._kept: dict[Key, Kept] = {}  # the one used last comes last
        start = joints.evaluate(np.zeros((len(joints.weights), joints.dim)), joints.initial_history()).tangent
        self._at_rest = start
        own, natural = np.diagonal(start, axis1=1, axis2=2), scales.force / (scales.displacement * scales.length)
        # any moduli serve, as the sections correct them; with these nothing that joints hold is loose
        self._elastic = np.where(own > 0.0, own, natural)[:, :, None] * np.eye(joints.dim)

    def solve(self, problem: StepProblem) -> StepReport:
        """Bring the trial into balance. Raises SolveError, on every rank. Collective."""
        key, done, given_up = key_of(problem.alphas, self._damps), (0, 1), ""
        start = problem.increment.getArray().copy(), problem.pressure.getArray().copy()
        is_new = key not in self._kept
        try:
            kept = self._condensed(key, problem)
            if kept is not None:
                done = self._bring(problem, *kept)
        except NotConverged:
            given_up = "no balance to all digits on the fractures alone"
            problem.pressure.setArray(start[1])
            problem.trial_status = problem.state.sections.history
            problem.move(start[0])
        report = self.full.solve(problem)
        newton, factors = report.newton + done[0], report.factorisations + int(is_new and key in self._kept)
        return replace(report, newton=newton, factorisations=factors, cycles=done[1], handed_over=given_up)

    def expect(self, planned: Condensing) -> None:
        """Condense those planned steps for which it pays, or all where the scene requires it."""
        self._planned = planned

    def _is_meant(self, key: Key, problem: StepProblem) -> bool:
        """Whether a step is to be condensed. Collective."""
        if self._is_asked:
            return key in self._planned.steps
        if not self._planned.is_worth(key):
            return False
        changes = self.operators.flow is not None or not np.array_equal(problem.state.sections.tangent, self._at_rest)
        return self.operators.layout.comm.allreduce(changes, op=MPI.LOR)

    def _condensed(self, key: Key, problem: StepProblem) -> Kept | None:
        """Factors for a step, made where it pays; None where all unknowns are better solved for. Collective.

        A network component that nothing drains may have a row in place of a balance, which condensed flow does not have.
        """
        if problem.loads.is_closed or not self._jumps or not self._is_meant(key, problem):
            return None
        kept = self._kept.pop(key, None)
        if kept is None:
            if len(self._kept) == MOST_KEPT:
                self._free(next(iter(self._kept)))
            problem.work.factorisations += 1
            rock = CondensedRock(self.full.matrix, self.loads, problem.alphas, self._elastic)
            kept = rock, CondensedSections(self.scene, self.operators, rock.clusters, self._elastic)
        self._kept[key] = kept
        return kept

    def _bring(self, problem: StepProblem, rock: CondensedRock, sections: CondensedSections) -> tuple[int, int]:
        """Bring the trial into balance as far as round-off lets it; iterations and cycles. Collective."""
        joints, iterations, least = self.operators.joints, 0, self.scene.accuracy.residual
        problem.evaluate()
        if max(_largest(problem), problem.residual.carried) <= least:  # sections at rest stay so to the last digit
            return 0, 0
        force, unforced = problem.load.duplicate(), problem.load.duplicate()
        try:
            for cycle in range(1, MOST_CYCLES + 1):
                change = joints.strain(problem.increment)
                problem.solid_balance.copy(force)
                joints.force(-sections.pressure_change(problem, change), force)
                unforced.setArray(problem.increment.getArray(readonly=True) - rock.solve(force))
                change, report = sections.solve(problem, joints.strain(unforced), 1.0, change, least=int(cycle > 1))
                iterations += report.iterations
                force.set(0.0)
                joints.force(sections.pressure_change(problem, change), force)
                problem.move(unforced.getArray() - rock.solve(force))
                problem.evaluate()
                # also relative to a small flow: its residual times the pressure enters the energy balance
                beside = problem.residual.carried
                if max(_largest(problem), beside) <= least:
                    break
                if cycle == MOST_CYCLES and beside > NEARLY * least and not self._is_asked:
                    raise NotConverged(
                        "the flow is too small for the digits of the fractures alone: all unknowns are solved for"
                    )
        finally:
            destroy(force, unforced)
        return iterations, cycle

    def _free(self, key: Key) -> None:
        """Free what is kept for steps of one kind, if anything. Collective."""
        destroy(*self._kept.pop(key, ()))

    def destroy(self) -> None:
        """Free matrices and solvers. Collective."""
        for key in list(self._kept):
            self._free(key)
        self.full.destroy()


def _largest(problem: StepProblem) -> float:
    return max(problem.residual.solid, problem.residual.flow, problem.residual.at_nodes)
