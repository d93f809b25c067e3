"""Who follows a run: an object with a method for each thing that happens, or a function that is given the steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fracflow.advance.step import Step
    from fracflow.model.state import TrialProgress


class Observer:
    """Is given what happens in a run; each method does nothing but where a subclass says otherwise."""

    def __call__(self, step: Step) -> None:
        """A step has been taken and recorded. On every rank."""

    def trial(self, time: float, length: float, why: str) -> None:
        """A step without inertia of a stage auto was tried from a time, and rejected [time]. On every rank."""

    def follow(self, trial: TrialProgress) -> None:
        """The trial under way, which changes while a step is made. On every rank."""

    def saved(self, steps: int) -> None:
        """The state after so many steps is on disk. On rank 0 only."""

    def sections(self, slipping: int, is_open: int) -> None:
        """Numbers of joint ends that slip and that are open in the step that is reported next. On rank 0 only."""


class _OfSteps(Observer):
    """A function that is given each step."""

    def __init__(self, report: Callable[[Step], None]) -> None:
        self.report = report

    def __call__(self, step: Step) -> None:
        self.report(step)


def observer_of(progress: Observer | Callable[[Step], None] | None) -> Observer:
    """An observer as it is, one of a function, or one that does nothing."""
    if isinstance(progress, Observer):
        return progress
    return Observer() if progress is None else _OfSteps(progress)
