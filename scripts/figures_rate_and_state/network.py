"""meshes/ten_faults: rates of slip, moment slow and fast against volume injected, the catalogue and its Gutenberg-Richter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sheets import BLUE, INK, ORANGE, PALE, Check, Floats, save, sheet, write_csv

from fracflow.api import Run
from fracflow.errors import InputError
from fracflow.output.profiles import read_profiles
from fracflow.output.reader import load_fractures

HOUR, LITRE, MILLION = 3600.0, 1e-3, 1e6
SHEAR = 32.04e9  # of the scene [Pa]
WEAKENING = ("H1", "H2", "H3", "H4", "H5")  # the others strengthen with the rate of slip
ENOUGH = 50  # events, below which a b-value is not drawn
EVENTS, CLOSED = 3, 1e-10  # at least so many; energy not closed, of the friction
SHARE = 0.05  # of the moment that faults which strengthen take at least
COMMAND = "scripts/figures rate-and-state --only ten_faults"


def draw(run: Run, folder: Path) -> list[Check]:
    """Draw ``slow_and_fast`` into ``folder`` and return the bars."""
    times, weakening, strengthening = _moments(run)
    events = run.events[run.events["kind"] == "event"]
    hours, volume = run.times / HOUR, run.volumes["injected"] / LITRE
    fast = np.array([events["moment"][events["start"] < time].sum() for time in times])
    whole = weakening + strengthening
    figure, axes = sheet(
        "Ten crossing faults under injection slip slowly and fast",
        "H1 to H5 weaken with the rate of slip (orange), G1 to G5 strengthen (blue). Moments per metre of thickness.",
        [["rate", "moment"], ["size", "number"]], (10.0, 7.2),
    )  # fmt: skip
    for name in sorted(set(run.probes) - {"well"}):
        colour = ORANGE if name in WEAKENING else BLUE
        axes["rate"].semilogy(hours, np.abs(run.probe(name)["sliding_rate"]), color=colour, linewidth=0.7)
    axes["rate"].set(
        xlabel="time [h]", ylabel="rate of slip, middle of each fault [m/s]", ylim=(1e-13, 3), xlim=(0, hours[-1])
    )
    injected = np.interp(times, run.times, volume)
    axes["moment"].plot(injected, whole / MILLION, color=INK, label="all slip")
    axes["moment"].plot(injected, fast / MILLION, color=ORANGE, label="in events")
    axes["moment"].plot(injected, (whole - fast) / MILLION, color=BLUE, label="between events")
    axes["moment"].plot(injected, strengthening / MILLION, "--", color=BLUE, label="on G1 to G5, in and between")
    axes["moment"].set(xlabel="volume injected [L]", ylabel="moment [MN m/m]", xlim=(0, injected[-1]))
    axes["moment"].legend(fontsize=8)
    axes["size"].vlines(events["start"] / HOUR, -9.0, events["magnitude"], color=PALE)
    axes["size"].plot(events["start"] / HOUR, events["magnitude"], "o", color=ORANGE)
    for event in events:
        later = events[(events["start"] > event["start"]) & (events["start"] < event["start"] + 0.2 * HOUR)]
        beside = bool((np.abs(later["magnitude"] - event["magnitude"]) < 0.1).any())
        place, side = (event["start"] / HOUR, event["magnitude"]), "right" if beside else "left"
        axes["size"].annotate(
            event["fracture"], place, (-5 if beside else 5, 3), ha=side, textcoords="offset points", fontsize=8
        )
    least, most = events["magnitude"].min() - 0.5, events["magnitude"].max() + 0.2
    axes["size"].set(xlabel="time [h]", ylabel="magnitude", xlim=(0, hours[-1]), ylim=(least, most))
    axes["size"].set_title("Catalogue: where each event began")
    sizes = np.sort(events["magnitude"])
    axes["number"].step(sizes, np.arange(len(sizes), 0, -1), where="pre", marker="o", color=ORANGE)
    axes["number"].set(xlabel="magnitude M", ylabel="events of magnitude M or more", yscale="log")
    counts = np.unique(np.geomspace(1, max(len(sizes), 2), 6).astype(int))
    axes["number"].set_yticks(counts, [str(count) for count in counts])
    axes["number"].set_yticks([], minor=True)
    few = f"{len(sizes)} events: too few for a b-value" if len(sizes) < ENOUGH else f"{len(sizes)} events"
    axes["number"].set_title(f"Gutenberg-Richter, {few}")
    save(figure, folder, "slow_and_fast", COMMAND)
    keys = (
        "start", "end", "length", "mean_slip", "slip", "stress_drop", "moment", "magnitude", "radiated", "dropped", "injected",
    )  # fmt: skip
    write_csv(
        folder, "slow_and_fast",
        {
            "time": times, "injected_litres": injected, "moment": whole, "in_events": fast, "on_G1_to_G5": strengthening,
            **{f"event_{key}": events[key] for key in keys},
        },
        [COMMAND],
    )  # fmt: skip
    return _bars(run, events, whole, fast, strengthening)


def _moments(run: Run) -> tuple[Floats, Floats, Floats]:
    """Times (k,) of the profiles, and the moments (k,) of faults that weaken and of those that strengthen [N m/m]."""
    fields, profiles = load_fractures(run.folder, np.inf), read_profiles(run.folder)
    if fields is None or not profiles:
        raise InputError(f"{run.folder}: has no profiles along fractures; run the scene anew")
    half = 0.5 * np.linalg.norm(np.diff(fields.segments, axis=1)[:, 0], axis=1)
    slip = np.abs(profiles["plastic_slip"])
    lengths: NDArray[np.float64] = np.zeros(slip.shape[1])
    np.add.at(lengths, fields.cells, half[:, None])
    weakens = np.zeros(len(lengths), dtype=bool)
    weakens[fields.cells] = np.isin(np.array(fields.names)[fields.fracture], WEAKENING)[:, None]
    moment = SHEAR * lengths * slip
    return profiles["time"], moment[:, weakens].sum(axis=1), moment[:, ~weakens].sum(axis=1)


def _bars(run: Run, events: NDArray[np.void], whole: Floats, fast: Floats, strengthening: Floats) -> list[Check]:
    residual, friction = run.energy["residual"], run.energy["friction"]
    unclosed = float(np.abs(residual).max() / np.abs(friction).max())
    faults = len({*events["fracture"]})
    slow = float(1.0 - fast[-1] / whole[-1])
    share = float(strengthening[-1] / whole[-1])
    ended = run.status == "ended"
    begun = {*events["fracture"]} <= {*WEAKENING}
    return [
        Check("events in the catalogue", len(events), f">= {EVENTS}", len(events) >= EVENTS),
        Check("faults on which they began", faults, "of H1 to H5", begun),
        Check(
            "largest magnitude",
            float(events["magnitude"].max()),
            "finite",
            bool(np.isfinite(events["magnitude"]).all()),
        ),
        Check("moment between events, of all", slow, "0.05 to 0.95", 0.05 < slow < 0.95),
        Check("moment on faults that strengthen, of all", share, f"> {SHARE:g}", share > SHARE),
        Check("energy not closed, of the friction", unclosed, f"<= {CLOSED:g}", unclosed <= CLOSED),
        Check("hours", run.times[-1] / HOUR, "6, ended", ended and abs(run.times[-1] / HOUR - 6.0) < 1e-6),
    ]
