"""The search for incipient failure: how far a load factor may rise before the first fracture comes to its strength."""

from __future__ import annotations

from collections.abc import Iterator

from fracflow._petsc import MPI, destroy
from fracflow.advance.outcome import Log
from fracflow.advance.step import DONE, Progress, Step, Stepping
from fracflow.errors import SolveError
from fracflow.integrators import Steady
from fracflow.model.setup import Model
from fracflow.model.state import Sections, State, StepReport
from fracflow.remarks import note
from fracflow.scene.boundary import Stage
from fracflow.solve.request import StepRequest

DOUBLINGS = 60
STANDS_STILL = 1e-3  # change of |f_s|/f_sy over a doubling of the control, by which it comes no nearer to the strength
SEARCH_TOLERANCE = 1e-13  # of the control; far below the stage's own tolerance, so that ranks agree on where it ends


def utilisation(model: Model, sections: Sections) -> float:
    """Largest |f_s| / f_sy over all sections; 1 where one slides. Collective."""
    here = max(float(sections.utilisation.max(initial=0.0)), float(sections.is_sliding.any()))
    return float(model.operators.layout.comm.allreduce(here, op=MPI.MAX))


class _Search:
    """How far the control may rise: states tried from one start, and how far each is from the strength sought."""

    def __init__(self, stepping: Stepping, state: State, stage: Stage, log: Log, used: tuple[float, float]) -> None:
        """From a state on; ``used`` are |f_s|/f_sy one try before it, and there."""
        assert stage.control is not None
        self.log, self.used = log, used
        self.stepping, self.state, self.stage, self.control = stepping, state, stage, stage.control
        self.tried: dict[float, tuple[State, StepReport]] = {}
        self.failure: SolveError | None = None

    def excess(self, value: float) -> float:
        """Utilisation less the one that is sought; positive where there is no such state. Collective."""
        if value not in self.tried:
            controls = {**self.state.controls, self.control: value}
            request = StepRequest(self.state.time, 0.0, controls, self.stepping.model.loads)
            try:
                self.tried[value] = self.stepping.step(self.state, request, Steady())
            except SolveError as error:
                self.failure = error
                self.log(
                    note(f"no state found at control.{self.control} = {value:.12g}, taken as past failure: {error}")
                )
                return self.stage.tolerance
        return min(utilisation(self.stepping.model, self.tried[value][0].sections), 1.0) - (1.0 - self.stage.tolerance)

    def between(self, low: float, high: float) -> float:
        """The last value in a bracket that was tried and slides nowhere. Collective."""
        if self.excess(low) < 0.0:
            from scipy.optimize import brentq  # imports much

            brentq(self.excess, low, high, xtol=SEARCH_TOLERANCE * abs(high), rtol=1e-15)
        model = self.stepping.model
        below = {v: u for v, (new, _) in self.tried.items() if (u := utilisation(model, new.sections)) < 1.0}
        sought = 1.0 - self.stage.tolerance
        best = min(below, key=lambda value: abs(below[value] - sought), default=low)
        if not below or below[best] < 1.0 - 2.0 * self.stage.tolerance:
            before, now = self.used
            reached = below[best] if below else now
            still = not below and abs(now - before) < STANDS_STILL
            hopeless = ", and rises no further: this control brings no fracture to its strength" if still else ""
            raise SolveError(
                f"stage {self.stage.title}: the search for incipient failure ended at control.{self.control} = {best:.9g}"
                f" with |f_s|/f_sy = {reached:.9g}, sought 1 - {self.stage.tolerance:g}{hopeless};"
                f" beyond it {self.failure or 'sections slide at once'}"
            )
        return best

    def destroy(self) -> None:
        """Free the states that were not taken out of ``tried``."""
        destroy(*(state for state, _ in self.tried.values()))


def search_incipient(stepping: Stepping, state: State, number: int, log: Log, progress: Progress) -> Iterator[Step]:
    """Raise the control until max |f_s| / f_sy = 1 - tolerance; yields the elastic states on the way.

    Raises SolveError, on every rank, where no state is that near to the strength. Collective.
    """
    model, stage = stepping.model, stepping.model.scene.stage[number]
    control = stage.control
    assert control is not None
    low = state.controls[control]
    if utilisation(model, state.sections) >= 1.0 - stage.tolerance:
        log(note(f"stage {stage.title}: already at incipient failure"))
        return
    increment = progress.get("increment", model.scene.control[control].increment)
    before, used = -1.0, utilisation(model, state.sections)
    for _ in range(DOUBLINGS):
        search, high = _Search(stepping, state, stage, log, (before, used)), low + increment
        if search.excess(high) >= 0.0:
            break
        state, report = search.tried.pop(high)
        before, used = used, utilisation(model, state.sections)
        low, increment = high, 2.0 * increment
        yield Step(state, number, 0.0, report, {"increment": increment})
    else:
        raise SolveError(
            f"stage {stage.title}: control.{control} raised to {low:.6g} and no fracture came to its"
            " strength: do the wells it drives reach one?"
        )
    try:
        value = search.between(low, high)
        best = search.tried.pop(value)
    finally:
        search.destroy()
    reached = utilisation(model, best[0].sections)
    log(f"incipient failure at {control} = {value:.12g}: |f_s|/f_sy = 1 - {1.0 - reached:.3e}")
    yield Step(best[0], number, 0.0, best[1], DONE)
