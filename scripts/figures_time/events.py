"""The block of 5.2 pushed until its strength drops: error against the time step, with events located and without."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from sheets import BLUE, INK, ORANGE, ROOT, Check, Floats, save, sheet, write_csv

from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

STRENGTH = 2.0
STEPS = (0.4, 0.2, 0.1, 0.05, 0.025)
LOCATED = 1.9  # least order with events located


@dataclass(frozen=True)
class Push:
    """A force on the block from rest, with its kinks, and what is left of the strength when it slides."""

    name: str
    force: Callable[[float], float]
    kinks: tuple[float, ...]
    end: float
    ratio: float


def half_sine(ratio: float, end: float) -> Push:
    """2.64 at most, for 3.4 s."""
    name = f"half sine of 2.64 for 3.4 s, {ratio:g}"
    return Push(name, lambda t: 2.64 * np.sin(np.pi * t / 3.4) if t < 3.4 else 0.0, (3.4,), end, ratio)


def harmonic(ratio: float, end: float) -> Push:
    """1.2 sin 0.8 t."""
    return Push(f"1.2 sin 0.8 t, {ratio:g}", lambda t: 1.2 * np.sin(0.8 * t), (), end, ratio)


PUSHES = (half_sine(0.8, 20.0), harmonic(0.9, 60.0))


def exact(samples: Floats, push: Push) -> Floats:
    """Displacement of u'' + F = P, F = u - u_p with |F| <= 2, less while it slides: DOP853 from event to event."""
    t, state, offset, way = 0.0, [0.0, 0.0], 0.0, 0.0
    out = np.zeros_like(samples)
    while t < push.end - 1e-12:
        stop = min([kink for kink in push.kinks if kink > t + 1e-12], default=push.end)

        def force(u: float, way: float = way, offset: float = offset) -> float:
            return way * push.ratio * STRENGTH if way else u - offset

        def event(_: float, y: Floats, way: float = way, offset: float = offset) -> float:
            return float(y[1] if way else abs(y[0] - offset) - STRENGTH)

        event.terminal, event.direction = True, -way if way else 1.0  # type: ignore[attr-defined]
        piece = solve_ivp(
            lambda t, y, f=force: [y[1], push.force(t) - f(y[0])], (t, stop), state,
            method="DOP853", rtol=1e-12, atol=1e-13, events=event, dense_output=True, max_step=0.05,
        )  # fmt: skip
        here = (samples >= t) & (samples <= piece.t[-1])
        if here.any():
            out[here] = piece.sol(samples[here])[0]
        t, state = piece.t[-1], list(piece.y[:, -1])
        if piece.status == 1 and way:
            offset, state[1], way = state[0] - way * push.ratio * STRENGTH, 0.0, 0.0
        elif piece.status == 1:
            way = float(np.sign(state[0] - offset))
    return out


def error(push: Push, step: float, events: str, folder: Path) -> float:
    """Largest error of the displacement over its largest value."""
    times = np.linspace(0.0, push.end, round(push.end / STEPS[-1]) + 1)
    table = [[float(t), float(push.force(t))] for t in times]
    given = [f"load.0.traction=[{table}, 0]", f"stage.0.time_step={step}", f"stage.0.end={push.end}"]
    given += [f"fracture.default.stick_slip_ratio={push.ratio}", f"method.events={events}", "output.pictures=false"]
    run(load(ROOT / "meshes" / "report_5_2" / "scene.toml", given), folder)
    history = read_history(folder / "history.h5")
    right = exact(history["time"], push)
    return float(np.abs(history["probe/block/displacement"][:, 0] - right).max() / np.abs(right).max())


def order(steps: tuple[float, ...], errors: Floats) -> float:
    """Slope of the errors over the steps."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def draw(folder: Path) -> list[Check]:
    """Measure, draw ``events`` into ``folder`` and return the bars."""
    found: dict[tuple[str, str], Floats] = {}
    with tempfile.TemporaryDirectory() as work:
        for push in PUSHES:
            for events in ("located", "at-step-ends"):
                runs = [error(push, step, events, Path(work) / events) for step in STEPS]
                found[push.name, events] = np.array(runs)
    figure, axes = sheet(
        "Events inside steps",
        "The block of 5.2; error of its displacement against the time step.",
        [["error"]],
        (6.0, 4.6),
    )
    axis, checks = axes["error"], []
    for (name, events), values in found.items():
        colour, mark = (BLUE, "o") if events == "located" else (ORANGE, "s")
        line = "-" if name == PUSHES[0].name else "--"
        slope = order(STEPS, values)
        axis.loglog(STEPS, values, line, marker=mark, color=colour, label=f"{name}: {events}, order {slope:.2f}")
        if events == "located":
            checks.append(Check(f"{name}: order with located events", slope, f">= {LOCATED}", slope >= LOCATED))
        else:
            ratio = float(values[-1] / found[name, "located"][-1])
            checks.append(Check(f"{name}: at step ends over located, last step", ratio, "> 1", ratio > 1.0))
    axis.loglog(STEPS, 0.3 * np.array(STEPS) ** 2, ":", color=INK, lw=0.8, label="slope 2")
    axis.set(xlabel="time step", ylabel="largest error over largest displacement")
    axis.legend(fontsize=7)
    save(figure, folder, "events", "Reference: DOP853 from event to event, tolerance 1e-12.")
    columns = {"step": np.array(STEPS)} | {f"{name}: {events}": values for (name, events), values in found.items()}
    write_csv(folder, "events", columns, ["scripts/figures time --only events"])
    return checks
