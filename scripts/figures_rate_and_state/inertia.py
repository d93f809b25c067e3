"""meshes/injected_fault with inertia and with radiation damping alone: rate of slip, slip along the fault, moment."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from sheets import BLUE, ORANGE, Check, Floats, save, sheet, write_csv

from fracflow.api import Run

SHEAR, HALF = 32.04e9, 1500.0  # of the scene [Pa], [m]
FAST = 1e-2  # rate at which the event begins, here [m/s]
BEFORE, AFTER, EVERY = 1.0, 5.0, 0.25  # of that instant [s]
CLOSED = 1e-10  # of the friction
COMMAND = "scripts/figures rate-and-state"


class _Event(NamedTuple):
    """The event of a run: its times (n,) since a rate of ``FAST``, rates and slips (n, p) at distances (p,) from the well."""

    label: str
    colour: str
    times: Floats
    rate: Floats
    slip: Floats
    distance: Floats

    @property
    def moment(self) -> Floats:
        """Moment (n,) of both halves of the fault per thickness, whose slip is nothing at its ends [N m/m]."""
        slip = np.column_stack([self.slip, np.zeros(len(self.times))])
        found: Floats = SHEAR * ((slip[:, 1:] + slip[:, :-1]) @ np.diff(np.append(self.distance, HALF)))
        return found

    def at(self, values: Floats, time: float) -> Floats:
        """Rows of ``values`` at a time."""
        return values[np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, None)]


def _event(run: Run, label: str, colour: str) -> _Event:
    names = sorted(run.probes, key=lambda name: float(name[1:]))
    rate, slip = (
        np.column_stack([np.abs(run.probe(name)[key]) for name in names]) for key in ("sliding_rate", "plastic_slip")
    )
    first = float(run.times[np.flatnonzero(rate.max(axis=1) > FAST)[0]])
    return _Event(label, colour, run.times - first, rate, slip, np.array([float(name[1:]) for name in names]))


def draw(moving: Run, slow: Run, folder: Path) -> list[Check]:
    """Draw ``inertia`` into ``folder`` and return the bars."""
    events = _event(moving, "with inertia", ORANGE), _event(slow, "radiation damping alone", BLUE)
    figure, axes = sheet(
        "An event that injection sets off, with inertia and without",
        f"BP6 with a fault that weakens with the rate of slip; time since slip of {1e3 * FAST:g} mm/s.",
        [["rate", "moment"], ["moving", "slow"]], (10.0, 7.2),
    )  # fmt: skip
    for each, key in zip(events, ("moving", "slow"), strict=True):
        shown = (each.times >= -BEFORE) & (each.times <= AFTER)
        for column, style, place in ((0, "-", "well"), (-1, "--", f"{each.distance[-1]:g} m")):
            axes["rate"].semilogy(
                each.times[shown], each.rate[shown, column], style, color=each.colour, label=f"{place}, {each.label}"
            )
        axes["moment"].plot(each.times[shown], each.moment[shown] / 1e12, color=each.colour, label=each.label)
        for time in np.arange(-BEFORE, AFTER + EVERY / 2, EVERY):
            along, slip = (
                np.append(each.distance, HALF),
                np.append(each.at(each.slip, time), 0.0),
            )  # nothing slips beyond
            axes[key].plot(along, slip, color=each.colour, linewidth=0.8)
        axes[key].set(xlabel="distance from the well [m]", ylabel="slip [m]", title=f"every {EVERY:g} s, {each.label}")
    most = 1.05 * max(float(each.at(each.slip, AFTER).max()) for each in events)
    for key in ("moving", "slow"):
        axes[key].set(xlim=(0, HALF), ylim=(0, most))
    axes["rate"].set(xlabel="time [s]", ylabel="rate of slip [m/s]", ylim=(1e-6, 5))
    axes["rate"].legend(fontsize=7, handlelength=1.5, borderaxespad=0.0)
    axes["moment"].set(xlabel="time [s]", ylabel="moment per thickness [TN m/m]")
    axes["moment"].legend(fontsize=8)
    save(figure, folder, "inertia", COMMAND)
    columns = {}
    for each, name in zip(events, ("with_inertia", "damping_alone"), strict=True):
        shown = (each.times >= -BEFORE) & (each.times <= AFTER)
        columns |= {
            f"{name}_time": each.times[shown], f"{name}_rate_at_well": each.rate[shown, 0],
            f"{name}_rate_at_end": each.rate[shown, -1], f"{name}_moment": each.moment[shown],
        }  # fmt: skip
    write_csv(folder, "inertia", columns, [COMMAND])
    return _bars(moving, slow, events)


def _bars(moving: Run, slow: Run, events: tuple[_Event, _Event]) -> list[Check]:
    slip, rate, moment = (
        [float(values(each)) for each in events]
        for values in (
            lambda each: each.at(each.slip, AFTER).max(),
            lambda each: each.rate.max(),
            lambda each: each.at(each.moment, AFTER),
        )
    )
    catalogue = moving.events[moving.events["kind"] == "event"]
    unclosed = max(
        float(np.abs(run.energy["residual"]).max() / np.abs(run.energy["friction"]).max()) for run in (moving, slow)
    )
    return [
        Check("events in the catalogue with inertia", len(catalogue), "1", len(catalogue) == 1),
        Check("slip with inertia over that without", slip[0] / slip[1], "> 1.2", slip[0] > 1.2 * slip[1]),
        Check("largest rate with inertia over that without", rate[0] / rate[1], "> 2", rate[0] > 2.0 * rate[1]),
        Check("moment with inertia over that without", moment[0] / moment[1], "> 1.2", moment[0] > 1.2 * moment[1]),
        Check("energy not closed, of the friction", unclosed, f"<= {CLOSED:g}", unclosed <= CLOSED),
    ]
