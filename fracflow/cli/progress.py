"""Where a run is: a bar and a line below it on a terminal, or a line a minute into a file.

The time left is that of the stage under way, by its pace so far. Two times are given where the pace has changed. During an
event it is the least that the event takes until motion may count as rest, and none beyond that. Between events their time so
far is given.
"""

from __future__ import annotations

import math
import threading
import time as clock
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from rich.console import Console

from fracflow.advance.substeps import SubstepCursor
from fracflow.output.drawing.axes import shown, unit_for
from fracflow.remarks import counted
from fracflow.scene.boundary import Stage
from fracflow.scene.units import TIME, TIME_UNITS
from fracflow.simulation.observer import Observer
from fracflow.storage.files import shown_plain

if TYPE_CHECKING:
    from fracflow.advance.step import Step
    from fracflow.cli.bar import Bar
    from fracflow.model.state import TrialProgress
    from fracflow.scene.scene import Scene

LEAST_SECONDS, LEAST_STEPS = 2.0, 3  # of a stage from which on its pace is known
STEADY = 1.5  # ratio of the pace of the whole stage and of its later half: beyond it two times are given
MOST_SAMPLES = 256
INTERVAL = 60.0  # from line to line of progress where it goes into a file [s]
LONG_STEP = 5.0  # from which on a terminal shows where the solve of a step is [s]
SETTING_UP = "setting up: mesh, model, what is left out"


class RunProgress(Observer):
    """The state of a run in words, from the steps that it reports.

    show      is given a line, and the share of the stage that is done or None where its end is not known
    seconds   the time now [s]
    on_saved  is given the number of steps up to the last state on disk
    on_trial  is given the trial under way
    """

    def __init__(
        self,
        scene: Scene,
        show: Callable[[str, float | None], None],
        seconds: Callable[[], float] = clock.monotonic,
        on_saved: Callable[[int], None] | None = None,
        on_trial: Callable[[TrialProgress], None] | None = None,
    ) -> None:
        """Before the first step."""
        self.scene, self.show, self.seconds, self.on_saved, self.on_trial = scene, show, seconds, on_saved, on_trial
        self.rejected = self.since = 0
        self.counts: tuple[int, int] | None = None
        self.line = SETTING_UP
        self.share: float | None = None
        self.pace, self.stage, self.events = Pace(seconds()), -1, EventPace()
        show(self.line, None)

    def saved(self, steps: int) -> None:
        """The state after so many steps is on disk."""
        if self.on_saved is not None:
            self.on_saved(steps)

    def follow(self, trial: TrialProgress) -> None:
        """The trial under way."""
        if self.on_trial is not None:
            self.on_trial(trial)

    def sections(self, slipping: int, is_open: int) -> None:
        """Sections that slip and that are open in the step that is reported next."""
        self.counts = slipping, is_open

    def trial(self, time: float, length: float, why: str) -> None:
        """A step of a length was tried from a time, and rejected."""
        self.since += 1
        number, at = self.rejected + self.since, self._shown(time)
        self.show(f"{self.line}, {number} trials rejected, the last of {self._shown(length)} at {at}", self.share)

    def __call__(self, step: Step) -> None:
        """A step has been taken; its report counts the trials before it."""
        self.rejected, self.since = self.rejected + step.report.rejected, 0
        stage = self.scene.stage[step.stage]
        share = share_done(stage, self._start(step.stage), step)
        if step.stage != self.stage or self.pace.goes_back(share):  # or the run has begun anew
            self.stage, self.pace = step.stage, Pace(self.seconds())
        event = step.regime == "dynamic" and stage.kind == "auto"
        self.pace.add(self.seconds(), share, event)
        self.events.add(self.seconds(), step.progress if event else None)
        head = f"stage {step.stage + 1} of {len(self.scene.stage)} ({stage.title}): {self._where(stage, step)}"
        found = ""
        if self.counts is not None:
            slipping, opened = self.counts
            found = f", {counted(slipping, 'section')} slip{'s' * (slipping == 1)}, {opened} open"
        self.line, self.share = head + found + ("" if event else self.events.account), share
        rejected = f", {counted(self.rejected, 'trial')} rejected" if self.rejected else ""
        left = self._left(stage, step.progress if event else None)
        self.show(self.line + rejected + (f"; {left}" if left else ""), share)

    def _start(self, number: int) -> float:
        """When a stage begins, as far as the scene says it [time]."""
        start = 0.0
        for stage in self.scene.stage[:number]:
            start = stage.finish(start)
        return start

    def _shown(self, time: float) -> str:
        """A time in a unit that suits it, with three digits, or more where those before the point are more."""
        names = self.scene.unit_names
        whole = int(abs(unit_for(TIME, time, names)[0] * time))
        return shown_plain(shown(TIME, time, names, max(3, len(str(whole)))))

    def _where(self, stage: Stage, step: Step) -> str:
        """How far a stage is: its step and the part of it, its control, its regime and its time."""
        now, progress = self._shown(step.state.time), step.progress or {}
        if stage.takes_no_time and stage.control is not None:
            return f"control.{stage.control} at {step.state.controls[stage.control]:.4g}"
        if stage.kind == "auto":
            onset = self._shown(step.state.time - progress.get("begun", step.state.time))
            what = f"dynamic, in an event for {onset}," if step.regime == "dynamic" else "quasi-static,"
            return f"{what} at {now} of {self._shown(stage.end or 0.0)}"
        part, count = SubstepCursor.of(progress).fraction % 1.0, stage.step_count(progress.get("start", 0.0))
        if "n" not in progress:
            return f"{stage.kind}, at {now}"
        number = int(progress["n"]) + (part > 0.0)
        among = f" of {count}" if count is not None else ""
        inside = f", {part:.0%} of it done in substeps" if part > 0.0 else ""
        return f"{stage.kind}, step {number}{among}{inside}, at {now}"

    def _left(self, stage: Stage, event: Mapping[str, float] | None) -> str:
        """The time left in words, in an event that of it; empty while the pace is not known yet."""
        if stage.takes_no_time and stage.until is not None:
            return "its end is not known before the first section is about to slip"
        if event is not None:
            least = self.events.least_left(event, stage)
            return (
                f"the event takes at least {spoken(least)} more"
                if least
                else "the time left is not known during an event"
            )
        after = len(self.scene.stage) - 1 - self.stage
        rest = f" in this stage, with {after} more after it" if after else ""
        found = self.pace.left()
        if found is None:
            return ""
        low, high = (spoken(each) for each in found)
        if stage.kind == "auto":
            return f"{low} left{rest} + events"
        if stage.until is not None:
            return f"at most {high} left{rest}"
        return f"about {low} left{rest}" if found[1] <= STEADY * found[0] else f"{low} to {high} left{rest}"


