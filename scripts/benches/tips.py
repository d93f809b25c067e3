"""Errors of fractures that end in meshed rock, with method.tips plain and corrected: tips.py [JOINTS...] [--random SEED...].

A crack of half length 1 slides and opens in a square of 160, against the exact crack in unbounded rock. Five random cracks,
of half lengths .6 to 2, are held against the same in rock that is not meshed. Prints the errors in the middle of each. The rest
is that of cells that grow by --growth, and of the square. Exit code 1 where a third of the largest error is left, or more. The
defaults take half a minute of CPU.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.api import run
from fracflow.scene.scene import Scene

Floats = NDArray[np.float64]
YOUNG, POISSON, PRESSURE = 50e9, 0.25, 6e6
INITIAL = {"xx": -2e6, "yy": -3e6, "zz": -2e6, "xy": 0.5e6}
HALF = 80.0  # of the square
APART = 0.6  # of cracks at random
SIDES = ["west", "east", "south", "north"]
JOINT = {
    "normal_stiffness": 1e15, "shear_stiffness": 50e9, "aperture": 2e-4, "friction_coefficient": 0.5, "pressure": PRESSURE,
}  # fmt: skip


def scene(cracks: Floats, joint: float, growth: float, tips: str | None) -> Scene:
    """Open cracks (n, 2, 2) in a square, or in unmeshed rock if ``tips`` is None."""
    traces = [{"name": f"c{k}", "points": ends.tolist()} for k, ends in enumerate(cracks)]
    geometry: dict[str, Any] = {"domain": "unbounded", "size_at_fractures": joint, "fracture": traces}
    others: dict[str, Any] = {}
    if tips is not None:
        geometry |= {"domain": [-HALF, -HALF, HALF, HALF], "size": HALF / 5.0, "growth": growth}
        others = {"method": {"tips": tips}, "support": [{"on": SIDES}], "model": "full"}
    asked = ["opening", "slip"]
    middles = [(f"c{k}", ends.mean(axis=0).tolist()) for k, ends in enumerate(cracks)]
    return Scene.from_data(
        {
            "geometry": geometry,
            "rock": {"rock": {"youngs_modulus": YOUNG, "poissons_ratio": POISSON}},
            "initial_stress": INITIAL,
            "fluid": {"viscosity": 1e-3},
            "fracture": {"default": JOINT},
            "output": {"pictures": False},
            "probe": [{"name": name, "at": at, "on": name, "quantities": asked} for name, at in middles],
            "stage": [{"kind": "steady", "steps": 1}],
            **others,
        }
    )


def jumps(asked: Scene, folder: Path) -> Floats:
    """Opening and slip (n, 2) in the middle of each crack [length]."""
    found = run(asked, folder)
    names = [probe.name for probe in asked.probe]
    return np.array([[found.probe(name)[each][-1] for each in ("opening", "slip")] for name in names])


def at_random(seed: int) -> Floats:
    """Five cracks (5, 2, 2) of half lengths .6 to 2, no nearer to each other than APART."""
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, 60)[:, None]
    found: list[Floats] = []
    while len(found) < 5:
        middle, half, angle = rng.uniform(-4.0, 4.0, 2), rng.uniform(0.6, 2.0), rng.uniform(0.0, np.pi)
        arm = half * np.array([np.cos(angle), np.sin(angle)])
        new = np.array([middle - arm, middle + arm])
        points = [ends[0] + share * (ends[1] - ends[0]) for ends in (new, *found)]
        if all(np.linalg.norm(points[0][:, None] - other, axis=2).min() > APART for other in points[1:]):
            found.append(new)
    return np.array(found)


def main() -> int:
    """Run all; 1 where too much is left."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("joints", type=float, nargs="*", default=[0.1, 0.05, 0.025])
    parser.add_argument("--random", type=int, nargs="*", default=[1, 2], metavar="SEED")
    parser.add_argument("--growth", type=float, default=0.04)
    given = parser.parse_args()
    one = np.array([[[-1.0, 0.0], [1.0, 0.0]]])
    modulus = YOUNG / (1.0 - POISSON**2)
    cases = [(f"one, joints of {h:g}", one, h, np.array([[4.0 * 3e6, -4.0 * 0.5e6]]) / modulus) for h in given.joints]
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in given.random:
            cracks, joint = at_random(seed), max(given.joints)
            right = jumps(scene(cracks, 0.25 * joint, 0.0, None), Path(folder) / "unmeshed")
            cases.append((f"random {seed}, joints of {joint:g}", cracks, joint, right))
        for name, cracks, joint, right in cases:
            largest = []
            for tips in ("plain", "corrected"):
                found = jumps(scene(cracks, joint, given.growth, tips), Path(folder) / tips)
                off = (np.abs(found) - np.abs(right)) / np.linalg.norm(right, axis=1)[:, None]
                largest.append(float(np.abs(off).max()))
                rows = "; ".join(f"{opening:+.2%} {slip:+.2%}" for opening, slip in off)
                print(f"{name}, {tips}: opening and slip off by, of both, {rows}", flush=True)
            wrong += largest[1] > largest[0] / 3.0
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
