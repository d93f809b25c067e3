"""``scripts/figures report [-o DIR]``: run the applications, draw the figures, print the bars."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import sys
from pathlib import Path

from sheets import ROOT, Check, judge

from figures_report import fault, finer_fault, oscillator, rupture
from figures_report.common import runner


def draw_all(folder: Path, only: set[str]) -> list[Check]:
    """Draw the named groups, or all, and return their checks."""
    run = runner(folder / "runs")
    groups = {group.__name__.split(".")[-1]: group for group in (oscillator, fault, finer_fault, rupture)}
    checks: list[Check] = []
    if importlib.util.find_spec("figures_report.newton") and (not only or "newton" in only):  # Figs. 9 and 10
        newton = importlib.import_module("figures_report.newton")
        checks += [Check(*check) for check in newton.draw(folder)]
    for name, group in groups.items():
        if not only or name in only:
            checks += group.draw(folder, run)
    return checks


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/figures report", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "report", metavar="DIR")
    parser.add_argument("--only", nargs="+", default=[], metavar="GROUP", help="of the modules")
    given = parser.parse_args()
    checks = draw_all(given.output, set(given.only))
    return judge(sorted(checks, key=lambda check: int(check.name.split()[0].rstrip(":,"))), given.output)


if __name__ == "__main__":
    sys.exit(main())
