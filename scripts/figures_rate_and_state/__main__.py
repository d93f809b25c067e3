"""``scripts/figures rate-and-state [-o DIR] [--run RUN] [--without RUN]``: run meshes/injected_fault with inertia and without.

Runs that are given are read instead.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, judge

import fracflow
from figures_rate_and_state.inertia import draw
from fracflow.api import Run


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures rate-and-state", description=__doc__)
    folder = ROOT / "runs" / "figures" / "rate_and_state"
    parser.add_argument("-o", "--output", type=Path, default=folder, metavar="DIR")
    parser.add_argument("--run", type=Path, metavar="RUN", help="a folder that a run of the scene left")
    parser.add_argument("--without", type=Path, metavar="RUN", help="one without inertia")
    given = parser.parse_args()
    moving = _ran(given.run, given.output / "with_inertia")
    slow = _ran(given.without, given.output / "without", "stage.injection.kind=quasi-static")
    with matplotlib.rc_context(STYLE):
        checks = draw(moving, slow, given.output)
    return judge(checks, given.output)


def _ran(found: Path | None, folder: Path, *changes: str) -> Run:
    """Run the scene, in ``folder``, unless a run is ``found``."""
    if found is not None:
        return fracflow.open(found)
    scene = ROOT / "meshes" / "injected_fault" / "scene.toml"
    return fracflow.run(fracflow.load(scene, ["output.pictures=false", *changes]), folder)


if __name__ == "__main__":
    raise SystemExit(main())
