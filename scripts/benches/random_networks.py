"""Random networks with apertures over four decades under injection: each ends right, or ends named.

COUNT and FIRST SEED may follow.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.step import Step
from fracflow.errors import InputError, SolveError
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

KINDS = ("quasi-static", "dynamic")
STEPS = 5
START = 1e4  # [Pa]; of a large pressure everywhere only the differences drive, and they lose its digits
BALANCED, BOOKS = 1e-10, 1e-10
ROUND_OFF = (
    2.2e-16  # of the flow that the full pressure would drive through the widest element, beside one 1e-12 as wide
)
NAMES = ("fault", "block ", "well")


@dataclass(frozen=True)
class End:
    """How a network ended: "right", "named", or what is wrong; and why."""

    seed: int
    kind: str
    what: str
    why: str
    steps: int
    halved: int


def scene(seed: int) -> dict[str, Any]:
    """A square of 10 m with 3 to 7 fractures, apertures 1e-5 to 0.1 m at random, fluid pumped into one of them.

    Every fifth network is pumped without an outlet. The others are driven by a pressure or by a rate, up to 20 MPa
    above the start: some slip, some open.
    """
    draw = np.random.default_rng(seed)
    count = int(draw.integers(3, 8))
    middle, angle, half = draw.uniform(2, 8, (count, 2)), draw.uniform(0, np.pi, count), draw.uniform(1.0, 4.0, count)
    along = half[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.clip(np.stack([middle - along, middle + along], axis=1), 0.0, 10.0).round(3)
    apertures = 10.0 ** draw.uniform(-5, -1, count)
    press, lean = draw.uniform(5e6, 20e6), draw.uniform(0.7, 1.0)
    traces = [{"name": f"fault{i}", "points": points.tolist()} for i, points in enumerate(ends)]
    fractures: dict[str, Any] = {
        "default": {
            "normal_stiffness": float(10.0 ** draw.uniform(9, 11)),
            "shear_stiffness": float(10.0 ** draw.uniform(9, 11)),
            "aperture": 1e-3,
            "friction_coefficient": float(draw.uniform(0.5, 0.9)),
            "stick_slip_ratio": float(draw.choice([1.0, 0.95])),
        }
    }
    fractures |= {f"fault{i}": {"aperture": float(value)} for i, value in enumerate(apertures)}
    kind = KINDS[seed % 2]
    time_step = 0.5 if kind == "quasi-static" else 1e-3
    # what is pumped would raise the pressure of a lone fracture by this much
    rise, compliance = (
        float(10.0 ** draw.uniform(5.5, 7.3)),
        1.0 / fractures["default"]["normal_stiffness"] + half[0] / 15e9,
    )
    well: dict[str, Any] = {"name": "in", "at": {"fracture": "fault0", "end": "start"}}
    if seed % 5 and seed % 3:
        well["pressure"] = [[0, START], [STEPS * time_step, START + rise]]
    else:
        well["flow_rate"] = [[0, 0], [time_step, float(rise * compliance * 2.0 * half[0] / (STEPS * time_step))]]
    wells = [well]
    if seed % 5:
        wells.append({"name": "out", "at": {"fracture": f"fault{count - 1}", "end": "end"}, "pressure": "initial"})
    return {
        "title": f"random network {seed}",
        "output": {"pictures": False},
        "rock": {"rock": {"youngs_modulus": 30e9, "poissons_ratio": 0.25, "density": 2600}},
        "initial_stress": {"xx": -press * lean, "yy": -press, "zz": -press * lean},
        "fluid": {"viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": START},
        "geometry": {"domain": [0, 0, 10, 10], "size": 1.2, "size_at_fractures": 0.6, "fracture": traces},
        "fracture": fractures,
        "support": [{"on": ["west", "east", "south", "north"]}],
        "well": wells,
        "probe": [{"name": "in", "at": {"fracture": "fault0", "end": "start"}}],
        "stage": [{"kind": kind, "time_step": time_step, "steps": STEPS}],
    }


def end_of(seed: int, folder: Path) -> End:
    """Run a network and judge its end."""
    data = scene(seed)
    kind, crushed = data["stage"][0]["kind"], 0.0

    def watch(step: Step) -> None:
        nonlocal crushed
        crushed = max(crushed, float(np.isinf(step.state.sections.traction).sum()))

    what, why = "right", ""
    try:
        run(Scene.from_data(data, folder / "scene.toml"), folder / "run", MPI.COMM_SELF, watch)
    except (SolveError, InputError) as error:
        why = str(error)
        named = any(name in why for name in NAMES)
        what = "named" if named else "NOT NAMED"
        if isinstance(error, InputError):  # no run: there is nothing to read
            return End(seed, kind, f"{what} (input)", why, 0, 0)
    except Exception as error:  # what must not happen is counted too
        return End(seed, kind, "CRASHED", f"{type(error).__name__}: {error}", 0, 0)
    history = read_history(folder / "run" / "history.h5")
    largest = max(np.abs(values).max() for key, values in history.items() if key.startswith("energy/"))
    worst = max(history[f"step/{part}_residual"].max() for part in ("solid", "flow"))
    widest = max(float(table["aperture"]) for table in data["fracture"].values())
    pressure = max(np.abs(history[key]).max() for key in history if key.endswith("/pressure"))
    known = ROUND_OFF * widest**3 / (12e-3 * 0.6) * pressure**2 * history["time"][-1]
    left = max(np.abs(history["energy/residual"]).max() - known, 0.0) / max(largest, 1e-300)
    if crushed or not np.isfinite(left) or left > BOOKS or worst > BALANCED:
        what, why = "WRONG", f"books {left:.1e}, balance {worst:.1e}, {crushed:g} sections past -d0; {why}"
    halved = (folder / "run" / "log.txt").read_text().count("step halved")
    return End(seed, kind, what, why, len(history["time"]) - 1, halved)


def ends(count: int, first: int = 0) -> Iterator[End]:
    """The ends of ``count`` networks, one after another; their folders go."""
    for seed in range(first, first + count):
        with tempfile.TemporaryDirectory() as name:
            yield end_of(seed, Path(name))


def main() -> int:
    """Print the share of each end; exit code 1 if one is neither right nor named."""
    count, first = (*map(int, sys.argv[1:]), *(200, 0)[len(sys.argv) - 1 :])
    began, found = time.perf_counter(), []
    for end in ends(count, first):
        found.append(end)
        if end.what != "right":
            print(f"{end.seed} {end.kind}: {end.what} after {end.steps} steps: {end.why[:400]}", flush=True)
    for (kind, what), number in sorted(Counter((end.kind, end.what) for end in found).items()):
        print(f"{kind:13s} {what:20s} {number:4d} of {count}, {100 * number / count:.1f} %")
    print(f"{sum(end.halved for end in found)} halvings, {time.perf_counter() - began:.0f} s")
    return int(any(end.what not in ("right", "named", "named (input)") for end in found))


if __name__ == "__main__":
    raise SystemExit(main())
