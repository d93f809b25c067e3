"""``scripts/figures injection [-o DIR] [--run RUN]``: run meshes/injection_cycle, or read a run of it; draw, print the bars."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, judge

from figures_injection.cycle import draw


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures injection", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "injection", metavar="DIR")
    parser.add_argument("--run", type=Path, metavar="RUN", help="a folder that a run of the scene left")
    given = parser.parse_args()
    with matplotlib.rc_context(STYLE):
        checks = draw(given.output, given.run)
    return judge(checks, given.output)


if __name__ == "__main__":
    raise SystemExit(main())
