"""CPU of ``meshes/injection_cycle`` up to the end of its first event, beside that of an older checkout, in turns.

    scripts/bench cycle [--against DIR] [--repeats N]

DIR is a checkout of the older commit, e13dd07 in README.md, which had nothing to compile: ``git worktree add DIR COMMIT``. In a
later one ``python -c "from setuptools import setup; setup()" build_ext --inplace`` makes its loops. Whole commands are timed,
start-up and meshing included. Catalogues are compared in two more runs, to a residual of 1e-13 and with the mean of apertures
that both commits know: what a front of opening lets through came later, and adds 4e-5 to the moment; round-off of 1e-15 in a
modulus changes it by 1e-5 where a residual of 1e-11 will do.
Exit 1 where the median of the ratios is above a third, or where events are others.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from _launch import without_ranks

ROOT = Path(__file__).parents[2]
END, ALLOWED = "5.168 d", 1.0 / 3.0
SHARP = ("accuracy.residual=1e-13", 'method.conductance="exact"')  # of the runs whose events are compared
ALIKE = 1e-6  # of begin, end and moment of an event


def clocked(tree: Path, *more: str) -> tuple[float, list[dict[str, str]]]:
    """CPU seconds of the command with the code of a tree and more settings, and its events."""
    with tempfile.TemporaryDirectory() as name:
        settings = ("output.pictures=false", f'stage.0.end="{END}"', *more)
        options = [word for setting in settings for word in ("--set", setting)]
        scene, before = ROOT / "meshes" / "injection_cycle" / "scene.toml", resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "fracflow", "run", str(scene), "-o", f"{name}/run", *options]
        environment = without_ranks("PYTHONPATH") | {"PYTHONPATH": os.fspath(tree)}
        subprocess.run(command, check=True, cwd=tree, env=environment, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        with Path(name, "run", "events.csv").open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["kind"] == "event"]
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, rows


def are_alike(found: list[dict[str, str]], sought: list[dict[str, str]]) -> bool:
    """Whether two catalogues have the same events."""

    def near(a: str, b: str) -> bool:
        return abs(float(a) - float(b)) <= ALIKE * abs(float(b))

    same = len(found) == len(sought) > 0
    pairs = zip(found, sought, strict=False)
    return same and all(near(a[key], b[key]) for a, b in pairs for key in ("start", "end", "moment"))


def main() -> int:
    """Print each run; exit code 1 as above."""
    parser = argparse.ArgumentParser(prog="scripts/bench cycle", description=__doc__)
    parser.add_argument("--against", type=Path, help="an older checkout")
    parser.add_argument("--repeats", type=int, default=2, help="of runs in turns (2)")
    given = parser.parse_args()
    ratios = []
    for _ in range(given.repeats):
        old = clocked(given.against.resolve()) if given.against else None
        seconds, events = clocked(ROOT)
        line = f"{seconds:.2f} CPU s, {len(events)} event"
        if old is not None:
            ratios.append(seconds / old[0])
            line += f"; {old[0]:.2f} before: {ratios[-1]:.3f}"
        print(line + f"; load {os.getloadavg()[0]:.1f}", flush=True)
    if not given.against:
        return 0
    found, sought = (clocked(tree, *SHARP)[1] for tree in (ROOT, given.against.resolve()))
    print(
        *(f"{name}: moment {row['moment']}" for name, rows in (("now", found), ("before", sought)) for row in rows),
        sep="\n",
    )
    return int(not are_alike(found, sought) or median(ratios) > ALLOWED)


if __name__ == "__main__":
    raise SystemExit(main())
