"""Counts of a run, and the summary at the end of its log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fracflow.errors import SolveError
from fracflow.model.state import COUNTS, StepReport, Work
from fracflow.remarks import marked, note

EARLIER = {"told_factor": "reported_factor"}  # names in checkpoints of earlier versions
NARROW = 1e-9  # a decision on a status nearer to its threshold than this is not settled by arithmetic


@dataclass
class Totals:
    """Counts over the run.

    injected  net volume that wells have brought, as in the last state [length^3]
    counts    of all steps, as of ``StepReport``. Those rejected and wasted are also of a step that failed.
    evaluations of both balances, and ``factored`` matrices, in all. Those for rejected trials count too.
    widening  largest factor by which an aperture grew in a step, as the log last reported it; 1 where it reported none
    missed    work of friction that steps with inertia miss, and ``turning``, whether the log has a line on it
    damped    largest share of energy that damping at faults has taken, as the log last reported it
    doubts    lines of the log that say that a result may be wrong
    profiles  where the ``Timetable`` of the profiles stands
    at_limit  wells that were held at a limit of their pressure, as name/key, and those that flowed backward there
    undone    decisions of the plan that were taken back: "part, stage" -> when and why
    meshed    the mesh that an event in rock without one was given: "when" and "why" in words, "cells" and "nodes".
              So many "times" events have needed it; "frozen" is the largest traction that a change to it has left
    event_fields  records whose fields are kept, besides those asked for: the last ones on the mesh of events
    """

    steps: int = 0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))
    narrowest: float = np.inf
    narrow_time: float = np.nan
    least: int = 0
    least_flow: float = 0.0
    spurious: float = 0.0
    spurious_time: float = np.nan
    handed_over: int = 0
    reported_factor: float = np.nan
    injected: float = 0.0
    evaluations: int = 0
    factored: int = 0
    strained: int = 0
    fast_slip: int = 0
    far_slip: float = 0.0
    sucked: int = 0
    open_tips: int = 0
    overlapped: int = 0
    damped: float = 0.0
    widening: float = 1.0
    missed: float = 0.0
    turning: int = 0
    doubts: list[str] = field(default_factory=list)
    at_limit: list[str] = field(default_factory=list)
    undone: dict[str, str] = field(default_factory=dict)
    meshed: dict[str, Any] = field(default_factory=dict)
    event_fields: list[int] = field(default_factory=list)
    profiles: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, saved: Mapping[str, Any]) -> Totals:
        """Those that a checkpoint keeps, under names of earlier versions too. Raises TypeError for others."""
        known = {EARLIER.get(name, name): value for name, value in saved.items()}
        counts = dict.fromkeys(COUNTS, 0) | {name: known.pop(name) for name in COUNTS if name in known}
        return cls(**known | {"counts": counts | known.get("counts", {})})

    def add(self, report: StepReport) -> None:
        """Count a step."""
        self.steps += 1
        for name in COUNTS:
            self.counts[name] += getattr(report, name)

    def observe(self, time: float, margin: float, least: int, least_flow: float) -> None:
        """Keep the smallest margin of a status with its time, and the most that minimum apertures did; see ``Snapshot``."""
        if margin < self.narrowest:
            self.narrowest, self.narrow_time = margin, time
        self.least, self.least_flow = max(self.least, least), max(self.least_flow, least_flow)

    def give_up(self, failure: SolveError) -> None:
        """Count the trials of a step that failed."""
        self.counts["rejected"] += failure.trials
        self.counts["wasted"] += failure.newton

    def spend(self, work: Work) -> None:
        """Count the work since the last time, and let it be counted."""
        self.evaluations, self.factored = self.evaluations + work.evaluations, self.factored + work.factorisations
        work.evaluations = work.factorisations = 0

    def in_words(self) -> str:
        """Steps and their largest counts."""
        newton, factorisations = self.counts["newton"], self.counts["factorisations"]
        return f"{self.steps} steps, {newton} Newton iterations, {factorisations} factorisations"

    def besides(self) -> str:
        """The rejected trials, in words; empty without any."""
        rejected, wasted = self.counts["rejected"], self.counts["wasted"]
        if not rejected:
            return ""
        return f"; besides {rejected} trials rejected, on which {wasted} Newton iterations were spent"

    def summary(self, watches_spurious: bool, seconds: float) -> Iterator[str]:
        """The lines that end the log, after so many ``seconds``."""
        if self.narrowest < NARROW:
            yield marked(
                f"smallest slip margin {self.narrowest:.1e} at time {self.narrow_time:.6g}:"
                " what follows there is not settled by arithmetic"
            )
        if watches_spurious:
            yield note(
                f"spurious work of the coupling: at most {self.spurious:.1e} of the largest entry of the energy balance"
                + (f", at time {self.spurious_time:.6g}" if self.spurious else "")
            )
        if self.least:
            yield note(
                f"up to {self.least} joint ends conducted by minimum_hydraulic_aperture, at most {self.least_flow:.3g}"
                " (volume/time) through one of them: halve it, and see whether anything changes"
            )
        if self.handed_over:
            yield f"{self.handed_over} steps were handed over to the monolithic solver"
        refused, solved, newton = (self.counts[name] for name in ("refused", "solved", "newton"))
        if refused:
            yield f"joints of {refused} of {solved} explicit steps took more than the guess of the compiled loops"
        if self.evaluations:
            share = self.evaluations / max(newton, 1)  # less than one where joints alone are brought into balance
            each = f"; {share:.1f} evaluations for each iteration of an accepted step" if share >= 1.0 else ""
            alone = "" if each else ", besides those of joints and their fluid alone"
            yield (
                f"work in all: {self.evaluations} evaluations of the balances, {self.factored} factorisations{alone}{each}"
            )
        yield f"{self.in_words()}{self.besides()} in {seconds:.2f} s"
