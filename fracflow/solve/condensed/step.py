"""A step on the fractures alone, with factors and compliance kept for steps of its length; all unknowns where it fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI, destroy
from fracflow.errors import InputError, NotConverged
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import StepReport
from fracflow.scene.scene import Scene
from fracflow.solve.condensed.rock import CondensedRock
from fracflow.solve.condensed.spread import sections_of
from fracflow.solve.condensed_cost import Condensing, Key, fits, key_of
from fracflow.solve.monolithic import Auto, Monolithic
from fracflow.solve.problem import StepProblem
from fracflow.solve.sections import SectionSolver

MOST_KEPT = 4  # factors and compliances, of as many lengths of steps
MOST_CYCLES = 3  # each removes the round-off of the one before
NEARLY = 10.0  # times the required accuracy, where flow is small: a solve for all unknowns has no more digits


Kept = tuple[CondensedRock, SectionSolver]


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
            problem.begin_again(start)
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
            kept = rock, sections_of(self.scene, self.operators, rock.compliance, self._elastic)
        self._kept[key] = kept
        return kept

    def _bring(self, problem: StepProblem, rock: CondensedRock, sections: SectionSolver) -> tuple[int, int]:
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
