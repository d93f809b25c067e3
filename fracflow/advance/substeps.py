"""A step is taken whole, or in substeps: to where it converges, to where it is accurate, to its events.

Parts are powers of 1/2 of a step, or of what is left of it after an event, each at a multiple of its own length. Prompt
ones have any length that their errors allow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.advance.prescribed_times import PrescribedTimes
from fracflow.errors import NotConverged, SolveError, Unsolved
from fracflow.model.small_strains import beyond_small_strains
from fracflow.model.state import State, StepReport
from fracflow.remarks import GIVEN_UP, marked, note
from fracflow.scene.scene import Scene
from fracflow.solve.request import AT_A_JUMP, LoadStep, StepRequest

CALM = 2  # parts in a row that could have been twice as long, before the next one is
MARGIN = 0.75  # of what is allowed: the error that the next prompt part is expected to have
MOST_OF_LAST = 2.0  # of prompt parts, each over the last
GRADES = 8  # lengths of prompt parts in an octave, which do not follow round-off: all numbers of ranks take the same
GRAIN = 2.0**-40  # of a step: sums of such lengths are exact
LEAST_ORDER = 0.25  # by which errors are expected to fall: they fall with dt^(1/2) in a fracture that a jump enters
MOST_UNSOLVED = 10  # trials of a stage without a linear solution, where the rock is strained beyond the model
DEEPEST = 6  # halvings at once
USUAL, FILLING = 6, 12  # halvings where the scene gives none
HOPELESS = 1e100  # times the allowed error: larger errors are treated alike


@dataclass(frozen=True)
class Rules:
    """When a step is taken in substeps.

    most     times that it may be halved
    order    order of the local error in its length, 0 where nothing controls it
    events   events in a step that parts end at; later ones are taken as they fall
    finest   times that it may be halved to be accurate, where that is not ``most``; only from there on is it halved to
             converge. Else substeps would shrink for ever towards an instant past which there is no solution
    prompt   the next part is as long as its error allows: no factors are kept that would serve again
    shrinks  no part is longer than the one before it; see ``ExplicitSteps.may_lengthen``
    """

    most: int
    order: int = 0
    events: int = 0
    finest: int = 0
    prompt: bool = False
    shrinks: bool = False


@dataclass(frozen=True)
class SubstepCursor:
    """Where in a step a run is, and how long its next part may be.

    base    fraction of the step at the last event in it
    part    of what was left there, a sum of powers of 1/2, of prompt parts a multiple of GRAIN
    level   the next substep is at most 2**-level of that; with ``prompt``, of all of the step
    calm    accepted substeps in a row that could have been longer
    events  of this step so far
    """

    base: float = 0.0
    part: float = 0.0
    level: float = 0
    calm: int = 0
    events: int = 0

    @property
    def fraction(self) -> float:
        """Of the step."""
        return self.base + self.part * (1.0 - self.base) if self.part < 1.0 else 1.0

    def next_step(self) -> SubstepCursor:
        """At the start of the next step."""
        return SubstepCursor(level=self.level, calm=self.calm)

    def as_progress(self) -> dict[str, float]:
        """The numbers that a checkpoint keeps of it."""
        return {f"place_{name}": float(value) for name, value in vars(self).items()}

    @classmethod
    def of(cls, progress: Mapping[str, float]) -> SubstepCursor:
        """The place that a checkpoint stored."""
        base, part = progress.get("place_base", 0.0), progress.get("place_part", 0.0)
        level, calm, events = (progress.get(f"place_{name}", 0) for name in ("level", "calm", "events"))
        return cls(base, part, level, int(calm), int(events))


def most_halvings(scene: Scene, fills: bool = False) -> int:
    """How often a step may be halved: never where the scene chooses the report's own methods, which show how they fail.

    fills  it fills fractures: pressure enters a tight one in far less than a time_step
    """
    return halvings_given(scene, FILLING if fills else USUAL) if scene.method.newton == "newton" else 0


def halvings_given(scene: Scene, usual: int = USUAL) -> int:
    """``accuracy.max_halvings``, or the usual number where the scene gives none."""
    given = scene.accuracy.max_halvings
    return usual if given is None else given


@dataclass(frozen=True)
class _Cause:
    """Why a substep failed: in words, and by the class and the kind of its error."""

    text: str = ""
    error: type[NotConverged] = NotConverged
    kind: str = ""

    def is_like(self, other: _Cause) -> bool:
        """Whether two substeps failed in the same way, wherever that was."""
        return (self.error, self.kind) == (other.error, other.kind)


@dataclass
class Substepped:
    """Divides a step of a stage into the fewest substeps that ``rules`` allow, each taken by another way to advance.

    place       where in the step it goes on
    prescribed  a part that may be halved to be accurate is, untried, where this is not straight in it
    """

    inner: Advance
    rules: Rules
    log: Log
    place: SubstepCursor = SubstepCursor()
    prescribed: PrescribedTimes = field(default_factory=PrescribedTimes)

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The next substep of a requested step, from the place on.

        Raises NotConverged, on every rank, with the last part's reason; SolveError where no shorter part mends it. A part that
        fails leaves no trace. Collective.
        """
        rules, place, step = self.rules, self.place, request.step
        assert step is not None
        most, refused, spent = rules.most + min(place.level, rules.finest), list[tuple[float, float]](), StepReport()
        last, other = _Cause(), ""
        for level, size in _sizes(place, max(most, rules.finest), rules.prompt):
            if rules.finest and level < place.level:
                continue
            start, end = place.fraction, replace(place, part=place.part + size).fraction
            if level < rules.finest and not self._is_straight(step, start, end):
                place = replace(place, level=min(level + 1, rules.finest), calm=0)
                continue
            asked = replace(step.part(state.controls, start, end), may_stop=place.events < rules.events)
            try:
                found = self.inner.advance(state, asked)
            except NotConverged as error:
                spent = spent.with_rejected(error.newton)
                again = level + 1 <= most
                so_on = ", as are all until it is at rest again or the stage ends" if rules.shrinks else ""
                halved = note(f"step halved{so_on}: {str(error).partition(';')[0]}")
                self.log(halved if again else marked(f"{GIVEN_UP}{error}"))
                now = _Cause(str(error).partition(";")[0], type(error), error.kind)
                last, other = now, other if now.is_like(last) else last.text
                if again:
                    place = replace(place, level=level + 1) if rules.prompt else place
                    continue
                tried = f" (after {rules.most} halvings of the step)" if rules.most else ""
                before = f"; before that: {other}" if other else ""
                raise NotConverged(f"{error}{tried}{before}", spent.wasted, spent.rejected, error.kind) from error
            except SolveError as error:  # that no shorter part mends
                wasted, rejected = spent.wasted + error.newton, spent.rejected + error.trials
                raise SolveError(str(error), wasted, rejected) from error
            if rules.order and found.error > 1.0 and level < (rules.finest or rules.most):
                found.state.destroy()
                spent = spent.with_rejected(found.report.newton)
                refused.append((level, min(found.error, HOPELESS)))
                deeper = min(level + _halvings(refused, rules), rules.finest) if rules.finest else level + 1
                place = replace(place, level=deeper, calm=0)
                continue
            break
        place = replace(place, level=max(place.level, level) if rules.order or rules.shrinks else 0)
        if found.reached < end:  # at an event the rest of the step is divided anew
            events = place.events + (not found.foreseen)
            place = replace(place, base=found.reached, part=0.0, events=events)
        else:
            place = _after(replace(place, part=place.part + size), size, found.error, rules)
        self.place = place.next_step() if place.fraction == 1.0 else place
        length = step.length * (found.reached - start)
        return replace(found, report=found.report.after_trials(spent), length=length)

    def _is_straight(self, step: LoadStep, begin: float, end: float) -> bool:
        end = step.first(step.ends, begin, end) or end
        inside = begin + 2.0 * AT_A_JUMP, end - 2.0 * AT_A_JUMP
        return self.prescribed.is_straight(*(step.begin + fraction * step.length for fraction in inside))


