"""A step that does not converge is taken in two halves, and each of them likewise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from fracflow.errors import NotConverged
from fracflow.scene import Scene
from fracflow.state import State, StepReport

Attempt = Callable[[State, float, float], tuple[State, StepReport]]
"""(state, from, to) -> the state at the fraction ``to`` of a step, from that at the fraction ``from``."""


def most_halvings(scene: Scene) -> int:
    """How often a step may be halved: never where the report's own methods are to show how they fail."""
    return scene.accuracy.max_halvings if scene.method.newton == "newton" else 0


@dataclass(frozen=True)
class PartOfStep:
    """A state that was reached, the part of the step that led to it, and whether the whole step is done."""

    state: State
    report: StepReport
    start: float
    end: float

    @property
    def is_last(self) -> bool:
        """Whether the step ends here."""
        return self.end == 1.0


def whole_or_halves(
    attempt: Attempt, state: State, most: int, log: Callable[[str], None], start: float = 0.0
) -> Iterator[PartOfStep]:
    """The whole step, or the fewest halves of halves, at most ``most`` times halved, that converge.

    ``start`` is the fraction that was reached before, a sum of powers of 1/2: the next part ends where the halving that
    led there has its next end, so a run can go on from any part. Raises NotConverged, on every rank, with the last
    part's reason; a part that fails leaves no trace. Collective.
    """
    while start < 1.0:
        size = next_part(start)
        while True:
            try:
                new, report = attempt(state, start, start + size)
                break
            except NotConverged as error:
                if size <= 0.5**most:
                    tried = f" (after {most} halvings of the step)" if most else ""
                    raise NotConverged(f"{error}{tried}") from error
                log(f"step halved: {str(error).partition(';')[0]}")
                size *= 0.5
        part = PartOfStep(new, report, start, start + size)
        yield part
        state, start = new, part.end


def next_part(start: float) -> float:
    """Size of the part that begins at ``start``: its last binary digit, 1 at 0."""
    if start == 0.0:
        return 1.0
    numerator, denominator = start.as_integer_ratio()
    return (numerator & -numerator) / denominator


def on_the_way(before: Mapping[str, float], after: Mapping[str, float], start: float, end: float) -> dict[str, float]:
    """Controls at the fraction ``end`` of a step that goes on to ``after``, from ``before`` at the fraction ``start``."""
    if end == 1.0:
        return dict(after)
    share = (end - start) / (1.0 - start)
    return {name: value + share * (after[name] - value) for name, value in before.items()}


def still_lacking(start: float, end: float) -> float:
    """Share, at ``end``, of what the state at ``start`` lacks of the prescribed: all of it arrives by the end of the step."""
    return (1.0 - end) / (1.0 - start)
