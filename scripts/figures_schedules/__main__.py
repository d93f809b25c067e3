"""``scripts/figures schedules [-o DIR] [--only NAME ...] [--read]``: schedules of the wells of 5.5, with table and bars."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, judge

from figures_schedules.front import draw
from figures_schedules.study import SCHEDULES


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures schedules", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "schedules", metavar="DIR")
    names = [schedule.name for schedule in SCHEDULES]
    parser.add_argument("--only", nargs="+", default=names, choices=names, metavar="NAME")
    parser.add_argument("--read", action="store_true", help="draw the runs that are in DIR again")
    given = parser.parse_args()
    with matplotlib.rc_context(STYLE):
        checks = draw(given.output, [schedule for schedule in SCHEDULES if schedule.name in given.only], given.read)
    return judge(checks, given.output)


if __name__ == "__main__":
    raise SystemExit(main())
