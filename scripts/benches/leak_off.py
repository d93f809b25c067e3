"""Leak-off: CPU of a run with it over that of the same run without. Exit code 1 above 1.1.

A well at constant pressure in the middle of a fracture of 100 m in rock that is not meshed, 100 steps in which the pressure
spreads, taken in turns.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import median
from time import process_time

from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

ALLOWED = 1.1
SCENE = """
output = {pictures = false}
rock.rock = {youngs_modulus = 5e10, poissons_ratio = 0.25, density = 2700}
initial_stress = {xx = -30e6, yy = -30e6, zz = -30e6}
fluid = {viscosity = 1e-3, initial_pressure = 5e6, compressibility = 4.5e-10}
well = [{name = "in", at = {fracture = "f", fraction = 0.5}, pressure = 6e6}]
geometry = {domain = "unbounded", size = 1, fracture = [{name = "f", points = [[0, 0], [100, 0]]}]}
stage = [{kind = "quasi-static", time_step = 0.2, steps = 100}]
[fracture.f]
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = 1e-4
friction_coefficient = 0.6
"""
LEAKS = "leak_off = {permeability = 1e-15, storage = 1e-10}\n"


def clocked(text: str) -> tuple[float, int]:
    """CPU seconds of a run, and its Newton iterations."""
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "scene.toml").write_text(text, encoding="utf-8")
        scene, began = load(Path(name) / "scene.toml"), process_time()
        run(scene, Path(name) / "run")
        seconds = process_time() - began
        return seconds, int(read_history(Path(name) / "run" / "history.h5")["step/newton"].sum())


def main() -> int:
    """Exit code 1 where leak-off takes more than allowed."""
    parser = argparse.ArgumentParser(prog="scripts/bench leak_off", description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="runs whose median counts (3)")
    given = parser.parse_args()
    clocked(SCENE)
    pairs = [(clocked(SCENE), clocked(SCENE + LEAKS)) for _ in range(given.repeats)]
    without, leaking = (median(pair[side][0] for pair in pairs) for side in (0, 1))
    iterations = pairs[0][0][1], pairs[0][1][1]
    print(
        f"without {without:.2f} s, with leak-off {leaking:.2f} s: {leaking / without:.3f}; Newton iterations {iterations}"
    )
    return int(leaking > ALLOWED * without)


if __name__ == "__main__":
    raise SystemExit(main())
