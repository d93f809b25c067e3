"""Work of each scene of meshes/: evaluations of the balances and factorisations, those of rejected trials too.

    scripts/bench evaluations [SCENE...] [--most N] [--out DIR]

A row a scene: steps, Newton iterations of accepted steps and of rejected trials, evaluations, factorisations, evaluations for
each accepted iteration, CPU seconds for each iteration, accepted or not. CSV too with --out. Exit 1 where all scenes together
take more than --most evaluations for each accepted iteration. Without SCENE, the quick scenes of meshes/ are run: all but
injection_cycle and rupture.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from pathlib import Path
from time import process_time

import fracflow
from fracflow.simulation.run import run

ROOT = Path(__file__).parents[2]
LONG = {"injection_cycle", "rupture", "own_law"}  # which takes a script of its own
HEADS = ("scene", "steps", "iterations", "wasted", "evaluations", "factorisations", "each", "cpu_s", "cpu_s_iteration")


def work_of(scene: Path) -> tuple[object, ...]:
    """The row of one scene."""
    with tempfile.TemporaryDirectory() as folder:
        given, began = fracflow.load(scene, ["output.pictures=false"]), process_time()
        totals = run(given, Path(folder) / "run")
        seconds = process_time() - began
    each, made = (
        totals.evaluations / max(totals.counts["newton"], 1),
        max(totals.counts["newton"] + totals.counts["wasted"], 1),
    )
    counts = (totals.steps, totals.counts["newton"], totals.counts["wasted"], totals.evaluations, totals.factored)
    return given.name, *counts, round(each, 2), round(seconds, 2), round(seconds / made, 4)


def main() -> None:
    """Run, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="*", type=Path)
    parser.add_argument("--most", type=float, default=4.0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    every = sorted((ROOT / "meshes").glob("*/scene.toml"))
    rows = []
    print(" ".join(f"{head:>15s}" for head in HEADS))
    for scene in given.scene or [each for each in every if each.parent.name not in LONG]:
        rows.append(dict(zip(HEADS, work_of(scene), strict=True)))
        print(" ".join(f"{value!s:>15s}" for value in rows[-1].values()), flush=True)
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        with open(given.out / "evaluations.csv", "w", newline="") as file:
            table = csv.DictWriter(file, HEADS)
            table.writeheader()
            table.writerows(rows)
    each = sum(row["evaluations"] for row in rows) / max(sum(row["iterations"] for row in rows), 1)
    print(f"{each:.2f} evaluations for each accepted iteration; at most {given.most:g}")
    sys.exit(each > given.most)


if __name__ == "__main__":
    main()
