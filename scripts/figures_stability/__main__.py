"""``scripts/figures stability [-o DIR] [--only S1 ...]``: measure where each method works, draw the maps, print the bars."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, judge

MAPS = sorted(path.stem for path in Path(__file__).parent.glob("s[0-9]*.py"))


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures stability", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "stability", metavar="DIR")
    parser.add_argument("--only", nargs="+", default=MAPS, choices=MAPS, type=str.lower, metavar="MAP", help="S1 ...")
    given = parser.parse_args()
    checks = []
    with matplotlib.rc_context(STYLE):
        for name in given.only:
            checks += importlib.import_module(f"figures_stability.{name}").draw(given.output)
    return judge(checks, given.output)


if __name__ == "__main__":
    raise SystemExit(main())