class EventPace:
    """The seconds that the events of a run have taken, and those of the one under way."""

    def __init__(self) -> None:
        """Before the first event."""
        self.spent, self.done = 0.0, 0
        self._began: tuple[float, float] | None = None  # seconds and steps as the run first showed the event under way
        self._last = 0.0

    def add(self, now: float, progress: Mapping[str, float] | None) -> None:
        """After a step that ended at a time [s], with where it is in an event; None outside."""
        if progress is not None and self._began is None:
            self._began = now, progress.get("count", 0.0)
        elif progress is None and self._began is not None:
            self.spent, self.done, self._began = self.spent + self._last - self._began[0], self.done + 1, None
        self._last = now

    def least_left(self, progress: Mapping[str, float], stage: Stage) -> float:
        """Seconds until the event may be at rest, by its steps so far; 0 where that is past, or not known yet."""
        if self._began is None or not progress.get("least"):
            return 0.0
        (began, first), count = self._began, progress.get("count", 0.0)
        steps = max(1.0, stage.rest_periods) * progress.get("period", 0.0) / progress["least"]
        known = self._last - began >= LEAST_SECONDS and count > first + LEAST_STEPS
        return max(0.0, steps - count) * (self._last - began) / (count - first) if known else 0.0

    @property
    def account(self) -> str:
        """The events so far and their time, in words; empty before the first."""
        if not self.done:
            return ""
        return f", {self.done} event{'s' * (self.done > 1)} so far in {spoken(self.spent)}"


