"""Joints, flow and wells at the end of explicit steps, on the sections alone; ``solve.leapfrog`` moves the rock."""

from __future__ import annotations

from dataclasses import replace

from fracflow._petsc import PETSc, destroy
from fracflow.advance.network import FlowNetwork
from fracflow.advance.wells import Trials, names_of, reached_after, well_step
from fracflow.errors import NotConverged
from fracflow.integrators import Explicit
from fracflow.integrators.explicit import joint_share
from fracflow.mesh.data import Floats
from fracflow.model.compressibility import Growth, brought, leaked, taken_between, widening
from fracflow.model.energy import fluid_parts
from fracflow.model.energy_motion import Scheme
from fracflow.model.loads import Limit, Loads
from fracflow.model.setup import Model
from fracflow.model.state import Sections, State, StepReport
from fracflow.model.well_volumes import volumes_after
from fracflow.scene.time_table import Around
from fracflow.solve.explicit import refuse_closed
from fracflow.solve.flow_round_off import check_digits
from fracflow.solve.leapfrog.fluid import FluidStep, free_flow
from fracflow.solve.request import StepRequest, StepRule
from fracflow.solve.sections import SectionSolver

RULE = Explicit()
SCHEME = Scheme(RULE.inertia, RULE.storage, RULE.balance)


class ExplicitFlow:
    """Explicit steps of joints and flow in a row, from a state on.

    now    the last state, whose motion and energy are those of the first one
    parts  entries that the steps have added to the energy balance
    """

    def __init__(self, model: Model, network: FlowNetwork, sections: SectionSolver) -> None:
        """Keep what solves."""
        self.model, self.network, self.sections = model, network, sections
        self._limited: dict[tuple[Loads, frozenset[Limit]], Loads] = {}
        self._pumps = any(stage.kind == "auto" for stage in model.scene.stage)  # for the catalogue of events
        self._problem: FluidStep | None = None
        self._next: State | None = None
        self._opened: PETSc.Vec | None = None
        self.parts: dict[str, float] = {}

    def begin(self, state: State) -> None:
        """Go on from a state."""
        self.now = self._first = state
        self.parts = {}

    def solve(self, free: Floats, request: StepRequest, around: Around) -> tuple[Sections, StepReport]:
        """Sections at the end of a step, from their free motion (s, dim) in it, and what they cost.

        Solved until the wells at limits and the components of the network are those of its end. Raises SolveError, on every
        rank. Collective.
        """
        network, depth, loads = self.network, self.model.scene.flow_depth, request.loads
        rule = StepRule(RULE.alphas(request.length), around, inertia=True)
        network.update(self.now)
        trials = Trials(loads, self.now)
        for reached in trials:
            limited = self._at(loads, reached)
            asked = replace(request, loads=network.close(limited, stores=True))
            refuse_closed(asked.loads, request.time)
            destroy(self._problem)
            problem = self._problem = FluidStep(self.model.operators, self.now, asked, rule)
            try:
                change, cost = self.sections.solve(problem, free, joint_share(request.length))
            except NotConverged as error:
                if self._is_closed(problem, limited):
                    raise
                trials.fails(error, error.newton)
                continue
            opened, is_same = problem.opened(change), self._is_closed(problem, limited)
            new = problem.accepted(opened)
            now = reached_after(problem, request, reached, new, depth) if loads.limits else reached
            if trials.agrees(now, is_same, cost.iterations):
                self._step, self._opened = replace(request, loads=limited), opened
                self._next = replace(new, **names_of(reached))
                return new.sections, StepReport(trials.spent, 0, 1, trials.spent, cost.motion, cost.flow)
            free_flow(new)
            opened.destroy()
        trials.refuse(request.time)

    def accept(self, sections: Sections) -> Growth:
        """Go on from what was solved, with the records of its sections; how apertures have grown. Collective."""
        ops, depth, old, step = self.model.operators, self.model.scene.flow_depth, self.now, self._step
        problem, opened = self._problem, self._opened
        assert problem is not None and opened is not None and self._next is not None
        new = replace(self._next, sections=sections)
        self._next = self._opened = None
        loads, dt = step.loads, step.length
        room = opened.getArray().copy()
        if new.uptake is not None:
            taken = taken_between(ops, old, new)
            room += taken.getArray()
            taken.destroy()
        wells = well_step(step, problem.rule, {}, old.time, True, depth)
        volumes, _ = volumes_after(ops, wells, old, new, room, dt, SCHEME)
        lost = leaked(ops, old, new, dt, SCHEME, depth)
        for name, value in fluid_parts(ops, old, new, (opened, opened), dt, SCHEME).items():
            name = "scheme" if name == "fluid_scheme" else name
            self.parts[name] = self.parts.get(name, 0.0) + value
        brings = brought(ops, loads, old, new, room, dt, SCHEME, depth) if self._pumps else 0.0
        self.network.log_changes(step.time)
        grown = widening(ops, loads, old, new)
        left = {name: old.left.get(name, 0.0) + value for name, value in lost.items()}
        self.now = replace(new, volumes=volumes, left=left, injected=old.injected + brings)
        opened.destroy()
        if old is not self._first:
            free_flow(old)
        return grown

    def pressed(self) -> Floats:
        """Pressures (s,) at the sections of what was solved. Collective."""
        assert self._next is not None
        return self.model.operators.network.at_ends(self._next.pressure).ravel()

    def check(self, new: State) -> float:
        """Fewest digits of the state at the end. Raises SolveError, on every rank, where they are too few. Collective."""
        assert self._problem is not None
        return check_digits(self._problem, new, self.model.scene.accuracy.digits, self.network.log_digits)

    def end(self) -> None:
        """Free the vectors of the steps."""
        if self.now is not self._first:
            free_flow(self.now)
        if self._next is not None:  # solved, but refused
            free_flow(self._next)
            destroy(self._opened)
        self.now, self._next, self._opened = self._first, None, None

    def _at(self, loads: Loads, reached: frozenset[Limit]) -> Loads:
        if reached and (loads, reached) not in self._limited:
            self._limited[loads, reached] = loads.at_limit(reached)
        return self._limited[loads, reached] if reached else loads

    def _is_closed(self, problem: FluidStep, loads: Loads) -> bool:
        """Whether a solved or failed trial has the network components that it was solved with. Collective."""
        if problem.conduction is None:
            return True
        self.network.check(problem.conduction)
        return self.network.close(loads, stores=True) is problem.loads

    def destroy(self) -> None:
        """Free the last trial. Collective."""
        destroy(self._problem)
