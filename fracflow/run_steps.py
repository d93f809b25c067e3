"""One step after another: a single step, the search for incipient failure, and the stages of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from fracflow._petsc import MPI, PETSc
from fracflow.assembly.energy import book, drop_motion, kinetic_energy
from fracflow.assembly.loads import Loads
from fracflow.coupling import COUPLINGS
from fracflow.coupling.step_problem import StepProblem
from fracflow.errors import SolveError
from fracflow.run_setup import Model
from fracflow.scene import Scene
from fracflow.scene_actions import Stage
from fracflow.state import Motion, State, StepReport
from fracflow.stepping import Alphas, BackwardEuler, Newmark, Steady, Stepper

DOUBLINGS = 60
SEARCH_TOLERANCE = 1e-13  # of the control; far below the stage's own tolerance, so that ranks agree on where it ends


@dataclass(frozen=True)
class Step:
    """A state worth recording, the stage it belongs to, and what it cost; None for the start."""

    state: State
    stage: int
    dt: float
    report: StepReport


def stepper_of(scene: Scene, stage: Stage) -> Stepper:
    """The rule that a kind of stage steps by."""
    if stage.kind == "dynamic":
        return Newmark(scene.method.newmark_beta, scene.method.newmark_gamma)
    return BackwardEuler() if stage.kind == "quasi-static" else Steady()


class Stepping:
    """Makes steps of one model; keeps the solvers between them."""

    def __init__(self, model: Model) -> None:
        """Make the solvers that the stages need when they first need them."""
        self.model = model
        self._couplings: dict[int, object] = {}

    def _coupling(self, loads: Loads) -> object:
        if id(loads) not in self._couplings:
            kind = COUPLINGS[
                self.model.scene.method.coupling if self.model.operators.flow is not None else "monolithic"
            ]
            self._couplings[id(loads)] = kind(self.model.scene, self.model.operators, loads)
        return self._couplings[id(loads)]

    def step(
        self,
        state: State,
        stepper: Stepper,
        time: float,
        dt: float,
        controls: Mapping[str, float],
        loads: Loads | None = None,
        restraint: PETSc.Vec | None = None,
    ) -> tuple[State, StepReport]:
        """One step to ``time``, by default under the loads of the scene and no restraint.

        Raises SolveError, on every rank; ``state`` stays as it is. Collective.
        """
        alphas = stepper.alphas(dt) if dt > 0.0 else Alphas()
        if loads is None:
            loads = self.model.loads if stepper.storage else self.model.steady_loads
        problem = StepProblem(self.model.operators, loads, state, alphas, time, controls, restraint)
        try:
            report = self._coupling(loads).solve(problem)  # type: ignore[attr-defined]
            new = problem.accept(state.energy)
        finally:
            problem.destroy()
        return replace(new, energy=book(self.model.operators, state, new, dt, stepper.storage, stepper.inertia)), report

    def enter(self, state: State, stepper: Stepper) -> State:
        """(4.1e) The state as a stage takes it over: accelerations of the first instant, or motion dropped. Collective."""
        ops = self.model.operators
        motion = Motion(state.motion.displacement.copy(), state.motion.velocity.copy(), ops.layout.solid_vector())
        energy = dict(state.energy)
        if not stepper.inertia:
            energy = drop_motion(energy, kinetic_energy(ops, motion.velocity))
            motion.velocity.set(0.0)
        loads = self.model.loads if stepper.storage else self.model.steady_loads
        at_rest = replace(state, motion=motion)
        problem = StepProblem(ops, loads, at_rest, Alphas(), state.time, state.controls)
        if (
            stepper.storage
            and ops.flow is not None
            and problem.source.norm() > 0.0
            and state.forces.source.norm() == 0.0
        ):
            _initial_pressure(self.model, loads, problem)
        problem.evaluate()
        if stepper.inertia:
            _initial_acceleration(self.model, problem, motion.acceleration)
        new = State(
            state.time,
            motion,
            problem.pressure.copy(),
            problem.sections,
            problem.forces(motion),
            state.controls,
            energy,
        )
        problem.destroy()
        state.destroy()
        return new

    def destroy(self) -> None:
        """Free the solvers. Collective."""
        for coupling in self._couplings.values():
            coupling.destroy()  # type: ignore[attr-defined]


def _initial_pressure(model: Model, loads: Loads, problem: StepProblem) -> None:
    """(4.1e) H_0 = K_F^-1 (Q_0 - B_F' v_0), for wells that pump from the first instant."""
    from fracflow.coupling.joined_matrix import JoinedMatrix
    from fracflow.coupling.newton import Newton

    matrix = JoinedMatrix(model.operators, loads)
    newton = Newton(model.scene, matrix, "flow", "flow")
    try:
        newton.solve(problem)
    except SolveError as error:
        raise SolveError(
            f"time {problem.time:.6g}: no initial pressures: wells pump at once into fractures that nothing drains;"
            " let flow_rate start at 0, or give a [[well]] with a pressure"
        ) from error
    finally:
        newton.destroy()
        matrix.destroy()


def _initial_acceleration(model: Model, problem: StepProblem, acceleration: PETSc.Vec) -> None:
    """(4.1e) a_0 = M^-1 (R_0 + B H_0 - K(d_0)); zero where held."""
    matrix, solver = model.operators.mass.copy(), PETSc.KSP().create(comm=model.operators.layout.comm)
    start = matrix.getOwnershipRange()[0]
    held = np.concatenate([start + part.numbers for part in problem.loads.supports] or [np.zeros(0)])
    matrix.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
    solver.setOperators(matrix)
    solver.setOptionsPrefix("solid_")
    solver.setFromOptions()
    solver.solve(problem.solid_balance, acceleration)
    acceleration.scale(-1.0)
    solver.destroy()
    matrix.destroy()


def utilisation(model: Model, state: State) -> float:
    """Largest |f_s| / f_sy over all sections; 1 where one slides. Collective."""
    here = float(state.sections.utilisation.max(initial=0.0))
    if state.sections.is_sliding.any():
        here = max(here, 1.0)
    return float(model.operators.layout.comm.allreduce(here, op=MPI.MAX))


def search_incipient(
    stepping: Stepping, state: State, stage: Stage, log: Callable[[str], None]
) -> Iterator[tuple[State, StepReport]]:
    """Raise the control until max |f_s| / f_sy = 1 - tolerance; yields the elastic states on the way. Collective."""
    model, control = stepping.model, stage.control
    assert control is not None
    target, start = 1.0 - stage.tolerance, state.controls[control]
    tried: dict[float, tuple[State, StepReport]] = {}

    def excess(value: float) -> float:
        try:
            new, report = stepping.step(state, Steady(), state.time, 0.0, {**state.controls, control: value})
        except SolveError:
            return stage.tolerance
        tried[value] = (new, report)
        return min(utilisation(model, new), 1.0) - target

    if utilisation(model, state) >= target:
        log(f"stage {stage.name or stage.kind}: already at incipient failure")
        return
    increment, low = model.scene.control[control].increment, start
    for _ in range(DOUBLINGS):
        high = low + increment
        if excess(high) >= 0.0:
            break
        new, report = tried.pop(high)
        state, low, increment = new, high, 2.0 * increment
        yield new, report
    else:
        raise SolveError(
            f"stage {stage.name or stage.kind}: control.{control} raised to {low:.6g} and no fracture came to its"
            " strength: do the wells it drives reach one?"
        )
    value = brentq(excess, low, high, xtol=SEARCH_TOLERANCE * abs(high), rtol=1e-15) if low < high else high
    below = [v for v in tried if utilisation(model, tried[v][0]) < 1.0]
    value = min(below, key=lambda v: abs(v - value)) if below else low
    best = tried.pop(value)
    for other, _ in tried.values():
        other.destroy()
    log(f"incipient failure at {control} = {value:.12g}: |f_s|/f_sy = 1 - {1.0 - utilisation(model, best[0]):.3e}")
    yield best


def run_stage(stepping: Stepping, state: State, number: int, log: Callable[[str], None]) -> Iterator[Step]:
    """All steps of a stage. The caller owns the states. Collective."""
    model = stepping.model
    stage = model.scene.stage[number]
    stepper = stepper_of(model.scene, stage)
    if stage.takes_no_time:
        for new, report in search_incipient(stepping, state, stage, log):
            yield Step(new, number, 0.0, report)
        return
    assert stage.time_step is not None
    start, base, held = state.time, dict(state.controls), False
    count = stage.step_count(start)
    n, controls = 0, dict(base)
    while count is None or n < count:
        n += 1
        if stage.control is not None and stage.increment_per_step is not None and not held:
            controls[stage.control] = base[stage.control] * (1.0 + n * stage.increment_per_step)
        new, report = stepping.step(state, stepper, start + n * stage.time_step, stage.time_step, controls)
        failed = utilisation(model, new) >= 1.0
        if failed and stage.then == "hold" and not held:
            held = True
            log(f"time {new.time:.6g}: first failure; {stage.control} held at {controls[stage.control or '']:.12g}")
        state = new
        yield Step(new, number, stage.time_step, report)
        if stage.until == "incipient" and failed:
            return
