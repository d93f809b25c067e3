"""Whether a change of the code changed a result: every scene of meshes/ and random ones, before and after it.

    scripts/bench unchanged keep DIR [--random 40] [--ranks 1 2] [--only NAME ...] [--jobs N]
    scripts/bench unchanged compare DIR        runs what DIR has with the code as it is now, and compares

Kept are the histories, the events and the catalogue of each scene on each number of ranks, beside the scene and its
mesh. A difference is taken over the largest value of its quantity in the scene, over all probes. Exit code 1 if one is
above 1e-10, or an event or a row of the catalogue differs, or a run ends otherwise.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _launch import without_ranks
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
ROOT = Path(__file__).parents[2]
SAME = 1e-10  # of the largest value of the quantity
PATIENCE = 1800.0  # seconds of one run
# the largest scenes in less: what they do in their first steps they do in all
SHORTER = {"rupture": ['stage.0.end="0.3 s"']}
NO_RESULTS = ("step/factorisations", "step/krylov", "step/digits", "step/round_off")  # work, and bounds of round-off
KEPT = ("history.h5", "events.csv", "catalogue.csv", "exit.json")


@dataclass(frozen=True)
class Job:
    """A scene on a number of ranks."""

    name: str
    scene: Path
    ranks: int
    sets: tuple[str, ...] = ()


def scenes_of(meshes: Path, numbers: int, into: Path) -> Iterator[tuple[str, Path, tuple[str, ...]]]:
    """Name, path and overrides of the scenes of ``meshes`` and of random ones, which are written ``into`` a folder."""
    for path in sorted(meshes.rglob("scene.toml")):
        name = str(path.parent.relative_to(meshes))
        yield name, path, tuple(SHORTER.get(name, ()))
    if not numbers:
        return
    from _meta_runs import write
    from _meta_scenes import draw

    for seed in range(numbers):
        folder = into / f"random_{seed}"
        if not (folder / "scene.toml").exists():
            write(draw(seed), folder)
        yield folder.name, folder / "scene.toml", ()


def run(job: Job, into: Path) -> None:
    """Run a scene through the command line, and leave what is kept of it in a folder."""
    environment = without_ranks()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        launcher = ["mpirun", "--oversubscribe", "-n", str(job.ranks)] if job.ranks > 1 else []
        sets = [word for each in (*job.sets, "output.pictures=false") for word in ("--set", each)]
        words = [*launcher, sys.executable, "-m", "fracflow", "run", str(job.scene), "-o", str(out), *sets]
        try:
            done = subprocess.run(
                words, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE
            )
            code, said = done.returncode, done.stderr.strip().splitlines()[-1:]
        except subprocess.TimeoutExpired:
            code, said = -9, [f"took more than {PATIENCE:g} s"]
        into.mkdir(parents=True, exist_ok=True)
        for name in KEPT[:-1]:
            if (out / name).exists():
                shutil.copy(out / name, into / name)
        (into / "exit.json").write_text(json.dumps({"code": code, "said": said}), encoding="utf-8")


def differences(one: Path, other: Path) -> Iterator[tuple[str, float]]:
    """Quantities that differ between two kept runs, with the difference over their size; inf where it has none."""
    from fracflow.output import read_history

    codes = [json.loads((each / "exit.json").read_text(encoding="utf-8"))["code"] for each in (one, other)]
    if codes[0] != codes[1]:
        yield f"exit {codes[1]} for {codes[0]}", np.inf
    for name in KEPT[1:-1]:
        tables = [(each / name).read_text(encoding="utf-8") if (each / name).exists() else "" for each in (one, other)]
        if tables[0] != tables[1]:
            yield from ((f"{name} {what}", apart) for what, apart in rows_apart(*tables))
    if not (one / "history.h5").exists() or not (other / "history.h5").exists():
        return
    before, after = read_history(one / "history.h5"), read_history(other / "history.h5")
    for key in sorted(before.keys() - after.keys()):  # a quantity that is new is no difference
        yield f"{key} is gone", np.inf
    kinds: dict[str, float] = {}
    for key in before.keys() & after.keys():
        if before[key].shape != after[key].shape:
            yield f"{key}: rows {len(after[key])} for {len(before[key])}", np.inf
        elif before[key].dtype.kind == "f":
            kind = "energy" if key.startswith("energy/") else key.rsplit("/", 1)[-1]
            kinds[kind] = max(kinds.get(kind, 0.0), float(np.nanmax(np.abs(before[key]), initial=0.0)))
    for key in sorted(before.keys() & after.keys()):
        if key in NO_RESULTS or before[key].shape != after[key].shape or np.array_equal(before[key], after[key]):
            continue
        if before[key].dtype.kind != "f":
            yield key, np.inf
            continue
        kind = "energy" if key.startswith("energy/") else key.rsplit("/", 1)[-1]
        apart = np.abs(before[key] - after[key])
        if not np.array_equal(np.isnan(before[key]), np.isnan(after[key])):
            yield f"{key}: nan", np.inf
        if np.nanmax(apart, initial=0.0) > 0.0:
            yield key, float(np.nanmax(apart) / kinds[kind])


def rows_apart(before: str, after: str) -> Iterator[tuple[str, float]]:
    """Where two tables differ: words that do, and numbers by how much over the larger."""
    rows = [[line.split(",") for line in text.splitlines()] for text in (before, after)]
    if [len(row) for row in rows[0]] != [len(row) for row in rows[1]]:
        yield "rows", np.inf
        return
    for number, (one, other) in enumerate(zip(*rows, strict=True)):
        for head, a, b in zip(rows[0][0], one, other, strict=True):
            if a != b:
                try:
                    yield f"row {number} {head}", abs(float(a) - float(b)) / max(abs(float(a)), abs(float(b)))
                except ValueError:
                    yield f"row {number} {head}: {b} for {a}", np.inf


def main() -> int:
    """Keep or compare; gives the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("keep", "compare"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--random", type=int, default=40)
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    folder = given.folder.absolute()
    scenes = folder / "scenes"
    if given.action == "keep":
        shutil.copytree(ROOT / "meshes", scenes / "meshes", dirs_exist_ok=True)
    found = list(scenes_of(scenes / "meshes", given.random if given.action == "keep" else 0, scenes / "random"))
    if given.action == "compare":
        found += [(path.parent.name, path, ()) for path in sorted((scenes / "random").rglob("scene.toml"))]
    jobs = [
        Job(name, path, ranks, sets)
        for ranks in given.ranks
        for name, path, sets in found
        if not given.only or any(each in name for each in given.only)
        if given.action == "keep" or (folder / "before" / str(ranks) / name).exists()
    ]
    place = folder / ("before" if given.action == "keep" else "after")
    begun, console = time.monotonic(), Console()

    def one(job: Job) -> None:
        into = place / str(job.ranks) / job.name
        if given.action == "keep" and (into / "exit.json").exists():
            return
        shutil.rmtree(into, ignore_errors=True)
        run(job, into)
        console.print(f"{time.monotonic() - begun:6.0f} s  {job.ranks} ranks  {job.name}")

    with ThreadPoolExecutor(given.jobs) as pool:
        list(pool.map(one, jobs))
    if given.action == "keep":
        return 0
    table = Table(title=f"differences over the size of the quantity; wrong is above {SAME:g}")
    for heading in ("scene", "ranks", "largest", "of", "above"):
        table.add_column(heading)
    wrong = equal = 0
    for job in jobs:
        place = Path(str(job.ranks)) / job.name
        apart = dict(differences(folder / "before" / place, folder / "after" / place))
        if not apart:
            equal += 1
            continue
        worst = max(apart, key=lambda key: apart[key])
        above = sum(value > SAME for value in apart.values())
        wrong += above > 0
        table.add_row(job.name, str(job.ranks), f"{apart[worst]:.1e}", worst, str(above))
    console.print(table)
    console.print(f"{len(jobs)} runs: {equal} equal to the last bit, {wrong} with a difference above {SAME:g}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
