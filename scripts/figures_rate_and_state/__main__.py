"""``scripts/figures rate-and-state [-o DIR] [--only NAME ...] [--run RUN] [--without RUN] [--ten-faults RUN] ...``.

Runs meshes/injected_fault with inertia and without ("inertia"), meshes/ten_faults ("ten_faults"), and the two scenes of
meshes/mapped_network ("mapped_network", "slip_weakening"); draws them. Runs that are given are read instead.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, Check, judge

import fracflow
from figures_rate_and_state import inertia, mapped, network
from fracflow.api import Run

FIGURES = ("inertia", "ten_faults", "mapped_network", "slip_weakening")


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures rate-and-state", description=__doc__)
    folder = ROOT / "runs" / "figures" / "rate_and_state"
    parser.add_argument("-o", "--output", type=Path, default=folder, metavar="DIR")
    parser.add_argument("--run", type=Path, metavar="RUN", help="a folder that a run of the scene left")
    parser.add_argument("--without", type=Path, metavar="RUN", help="one without inertia")
    parser.add_argument("--ten-faults", type=Path, metavar="RUN", help="a folder that a run of meshes/ten_faults left")
    parser.add_argument("--mapped-network", type=Path, metavar="RUN", help="one that meshes/mapped_network left")
    parser.add_argument("--slip-weakening", type=Path, metavar="RUN", help="one that its slip_weakening.toml left")
    parser.add_argument("--only", nargs="+", choices=FIGURES, default=FIGURES, metavar="NAME", help="these figures")
    given = parser.parse_args()
    checks: list[Check] = []
    with matplotlib.rc_context(STYLE):
        if "inertia" in given.only:
            moving = _ran(given.run, given.output / "with_inertia", "injected_fault")
            slow = _ran(given.without, given.output / "without", "injected_fault", "stage.injection.kind=quasi-static")
            checks += inertia.draw(moving, slow, given.output)
        if "ten_faults" in given.only:
            checks += network.draw(_ran(given.ten_faults, given.output / "ten_faults", "ten_faults"), given.output)
        if "mapped_network" in given.only:
            found = _ran(given.mapped_network, given.output / "mapped_network", "mapped_network")
            checks += mapped.draw(found, given.output, mapped.BY_RATE)
        if "slip_weakening" in given.only:
            there = given.output / "slip_weakening"
            found = _ran(given.slip_weakening, there, "mapped_network", scene="slip_weakening.toml")
            checks += mapped.draw(found, given.output, mapped.BY_SLIP)
    return judge(checks, given.output)


def _ran(found: Path | None, folder: Path, name: str, *changes: str, scene: str = "scene.toml") -> Run:
    """Run a scene of a folder of meshes/, in ``folder``, unless a run is ``found``."""
    if found is not None:
        return fracflow.open(found)
    path = ROOT / "meshes" / name / scene
    return fracflow.run(fracflow.load(path, ["output.pictures=false", *changes]), folder)


if __name__ == "__main__":
    raise SystemExit(main())