@dataclass
class InSmallStrains:
    """Ends a stage of which ``left`` trials had no linear solution, while pressures strained the rock beyond the model.

    Gaps and stiffnesses then span more digits than a double has. Later steps would fail likewise, half after half, towards
    results that are said to be meaningless. Trials count from the start of the stage, or from a resume.
    """

    inner: Advance
    scene: Scene
    left: int = MOST_UNSOLVED

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same. Raises SolveError, on every rank. Collective."""
        try:
            return self.inner.advance(state, request)
        except Unsolved as error:
            why = beyond_small_strains(self.scene, state.max_overpressure)
            self.left -= bool(why)
            if self.left > 0:
                raise
            failed = f"{str(error).partition('; ')[0]}, for the {MOST_UNSOLVED}th time"
            raise SolveError(f"{failed}: {why}", error.newton, error.trials + 1) from error


def _halvings(refused: Sequence[tuple[float, float]], rules: Rules) -> float:
    """Further halvings of a substep with these errors, over the allowed one, at these levels, if they go on falling so."""
    level, error = refused[-1]
    falls = float(rules.order)
    if len(refused) > 1:
        falls = math.log2(refused[-2][1] / error) / (level - refused[-2][0])
    falls = max(LEAST_ORDER, falls)
    if rules.prompt:
        return min(DEEPEST, _graded(math.log2(error / MARGIN) / falls))
    return max(1, min(DEEPEST, math.ceil(math.log2(error) / falls)))


def _graded(level: float) -> float:
    """The next level of a prompt part."""
    return math.ceil(GRADES * level) / GRADES


def _sizes(place: SubstepCursor, most: float, prompt: bool) -> Iterator[tuple[float, float]]:
    """Lengths to try, with their levels: the longest that fits the place, and its halves, of a prompt part each grade."""
    if prompt:
        left, rest = 1.0 - place.part, 1.0 - place.base
        first = max(_graded(place.level), math.floor(-GRADES * math.log2(left * rest)) / GRADES)
        for n in range(int(GRADES * max(most - first, 0.0)) + 1):
            level = first + n / GRADES
            size = 0.5**level / rest
            yield level, left if size >= left else GRAIN * max(1, round(min(size, 0.5 * left) / GRAIN))
        return
    size = min(next_substep(place.part), 0.5**place.level)
    n = 0
    while 0.5**n > size:
        n += 1
    yield from ((each, 0.5**each) for each in range(n, max(int(most), n) + 1))


def _after(place: SubstepCursor, size: float, error: float, rules: Rules) -> SubstepCursor:
    """The place where a substep of such a ``size`` has ended, with the length of the next one by its ``error``."""
    if not rules.order or rules.shrinks:
        return place
    if rules.prompt:
        longer = min((MARGIN / error) ** (1.0 / rules.order), MOST_OF_LAST) if error > 0.0 else MOST_OF_LAST
        return replace(place, level=max(_graded(-math.log2(longer * size * (1.0 - place.base))), 0.0))
    calm = place.calm + 1 if error < 0.5 ** (rules.order + 1) else 0
    return replace(place, level=max(place.level - 1, 0), calm=0) if calm > CALM else replace(place, calm=calm)


def next_substep(start: float) -> float:
    """Size of the part that begins at ``start``: its last binary digit, 1 at 0."""
    if start == 0.0:
        return 1.0
    numerator, denominator = start.as_integer_ratio()
    return (numerator & -numerator) / denominator
