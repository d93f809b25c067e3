"""Random tight joints under jumps of pressure, up to lift-off and back: each scene ends right, or ends named.

Tight are joints that hardly close further: k_n0 d_0 from 1e-3 to 10 times the load on them. COUNT and FIRST SEED may follow.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.step import Step
from fracflow.errors import InputError, Interrupted, SolveError
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

SLOWEST = 3  # scenes named with their cost
LEVELS, STEPS = 5, 3  # levels of pressure, and steps at each of them
START = 0.5e6  # [Pa]
BALANCED = BOOKS = 1e-10
NAMES = ("fault", "block ", "well")
MOST_NAMED = 0.01


@dataclass(frozen=True)
class End:
    """How a scene ended: "right", "named", or what is wrong; why; steps, Newton iterations, halvings, CPU s.

    closure, lift  the scene's k_n0 d_0 over the load, and its largest pressure over the pressure that lifts the joints
    """

    seed: int
    closure: float
    lift: float
    what: str
    why: str
    steps: int = 0
    newton: int = 0
    halved: int = 0
    seconds: float = 0.0


def scene(seed: int) -> tuple[dict[str, Any], float, float]:
    """A square of 10 m with 1 to 4 fractures, which may cross, and a well whose pressure or rate jumps from level to level.

    With it the two numbers of ``End``.
    """
    draw = np.random.default_rng(seed)
    count = int(draw.integers(1, 5))
    middle, angle, half = draw.uniform(3, 7, (count, 2)), draw.uniform(0, np.pi, count), draw.uniform(1.5, 5.0, count)
    along = half[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.clip(np.stack([middle - along, middle + along], axis=1), 0.0, 10.0).round(3)
    traces = [{"name": f"fault{i}", "points": points.tolist()} for i, points in enumerate(ends)]
    press, lean = float(draw.uniform(2e6, 12e6)), float(draw.uniform(0.75, 1.0))
    load, modulus = press * lean, float(10.0 ** draw.uniform(9.7, 10.7))
    closure, aperture = float(10.0 ** draw.uniform(-3, 1)), float(10.0 ** draw.uniform(-5.5, -4))
    stiffness = closure * load / aperture
    lift = float(draw.uniform(0.5, 1.25))
    levels = START + load * lift * draw.permutation(np.append(draw.uniform(0.0, 1.0, LEVELS - 1), 1.0))
    # a front enters a joint of 0.6 m in about this time, from walls as wide as the largest pressure holds them
    wide = aperture + min(lift, 1.0) * load / (stiffness + 0.5 * modulus)
    enters = 12e-3 * 0.36 / (2.0 * aperture**2 * wide * (stiffness + 0.5 * modulus))
    time_step = float(enters * 10.0 ** draw.uniform(-1, 1.5))
    rises = np.repeat(levels, 2)
    begins = STEPS * time_step * np.arange(LEVELS)
    at = np.ravel(np.stack([begins + 1e-3 * time_step, begins + STEPS * time_step], axis=1))
    table = [[0.0, START], *([float(t), float(p)] for t, p in zip(at, rises, strict=True))]
    well: dict[str, Any] = {"name": "in", "at": middle_of(ends[0]), "pressure": table}
    if seed % 5 == 0:
        per = wide**3 / 12e-3  # flow by a gradient of 1
        del well["pressure"]
        well["flow_rate"] = [[t, float((p - START) * per)] for t, p in table]
    wells = [well]
    if seed % 3:
        # by coordinates: a fracture that near ones have split may have two ends
        wells.append({"name": "out", "at": ends[-1, 1].tolist(), "pressure": "initial"})
    data = {
        "title": f"random tight joints {seed}",
        "output": {"pictures": False},
        "rock": {"rock": {"youngs_modulus": modulus, "poissons_ratio": 0.25, "density": 2600}},
        "initial_stress": {"xx": -press * lean - START, "yy": -press - START, "zz": -press - START},
        "fluid": {
            "viscosity": 1e-3,
            "specific_weight": 9810,
            "initial_pressure": START,
            "compressibility": 4.4e-10 if seed % 2 else 0.0,
        },
        "geometry": {"domain": [0, 0, 10, 10], "size": 1.5, "size_at_fractures": 0.6, "fracture": traces},
        "fracture": {
            "default": {
                "normal_stiffness": stiffness,
                "shear_stiffness": stiffness * float(draw.uniform(0.3, 1.0)),
                "aperture": aperture,
                "friction_coefficient": float(np.tan(np.radians(draw.uniform(15, 40)))),
            }
        },
        "support": [{"on": ["west", "east", "south", "north"]}],
        "well": wells,
        "probe": [{"name": "in", "at": middle_of(ends[0]), "on": "fault0"}],
        "stage": [{"kind": "quasi-static", "time_step": time_step, "steps": LEVELS * STEPS}],
    }
    return data, closure, lift


def middle_of(ends: np.ndarray) -> list[float]:
    """Middle of a trace (2, 2)."""
    return ends.mean(axis=0).tolist()


def end_of(seed: int, folder: Path) -> End:
    """Run a scene and judge its end."""
    data, closure, lift = scene(seed)
    crushed = 0.0

    def watch(step: Step) -> None:
        nonlocal crushed
        crushed = max(crushed, float(np.isinf(step.state.sections.traction).sum()))

    what, why = "right", ""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            run(Scene.from_data(data, folder / "scene.toml"), folder / "run", MPI.COMM_SELF, watch)
        except (SolveError, InputError) as error:
            why = str(error)
            what = "named" if any(name in why for name in NAMES) else "NOT NAMED"
            if isinstance(error, InputError):  # no run: there is nothing to read
                return End(seed, closure, lift, f"{what} (input)", why)
        except Interrupted:  # by a signal: the bench ends
            raise
        except Exception as error:  # what must not happen is counted too
            return End(seed, closure, lift, "CRASHED", f"{type(error).__name__}: {error}")
    history = read_history(folder / "run" / "history.h5")
    largest = max(np.abs(values).max() for key, values in history.items() if key.startswith("energy/"))
    worst = max(history[f"step/{part}_residual"].max() for part in ("solid", "flow"))
    left = np.abs(history["energy/residual"]).max() / max(largest, 1e-300)
    if crushed or not np.isfinite(left) or left > BOOKS or worst > BALANCED:
        what, why = "WRONG", f"books {left:.1e}, balance {worst:.1e}, {crushed:g} sections past -d0; {why}"
    if warned:
        what, why = "WARNED", f"{warned[0].message} ({warned[0].filename}:{warned[0].lineno}); {why}"
    halved = (folder / "run" / "log.txt").read_text().count("step halved")
    return End(seed, closure, lift, what, why, len(history["time"]) - 1, int(history["step/newton"].sum()), halved)


def ends(count: int, first: int = 0) -> Iterator[End]:
    """The ends of ``count`` scenes, one after another; their folders go."""
    for seed in range(first, first + count):
        began = time.process_time()
        with tempfile.TemporaryDirectory() as name:
            end = end_of(seed, Path(name))
        yield replace(end, seconds=time.process_time() - began)


def main() -> int:
    """Print the share of each end; exit code 1 if one is neither right nor named, or too many are named."""
    count, first = (*map(int, sys.argv[1:]), *(500, 0)[len(sys.argv) - 1 :])
    began, found = time.process_time(), []
    for end in ends(count, first):
        found.append(end)
        if end.what != "right":
            where = f"{end.seed} k_n0 d_0 = {end.closure:.1e} load, lift {end.lift:.2f}"
            print(f"{where}: {end.what} after {end.steps} steps: {end.why[:300]}", flush=True)
    for what, number in sorted(Counter(end.what for end in found).items()):
        print(f"{what:20s} {number:4d} of {count}, {100 * number / count:.1f} %")
    newton, halved = sum(end.newton for end in found), sum(end.halved for end in found)
    print(f"{newton} iterations, {halved} halvings, {time.process_time() - began:.0f} CPU s")
    for end in sorted(found, key=lambda end: -end.seconds)[:SLOWEST]:
        work = f"{end.steps} steps, {end.newton} iterations, {end.halved} halvings"
        print(
            f"slowest: {end.seed} k_n0 d_0 = {end.closure:.1e} load, lift {end.lift:.2f}: {end.seconds:.1f} CPU s, {work}"
        )
    named = sum(end.what.startswith("named") for end in found)
    wrong = sum(end.what != "right" for end in found) - named
    return int(wrong > 0 or named > MOST_NAMED * count)


if __name__ == "__main__":
    raise SystemExit(main())
