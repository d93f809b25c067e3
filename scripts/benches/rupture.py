"""Spontaneous rupture of meshes/rupture by refinement: rupture.py [SIDES...] [--steppers ...] [--ranks N] [--out DIR].

For each side of the squares along the fault [m] and each stepper: when the slip rate, as the mean of a step, first passes
1 mm/s at five places, slip and moment per metre of depth at 6.6 s, and what the run took. By how much the last refinement
changes the rupture times is the estimate of their error; exit code 1 where it is above 1 %, or where the steppers differ by
more. Implicit steps condense the rock to the fault, and factorise it once. Draws rupture times, slip and slip rates. Runs that
are in the folder already are read, and not repeated.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from _launch import without_ranks

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
from sheets import NODE_COLOURS, STYLE, save, sheet  # noqa: E402
from size import machine  # noqa: E402

SCENE = Path(__file__).parents[2] / "meshes" / "rupture"
SIDES, STEPPERS = (100, 50, 31.25, 20), ("explicit", "newmark")
PLACES = (-12.0, -4.5, 4.5, 7.5, 12.0)
EVERY = 0.5  # [km] between the probes of the curves
RATE = 1e-3  # slip rate that counts as rupture [m/s]
SHEAR_MODULUS = 80.1e9 / 2.5
END, BAR = 6.6, 0.01
FASTEST = 6000.0


@dataclass(frozen=True)
class Rupture:
    """The result of a run: rupture times at the five places [s], slip and moment per metre of depth at the end, its cost."""

    stepper: str
    side: float
    ranks: int
    time_step: float
    times: tuple[float, ...]
    largest_slip: float
    largest_rate: float
    moment: float
    residual: float
    steps: int
    seconds: float
    seconds_of_a_rank: float


def time_step_of(stepper: str, side: float) -> float:
    """A P wave crosses a square in it; an explicit step is somewhat shorter. A whole number of them makes the run."""
    courant = 0.55 if stepper == "explicit" else 1.0
    return END / np.ceil(END / (courant * side / FASTEST))


def write_scene(folder: Path, side: float) -> Path:
    """The scene on squares of that side, with probes along the fault."""
    folder.mkdir(parents=True, exist_ok=True)
    geometry = (SCENE / "fault.geo").read_text(encoding="utf-8")
    (folder / "fault.geo").write_text(geometry.replace("h = 100;", f"h = {side};"), encoding="utf-8")
    text = (SCENE / "scene.toml").read_text(encoding="utf-8")
    kept = "".join(part for part in text.split("[[") if not part.startswith("probe]]") for part in (f"[[{part}",))[2:]
    known = np.arange(-15.0 + EVERY, 15.0, EVERY)
    probes = "".join(
        f'\n[[probe]]\nname = "x{x:g}"\nat = ["{x:g} km", 0]\non = "fault"\nquantities = ["slip"]\n' for x in known
    )
    scene = folder / "scene.toml"
    scene.write_text(kept + probes, encoding="utf-8")
    return scene


def first_passage(times: Any, rates: Any) -> float:
    """When a slip rate first passes 1 mm/s, between two instants; infinite if it does not."""
    above = np.flatnonzero(np.abs(rates) > RATE)
    if not len(above):
        return float("inf")
    n = above[0]
    if n == 0:
        return float(times[0])
    low, high = np.abs(rates[n - 1]), np.abs(rates[n])
    return float(times[n - 1] + (RATE - low) / (high - low) * (times[n] - times[n - 1]))


def measure(stepper: str, side: float, ranks: int, out: Path) -> tuple[Rupture, dict[str, Any]]:
    """Run, unless that is done, and read."""
    import fracflow

    folder, dt = out / f"{stepper}-{side:g}", time_step_of(stepper, side)
    scene = write_scene(folder, side)
    clean = without_ranks()
    command = [
        "mpirun",
        "-n",
        str(ranks),
        sys.executable,
        "-m",
        "fracflow",
        "run",
        str(scene),
        "-o",
        str(folder / "run"),
    ]
    given = {"method.stepper": stepper, "method.events": "at-step-ends", "stage.0.time_step": f"{dt:.17g}"}
    given |= {"output.pictures": "false", "output.checkpoint_seconds": "600"}
    given |= {"method.contact": "lumped"}  # as explicit steps have it; no wall leaves the other
    given |= {"method.coupling": "condensed"} if stepper != "explicit" else {}
    for key, value in given.items():
        command += ["--set", f"{key}={value}"]
    kept = folder / "cost.json"
    if not kept.exists():
        began, spent = time.perf_counter(), os.times()
        subprocess.run(command, check=True, env=clean, stdout=subprocess.DEVNULL)
        seconds, after = time.perf_counter() - began, os.times()
        each = (after.children_user + after.children_system - spent.children_user - spent.children_system) / ranks
        kept.write_text(json.dumps({"ranks": ranks, "seconds": seconds, "each": each}), encoding="utf-8")
    ranks, seconds, each = json.loads(kept.read_text(encoding="utf-8")).values()
    found = fracflow.open(folder / "run")
    history, where = found.history, np.arange(-15.0 + EVERY, 15.0, EVERY)
    slips = {x: np.ravel(history[f"probe/x{x:g}/slip"]) for x in where}
    # as the mean of a step: in explicit ones velocities of locked walls are off by dt^2/4 of their rock's jerk
    middle, rates = 0.5 * (history["time"][1:] + history["time"][:-1]), {}
    for x in where:
        rates[x] = np.diff(slips[x]) / np.diff(history["time"])
    curve = {x: first_passage(middle, rates[x]) for x in where}
    final = np.abs([slips[x][-1] for x in where])
    books = max(np.abs(history[f"energy/{name}"]).max() for name in ("rock_strain", "friction", "kinetic"))
    rupture = Rupture(
        stepper, side, ranks, dt, tuple(curve[x] for x in PLACES), float(final.max()),
        float(max(np.abs(rate).max() for rate in rates.values())), float(SHEAR_MODULUS * final.sum() * EVERY * 1e3),
        float(np.abs(history["energy/residual"]).max() / books), len(history["time"]) - 1, seconds, each,
    )  # fmt: skip
    return rupture, {
        "middle": middle,
        "curve": curve,
        "rates": rates,
        "slip": dict(zip(where, final, strict=True)),
    }


def draw(found: list[tuple[Rupture, dict[str, Any]]], path: Path) -> None:
    """Rupture times and slip along the fault of each run, and slip rates at the five places of the finest ones."""
    names = " and ".join(dict.fromkeys(rupture.stepper for rupture, _ in found))
    sides = ", ".join(f"{side:g} m" for side in dict.fromkeys(rupture.side for rupture, _ in found))
    with matplotlib.rc_context(STYLE):
        figure, axes = sheet(
            "A rupture of 30 km and two more patches",
            "The left one is near its strength and slips before the front comes; the right one, far below it, delays it.",
            [["time", "slip"], ["rate", "rate"]], (8.8, 6.2), height_ratios=[1.0, 1.15],
        )  # fmt: skip
        looks = ("-", (0, (4, 2)), (0, (1, 1.5)), "-.")
        for (rupture, data), colour, look in zip(found, NODE_COLOURS, looks * len(found), strict=False):
            label = f"{rupture.stepper}, {rupture.side:g} m"
            for name, curve in (("time", data["curve"]), ("slip", data["slip"])):
                axes[name].plot(list(curve), list(curve.values()), ls=look, color=colour, label=label)
        axes["time"].set(title="when the front comes", xlabel="along the fault [km]", ylabel="time [s]")
        axes["slip"].set(
            title=f"slip after {END} s", xlabel="along the fault [km]", ylabel="slip [m]", ylim=(0.0, None)
        )
        axes["time"].legend(loc="upper center")
        least = min(rupture.side for rupture, _ in found)
        for (rupture, data), look in zip(found, looks * len(found), strict=False):
            for x, colour in zip(PLACES, NODE_COLOURS, strict=False) if rupture.side == least else ():
                first = rupture.stepper == found[0][0].stepper
                label, look = (f"{x:g} km".replace("-", "\u2212"), "-") if first else ("", look)
                rate = np.abs(data["rates"][x])
                axes["rate"].plot(data["middle"], rate, ls=look, color=colour, lw=1.0, label=label)
        axes["rate"].legend(loc="upper left", bbox_to_anchor=(0.0, 1.0))
        axes["rate"].set(title=f"slip rate at five places, {least:g} m", xlabel="time [s]", ylabel="slip rate [m/s]")
        axes["rate"].set(xlim=(0.0, END), ylim=(0.0, None))
        save(
            figure, path.parent, path.stem, f"{names} steps; squares of {sides} along the fault. scripts/bench rupture"
        )


def main() -> None:
    """Measure, print, write rupture.csv and rupture.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sides", nargs="*", type=float, default=SIDES, help="of the squares [m], falling")
    parser.add_argument("--steppers", nargs="+", choices=STEPPERS, default=STEPPERS)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/bench/rupture"), help="folder of what is written")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    found, wrong = [], False
    names = [f"t({x:g} km) [s]" for x in PLACES]
    print(
        "stepper, side [m], dt [ms], "
        + ", ".join(names)
        + ", slip [m], slip rate [m/s], moment/m [N], books, steps, s,"
        " CPU s a rank"
    )
    for stepper in given.steppers:
        before: Rupture | None = None
        for side in sorted(given.sides, reverse=True):
            rupture, data = measure(stepper, side, given.ranks, given.out)
            found.append((rupture, data))
            row = [f"{time:.4f}" for time in rupture.times]
            print(
                f"{stepper}, {side:g}, {1e3 * rupture.time_step:.3g}, {', '.join(row)}, {rupture.largest_slip:.4g},"
                f" {rupture.largest_rate:.4g}, {rupture.moment:.5g}, {rupture.residual:.1e}, {rupture.steps},"
                f" {rupture.seconds:.0f}, {rupture.seconds_of_a_rank:.0f}", flush=True,
            )  # fmt: skip
            change = np.inf if before is None else differ(rupture, before)
            before = rupture
        print(f"{stepper}: the last refinement changes rupture times by {100 * change:.2g} % at most, allowed 1 %")
        wrong |= not change <= BAR
    finest = [rupture for rupture, _ in found if rupture.side == min(given.sides)]
    if len(finest) > 1:
        apart = differ(finest[0], finest[1])
        print(f"{finest[0].stepper} and {finest[1].stepper} differ by {100 * apart:.2g} % at most, allowed 1 %")
        wrong |= not apart <= BAR
    with (given.out / "rupture.csv").open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {json.dumps(machine())}\n")
        table = csv.DictWriter(file, asdict(found[0][0]))
        table.writeheader()
        table.writerows(asdict(rupture) for rupture, _ in found)
    draw(found, given.out / "rupture.png")
    print(f"{given.out / 'rupture.csv'}, {given.out / 'rupture.png'}")
    sys.exit(int(wrong))


def differ(one: Rupture, other: Rupture) -> float:
    """Largest relative difference of two runs' rupture times."""
    times, before = np.array(one.times), np.array(other.times)
    return float(np.max(np.abs(times - before) / times))


if __name__ == "__main__":
    main()