class Pace:
    """The pace of a stage, from its shares done at times; time spent in events counts for nothing."""

    def __init__(self, now: float) -> None:
        """As a stage begins, at a time [s]."""
        self.last, self.spent, self.steps = now, 0.0, 0
        self.samples: list[tuple[float, float]] = []  # seconds spent, share done

    def goes_back(self, share: float | None) -> bool:
        """Whether less is done than before."""
        return share is not None and bool(self.samples) and share < self.samples[-1][1]

    def add(self, now: float, share: float | None, event: bool) -> None:
        """After a step that ended at a time [s], with the share done or None."""
        self.spent += 0.0 if event or not self.steps else now - self.last
        self.last, self.steps = now, self.steps + 1
        if share is None:
            return
        self.samples.append((self.spent, share))
        if len(self.samples) > MOST_SAMPLES:
            self.samples = [*self.samples[:-1:2], self.samples[-1]]

    def left(self) -> tuple[float, float] | None:
        """Shortest and longest time left [s], by the pace of the whole stage and of its later half; None if unknown."""
        if self.steps <= LEAST_STEPS or self.spent < LEAST_SECONDS or not self.samples:
            return None
        spent, share = self.samples[-1]
        half = [each for each in self.samples if each[0] <= 0.5 * spent][-1]
        found = [(share - done) / (spent - then) for then, done in (self.samples[0], half) if spent > then]
        if not found or min(found) <= 0.0:
            return None
        times = [(1.0 - share) / each for each in found]
        return min(times), max(times)


def share_done(stage: Stage, start: float, step: Step) -> float | None:
    """The share of a stage that is done after a step, from 0 to 1; None where nothing says its end.

    start  when the stage begins, if a step does not say it [time]
    """
    progress = step.progress or {}
    if stage.kind == "auto" and stage.end is not None:
        return min(max((step.state.time - start) / (stage.end - start), 0.0), 1.0) if stage.end > start else None
    count = stage.step_count(progress.get("start", start))
    if "done" in progress or not count or "n" not in progress:
        return 1.0 if "done" in progress else None
    return min((progress["n"] + SubstepCursor.of(progress).fraction % 1.0) / count, 1.0)


def spoken(seconds: float) -> str:
    """A time as a person says it: 40 s, 12 min, 3.5 h, 2.1 days."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    unit = "min" if seconds < 90.0 * TIME_UNITS["min"] else "h" if seconds < 48.0 * TIME_UNITS["h"] else "days"
    return f"{seconds / TIME_UNITS[unit]:.2g} {unit}"


def inside(trial: TrialProgress | None, seconds: float, least: float) -> str:
    """Where the solve of a step is that has lasted for some seconds, in words; empty where they are below the least."""
    if seconds < least:
        return ""
    solve = ""  # of explicit steps, and before the first balance
    if trial is not None and math.isfinite(trial.unbalanced):
        solve = f" at Newton iteration {trial.iteration}, {trial.unbalanced:.1e} out of balance"
    return f", and this for {spoken(seconds)}{solve}"


class Screen:
    """Shows where a run is: on a terminal by a bar, else by a line every INTERVAL seconds; nothing where it is quiet."""

    def __init__(self, console: Console, name: str) -> None:
        """Of a run with a name."""
        self.console, self.name = console, shown_plain(name)
        self._line, self._began, self._since = "", clock.monotonic(), clock.monotonic()
        self._ended = threading.Event()
        self._writer: threading.Thread | None = None
        self._bar: Bar | None = None
        self._trial: TrialProgress | None = None

    def __enter__(self) -> Screen:
        if self.console.quiet:
            return self
        if self.console.is_terminal:
            from fracflow.cli.bar import Bar

            self._bar = Bar(self.console, self.name)
            self._bar.start()
        self._writer = threading.Thread(target=self._write if self._bar is None else self._renew, daemon=True)
        self._writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._bar is not None:
            self._bar.stop()
        if self._writer is not None:
            self._writer.join()

    def show(self, line: str, share: float | None) -> None:
        """Show a line, and a share done or None where the end is not known."""
        self._line, self._since = line, clock.monotonic()
        if self._bar is not None:
            self._bar.show(line, share)

    def follow(self, trial: TrialProgress) -> None:
        """The trial under way."""
        self._trial = trial

    def _renew(self) -> None:
        while self._bar is not None and not self._ended.wait(1.0):
            self._bar.inside = inside(self._trial, clock.monotonic() - self._since, LONG_STEP)

    def _write(self) -> None:
        while not self._ended.wait(INTERVAL):
            now = clock.monotonic()
            still = inside(self._trial, now - self._since, INTERVAL)
            said = f"after {spoken(now - self._began)}: {shown_plain(self._line)}{still}"
            try:
                self.console.print(f"{self.name}: {said}", soft_wrap=True, markup=False, highlight=False)
            except OSError:  # of a full disk: the run itself reports what it cannot write
                return
