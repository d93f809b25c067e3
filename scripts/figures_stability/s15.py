"""S15: what absorbing sides send back of plane P and S waves, by their angle: energy, measured beside that of theory.

A pulse enters through three sides, and meets the fourth, which only absorbs. What its dashpots take at a place there, rho c_p
v_n^2 + rho c_s v_t^2 over time, is what they do not send back. Theory: the balance of tractions of Lysmer and Kuhlemeyer
(1969). Dotted: 0.75 of the dashpots along the side, which sends back the least of both waves over all directions.

S is not shown beyond 45 degrees, where runs depend on the box: at 60 degrees one twice as wide has 7.3 % for 6.6 %, theory
11.3 %; at 52.5 degrees 3.1 for 5.0 %, theory 6.0 %. P waves from the corners outrun such waves there, which may be why.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, INK, ORANGE, Check, Floats, save, sheet, write_csv

from fracflow.elements.dashpot import energy_over_directions, energy_returned
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

FAST, DENSITY, POISSON, PULSE, SPEED = 5000.0, 2700.0, 0.25, 1e-3, 0.01
SLOW = FAST / np.sqrt(3.0)
WIDTH, HEIGHT = 9.0, 36.0
LEVEL = 27.0  # of the probe on the side
LESS = (1.0, 0.75)  # of the dashpots across and along the side
KINDS = {"p": (FAST, BLUE, "o"), "s": (SLOW, ORANGE, "s")}
TIMES = np.linspace(0.0, PULSE, 41)
SCENE = f"""
output = {{pictures = false}}
method.stepper = "explicit"
rock.rock = {{youngs_modulus = 56.25e9, poissons_ratio = {POISSON}, density = {DENSITY}}}
geometry = {{domain = [0, 0, {WIDTH}, {HEIGHT}], size = 0.25, cells = "quads"}}
probe = [{{name = "side", at = [{WIDTH}, {LEVEL}], quantities = ["velocity"]}}]
absorbing = [{{on = ["west", "south", "north"], wave = WAVE}}, {{on = "east"}}]
stage = [{{kind = "dynamic", time_step = 2.5e-5, end = END}}]
"""


def sent_back(kind: str, degrees: float) -> float:
    """Share of a wave's energy that does not stay in the dashpots of the side, by a run."""
    speed, angle = KINDS[kind][0], np.radians(degrees)
    way = np.array([np.cos(angle), np.sin(angle)])
    wave = np.stack([TIMES, SPEED * np.sin(np.pi * TIMES / PULSE) ** 2], axis=1)
    given = f'{{kind = "{kind}", direction = {way.tolist()}, velocity = {wave.tolist()}}}'
    arrives = way @ np.array([WIDTH, LEVEL]) / speed
    end = 2.5e-5 * np.ceil((arrives + 1.3 * PULSE) / 2.5e-5)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "scene.toml"
        path.write_text(SCENE.replace("WAVE", given).replace("END", repr(float(end))), encoding="utf-8")
        run(load(path), Path(name) / "run")
        history = read_history(Path(name) / "run" / "history.h5")
    velocity, time = history["probe/side/velocity"], history["time"]
    power = FAST * velocity[:, 0] ** 2 + SLOW * velocity[:, 1] ** 2
    taken = 0.5 * (power[1:] + power[:-1]) @ np.diff(time)
    brought = speed * np.cos(angle) * SPEED**2 * PULSE * 3.0 / 8.0
    return float(1.0 - taken / brought)


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s15`` into ``folder`` and return the bars."""
    angles: dict[str, tuple[float, ...]] = {"p": (60.0,), "s": (30.0,)}
    if not small:
        angles = {"p": (5.0, 15.0, 30.0, 45.0, 52.5, 60.0), "s": (5.0, 15.0, 25.0, 30.0, 45.0)}
    rows = [(kind, angle, sent_back(kind, angle)) for kind in "ps" for angle in angles[kind]]
    theory = np.array([energy_returned(POISSON, angle, kind) for kind, angle, _ in rows])
    found = np.array([share for *_, share in rows])
    figure, axes = sheet(
        "S15  What absorbing sides send back",
        "Energy of plane waves at a side with dashpots $\\rho c_p$ across and $\\rho c_s$ along it, Poisson's ratio 1/4.",
        [["p", "s"]], (9.0, 3.9),
    )  # fmt: skip
    for kind, (_, colour, mark) in KINDS.items():
        at = np.array([each == kind for each, *_ in rows])
        _panel(axes[kind], kind, colour)
        measured = np.array([angle for _, angle, _ in rows])[at], 100 * found[at]
        axes[kind].plot(*measured, mark, color=colour, ms=5, label="runs")
        axes[kind].legend(loc="upper left", framealpha=1.0)
    both = [sum(energy_over_directions(POISSON, kind, share) for kind in "ps") for share in (1.0, LESS)]
    note = f"P and S over all directions: {both[0]:.1%}; with 0.75 along the side {both[1]:.1%}. S is run up to 45 degrees."
    save(figure, folder, "s15", note)
    columns = {
        "is_s": np.array([float(kind == "s") for kind, *_ in rows]),
        "angle_degrees": np.array([angle for _, angle, _ in rows]),
        "energy_back_by_theory": theory,
        "energy_back_in_runs": found,
    }
    write_csv(folder, "s15", columns, ["scripts/figures stability --only S15"])
    off = {
        kind: max(abs(f - t) for (k, *_), f, t in zip(rows, found, theory, strict=True) if k == kind) for kind in "ps"
    }
    return [
        Check("S15 energy of P that is back, off that of theory", off["p"], "<= 0.005", off["p"] <= 0.005),
        Check("S15 energy of S that is back, off that of theory", off["s"], "<= 0.01", off["s"] <= 0.01),
    ]


def _panel(axis: Axes, kind: str, colour: str) -> None:
    """The curves of theory of one kind of wave."""
    degrees = np.linspace(0.0, 85.0, 341)

    def back(share: float | tuple[float, float]) -> Floats:
        return 100.0 * np.array([energy_returned(POISSON, float(angle), kind, share) for angle in degrees], dtype=float)

    axis.plot(degrees, back(1.0), "-", color=colour, label="theory")
    axis.plot(degrees, back(LESS), ":", color=INK, lw=1.0, label="theory, 0.75 along the side")
    axis.set(xlabel="angle between wave and normal [degrees]", ylabel="energy sent back [%]", ylim=(0.0, 40.0))
    axis.set(xlim=(0.0, 85.0), title=f"{kind.upper()} waves")
