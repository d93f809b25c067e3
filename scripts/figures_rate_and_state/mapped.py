"""meshes/mapped_network, its two scenes: where it slipped and where events began, catalogue, moment in time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from numpy.typing import NDArray
from sheets import BLUE, HALO, INK, ORANGE, PALE, Check, Floats, save, sheet, write_csv

from fracflow.api import Run
from fracflow.errors import InputError
from fracflow.output.profiles import read_profiles
from fracflow.output.reader import load_fractures

MINUTE, HOUR, DAY, MM, GIGA = 60.0, 3600.0, 86400.0, 1e-3, 1e9
SHEAR, SHUT_IN = 20e9, 2 * DAY  # of the scene [Pa], [s]
STILL = 1e-2  # of the largest slip: less is drawn in grey
CLOSED = 1e-10  # energy not closed, of the friction


@dataclass(frozen=True)
class Picture:
    """Of one of the scenes.

    name    of the files
    only    of the figure in the command
    words   below the title
    shown   west, east, south, north of the part that slips [m]
    events  at least so many
    most    length of a rupture that none reaches [m]
    """

    name: str
    only: str
    words: str
    shown: tuple[float, float, float, float]
    events: int
    most: float

    @property
    def command(self) -> str:
        """By which it is drawn."""
        return f"scripts/figures rate-and-state --only {self.only}"


BY_RATE = Picture(
    "catalogue", "mapped_network",
    "Two days at 3 L/s into trace 1, two days shut in. Friction of rate and state; circles: where events began, in turn.",
    (230.0, 540.0, 20.0, 330.0), 3, 600.0,
)  # fmt: skip
BY_SLIP = Picture(
    "slip_weakening", "slip_weakening",
    "Two days at 5 L/s into trace 1, two days shut in. Friction weakens with slip; circles: places of the catalogue.",
    (210.0, 580.0, 20.0, 350.0), 2, 1000.0,
)  # fmt: skip


def draw(run: Run, folder: Path, picture: Picture) -> list[Check]:
    """Draw ``picture`` into ``folder`` and return the bars."""
    events = run.events[run.events["kind"] == "event"]
    segments, slip, times, moments = _slip(run)
    fast = np.array([events["moment"][events["start"] < time].sum() for time in times])
    figure, axes = sheet(
        "Injection into a mapped network of 63 traces, Sotra, Norway",
        picture.words,
        [["map", "sizes"], ["map", "moment"]], (10.0, 5.6), width_ratios=[1.15, 1],
    )  # fmt: skip
    ax = axes["map"]
    ax.add_collection(LineCollection(list(segments), colors=PALE, linewidths=0.8))
    slips = slip > STILL * slip.max()
    lines = LineCollection(list(segments[slips]), cmap="viridis_r", linewidths=1.0 + 4.0 * slip[slips] / slip.max())
    lines.set_array(slip[slips] / MM)
    ax.add_collection(lines)
    figure.colorbar(lines, ax=ax, label="slip after four days [mm]", orientation="horizontal", shrink=0.7)
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=picture.shown[:2], ylim=picture.shown[2:])
    ax.set_title("Part of the network around the well")
    (well,) = (each for each in run.scene.well if each.name == "injector")
    ax.plot(*well.at, "v", color=BLUE, markeredgecolor=INK, markersize=9)
    ax.annotate("injector", well.at, (-8, -3), textcoords="offset points", ha="right", path_effects=HALO)
    for number, event in enumerate(events, 1):
        ax.plot(event["x"], event["y"], "o", color="white", markeredgecolor=ORANGE, markersize=12)
        ax.text(event["x"], event["y"], str(number), ha="center", va="center", color=ORANGE, fontweight="bold")
    minutes = events["start"] / MINUTE
    axes["sizes"].vlines(minutes, 0.0, events["magnitude"], color=PALE)
    axes["sizes"].plot(minutes, events["magnitude"], "o", color=ORANGE)
    for number, (event, minute) in enumerate(zip(events, minutes, strict=True), 1):
        after = number == len(events)
        place = (5, 4) if after else (-5, -11 if number % 2 else 4)  # apart where events follow fast
        axes["sizes"].annotate(
            f"{number} on {event['fracture']}", (minute, event["magnitude"]), place, fontsize=8,
            ha="left" if after else "right", textcoords="offset points",
        )  # fmt: skip
    low, high = events["magnitude"].min() - 0.2, events["magnitude"].max() + 0.15
    axes["sizes"].set(xlabel="time [min]", ylabel="magnitude", xlim=(0, 1.2 * minutes.max()), ylim=(low, high))
    axes["sizes"].set_title("Catalogue, number and trace")
    for values, colour, label in (
        (moments, INK, "all slip"),
        (fast, ORANGE, "in events"),
        (moments - fast, BLUE, "between"),
    ):
        axes["moment"].semilogx(times / HOUR, values / GIGA, color=colour, label=label)
    axes["moment"].axvline(SHUT_IN / HOUR, color=PALE, linewidth=0.8)
    axes["moment"].annotate(
        "shut in", (SHUT_IN / HOUR, 0.0), (-3, 4), textcoords="offset points", ha="right", fontsize=8
    )
    axes["moment"].set(xlabel="time [h]", ylabel="moment [GN m/m]", xlim=(0.25, times[-1] / HOUR))
    axes["moment"].set_ylim(bottom=0.0)
    axes["moment"].legend(fontsize=8, loc="upper left")
    save(figure, folder, picture.name, picture.command)
    keys = ("start", "end", "length", "mean_slip", "slip", "stress_drop", "moment", "magnitude", "radiated", "injected")
    columns = {"time": times, "moment": moments, "in_events": fast, **{f"event_{key}": events[key] for key in keys}}
    write_csv(folder, picture.name, columns, [picture.command])
    return _bars(run, events, moments, fast, picture)


def _slip(run: Run) -> tuple[Floats, Floats, Floats, Floats]:
    """Joints (n, 2, 2), slip (n,) at the end, times (k,) of the profiles, and moment (k,) then [m, m, s, N m/m]."""
    fields, profiles = load_fractures(run.folder, np.inf), read_profiles(run.folder)
    if fields is None or not profiles:
        raise InputError(f"{run.folder}: has no profiles along fractures; run the scene anew")
    half = 0.5 * np.linalg.norm(np.diff(fields.segments, axis=1)[:, 0], axis=1)
    slip = np.abs(profiles["plastic_slip"]).reshape(len(profiles["time"]), -1)
    lengths: NDArray[np.float64] = np.zeros(slip.shape[1])
    np.add.at(lengths, fields.cells, half[:, None])
    return fields.segments, slip[-1][fields.cells].mean(axis=1), profiles["time"], SHEAR * (slip @ lengths)


def _bars(run: Run, events: NDArray[np.void], whole: Floats, fast: Floats, asked: Picture) -> list[Check]:
    unclosed = float(np.abs(run.energy["residual"]).max() / np.abs(run.energy["friction"]).max())
    slow, longest = float(1.0 - fast[-1] / whole[-1]), float(events["length"].max())
    days, ended = run.times[-1] / DAY, run.status == "ended"
    return [
        Check("events in the catalogue", len(events), f">= {asked.events}", len(events) >= asked.events),
        Check("longest rupture [m]", longest, f"< {asked.most:g}", longest < asked.most),
        Check("moment between events, of all", slow, "0.05 to 0.95", 0.05 < slow < 0.95),
        Check("energy not closed, of the friction", unclosed, f"<= {CLOSED:g}", unclosed <= CLOSED),
        Check("days", days, "4, ended", ended and abs(days - 4.0) < 1e-6),
    ]
