"""``scripts/figures injection [-o DIR] [--run RUN] [--dynamic RUN]``: run meshes/injection_cycle; draw, print the bars.

Its largest event is run once more, with inertia all along. Runs that are given are read instead.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, judge

from figures_injection.around import compare
from figures_injection.cycle import draw, ran


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures injection", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "injection", metavar="DIR")
    parser.add_argument("--run", type=Path, metavar="RUN", help="a folder that a run of the scene left")
    parser.add_argument("--dynamic", type=Path, metavar="RUN", help="one of the largest event with inertia all along")
    given = parser.parse_args()
    run = ran(given.output, given.run)
    with matplotlib.rc_context(STYLE):
        checks = draw(run, given.output)
    checks += compare(run, given.output, given.dynamic)
    return judge(checks, given.output)


if __name__ == "__main__":
    raise SystemExit(main())
