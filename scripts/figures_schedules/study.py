"""Application 5.5's fault with its three wells on schedules: each run, its events catalogued, through the Python API."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from sheets import ROOT, Floats

import fracflow

WELLS, PLACES = ("node2", "node4", "node6"), (-2000, 0, 2000)  # on the fault [ft]
DURATION, HIGHEST, LOWEST = 1200.0, 1e5, 0.0  # of every schedule [s]; of the pressure in its wells [lbf/ft^2]
REST = "at_rest=0.03, rest_periods=2"  # small events too drop less than a thousandth of their energy
Rates = tuple[float, float, float]


class Schedule(NamedTuple):
    """Flow rates (n,) of ``WELLS`` at even times over ``DURATION``, straight between [ft^3/s]; the last are zero."""

    name: str
    rates: tuple[Rates, ...]

    @property
    def times(self) -> Floats:
        """When the rates are reached (n,) [s]."""
        return np.linspace(0.0, DURATION, len(self.rates))

    def overrides(self, refine: int) -> list[str]:
        """Its settings in meshes/report_5_5: sides across the fault absorb waves, those at its ends hold the rock."""
        times, well = self.times.tolist(), zip(WELLS, zip(*self.rates, strict=True), strict=True)
        given = [f"well.{name}.flow_rate={{time={times}, value={list(rates)}}}" for name, rates in well]
        given += [f"well.{name}.maximum_pressure={HIGHEST}" for name in WELLS]
        given += [f"well.{name}.minimum_pressure={LOWEST}" for name in WELLS]
        probes = ", ".join(f'{{name="{y}", at=[0, {y}], on="fault", quantities=["pressure"]}}' for y in PLACES)
        return [
            *given,
            'support=[{on=["south", "north"]}]',
            'absorbing=[{on=["west", "east"]}]',
            "method.stepper=generalised-alpha",  # the joints' own vibration is too fast for the steps
            "method.rho_infinity=0.5",
            "method.events=at-step-ends",
            f'stage=[{{name="schedule", kind="auto", time_step={DURATION / 120}, end={DURATION}, {REST}}}]',
            "control.pumping.initial=1",
            f"mesh.refine={refine}",
            f"probe=[{probes}]",
            "output.pictures=false",
        ]


class Found(NamedTuple):
    """The result of a schedule: its events (n,), in the order of time, and the highest pressure on the fault.

    moment    per unit thickness, G times slip times length [lbf]
    length    of fault that slipped [ft]
    unclosed  what the energy balance miss, of the energy released
    dropped   kinetic energy left out at the return to rest, of the same
    is_over   whether all came to rest
    """

    start: Floats
    moment: Floats
    length: Floats
    unclosed: Floats
    dropped: Floats
    pressure: float
    is_over: bool

    @property
    def total(self) -> float:
        """Moment of all events [lbf]."""
        return float(self.moment.sum())

    @property
    def largest(self) -> float:
        """Moment of the largest event [lbf]."""
        return float(self.moment.max(initial=0.0))

    @property
    def ratio(self) -> float:
        """The first over the second: how many events of the largest size the same moment would take."""
        return self.total / self.largest if self.largest else 0.0


def follow(schedule: Schedule, folder: Path, refine: int = 0, read: bool = False) -> Found:
    """Run a schedule into ``folder``, or ``read`` what a run left there. Raises SolveError."""
    if read:
        run = fracflow.open(folder)
    else:
        scene = fracflow.load(ROOT / "meshes" / "report_5_5" / "scene.toml", schedule.overrides(refine))
        run = fracflow.run(scene, folder)
    events = run.events[run.events["kind"] == "event"]
    energy = events["radiated"] + events["dissipated"]
    pressure = max(float(run.probe(name)["pressure"].max()) for name in run.probes)
    is_over = bool(run.times[-1] >= DURATION * (1.0 - 1e-9)) and int(run.steps["kind"][-1]) == 1
    return Found(
        events["start"], events["moment"], events["length"], events["unclosed"], events["dropped"] / energy, pressure, is_over
    )  # fmt: skip


def _times(pattern: Rates, *factors: float) -> tuple[Rates, ...]:
    return tuple((pattern[0] * f, pattern[1] * f, pattern[2] * f) for f in factors)


def _turns(*peaks: Rates) -> tuple[Rates, ...]:
    rest = (0.0, 0.0, 0.0)
    return (rest, *(rates for peak in peaks for rates in (peak, rest)))


def _locked(rate: float) -> tuple[Rates, ...]:
    """One well injects, its neighbours draw as much: end, centre, other end."""
    return (rate, -rate, 0.0), (-rate, rate, -rate), (0.0, -rate, rate)


AT_ONCE, SLOWLY = (1, 1, 1, 0), (0, 1 / 3, 2 / 3, 1, 0)
SCHEDULES = (
    Schedule("5.5 at once", _times((-9, 12, -9), *AT_ONCE)),
    Schedule("5.5 slowly", _times((-18, 24, -18), *SLOWLY)),
    Schedule("centre at once", _times((0, 12, 0), *AT_ONCE)),
    Schedule("centre slowly", _times((0, 12, 0), *SLOWLY)),
    Schedule("centre in and out", _times((0, 12, 0), 0, 1, -1, 1, 0)),
    Schedule("all slowly", _times((8, 8, 8), *SLOWLY)),
    Schedule("end to end slowly", _times((24, 0, -24), *SLOWLY)),
    Schedule("in turn, free", _turns((12, 0, 0), (0, 12, 0), (0, 0, 12))),
    Schedule("in turn, locked", _turns(*_locked(24))),
)
