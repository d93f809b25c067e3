"""``scripts/figures time [-o DIR] [--only events fault]``: refine time steps, draw the errors, print the bars."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, judge

FIGURES = ("events", "fault")


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures time", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "time", metavar="DIR")
    parser.add_argument("--only", nargs="+", default=FIGURES, choices=FIGURES, type=str.lower, metavar="FIGURE")
    given = parser.parse_args()
    checks = []
    with matplotlib.rc_context(STYLE):
        for name in given.only:
            checks += importlib.import_module(f"figures_time.{name}").draw(given.output)
    return judge(checks, given.output)


if __name__ == "__main__":
    raise SystemExit(main())
