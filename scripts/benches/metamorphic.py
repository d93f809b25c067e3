"""Random scenes written down in other ways, or solved by other means: the results must be the same.

    scripts/bench metamorphic [--scenes 100] [--seed 0] [--only KIND ...] [--ranks-every 4] [--out DIR]

Each scene of ``_meta_scenes`` is run as it is, and changed in each way of ``_meta_turns`` that fits it, stopped and
resumed, with a tolerance stopped and resumed, and some of them on 2 and 3 ranks. Probes, energies and events are read
back and compared over sizes that follow from the scene. A difference above the limit is explained only where the scene
as it is, shaken in the thirteenth digit of its numbers, moves as much, which is its condition; or where an aperture
more than doubled in one step, which the log tells, for such steps have several solutions.

Exit code 1 if a difference is left unexplained, the energy balance stay open, something is no number, or a run fails in
one way only.
"""

from __future__ import annotations

import argparse
import math
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from _meta_compare import Differences, Record, differences, not_numbers, open_books
from _meta_runs import at_once, left_by_ranks, on_ranks, resumed, write
from _meta_scenes import Case, copied, draw, twin
from _meta_turns import SHAKEN, TURNS, Back, shaken

SAME = 1e-8  # of natural size
CLOSED = 1e-10  # energy balance over their largest entry
LIKEWISE = 0.1  # of a difference: what a shaken scene must move by for it to be explained
SHAKES = 3
WIDENS = 2.0  # growth of an aperture in a step that the log tells of: there may be several solutions
LIMIT = 1.2  # CPU seconds of the scene as it is: more scenes tell more than longer ones
PATIENCE = 10.0  # times that, for the same scene in another way
HANGS = 200.0  # seconds of a scene on ranks, which share the cores with whatever else runs
RESUMED, TOLERANT = "resumed", "tolerance, resumed"
OVER, EXPLAINED, BROKEN = "above", "ill-conditioned", "failed alone"


@dataclass
class Row:
    """The results of all scenes in one way of writing them down.

    worst      largest difference over natural size that is not explained, with its scene and quantity
    condition  factors by which scenes whose difference is explained magnify what is given
    widened    largest factor by which an aperture grew in a step of scenes whose difference that explains
    """

    scenes: int = 0
    alike: int = 0
    above: int = 0
    explained: int = 0
    broken: int = 0
    worst: float = 0.0
    where: str = ""
    condition: list[float] = field(default_factory=list)
    widened: float = 0.0


class Scene:
    """A scene under test: what it gave as it is, and what it gives when it is shaken."""

    def __init__(self, seed: int, case: Case, folder: Path) -> None:
        """Run it as it is."""
        self.seed, self.case, self.folder = seed, case, folder
        self.base = at_once(case, folder / "base", 4.0 * LIMIT)
        self._shaken: list[tuple[Record, Differences]] | None = None

    @property
    def title(self) -> str:
        """Seed, network and stages."""
        return f"seed {self.seed} ({self.case.data['title']}, {', '.join(s['kind'] for s in self.case.data['stage'])})"

    def shakes(self) -> list[tuple[Record, Differences]]:
        """The results of the scene when its numbers are shaken, and by how much that differs; run when first asked for."""
        if self._shaken is None:
            self._shaken = []
            for number in range(SHAKES):
                case, back = shaken(self.case, np.random.default_rng([self.seed, number]))
                record = at_once(case, self.folder / "shaken", PATIENCE * LIMIT)
                both = record.code == self.base.code and record.history
                self._shaken.append((record, differences(self.case, self.base, record, back) if both else {}))
        return self._shaken


class Tally:
    """All findings, as a table and as lines."""

    def __init__(self, say: Callable[[str], None], kept: Path | None = None) -> None:
        """Nothing is found yet; scenes of findings are left in the folder ``kept``."""
        self.say, self.kept, self.rows = say, kept, dict[str, Row]()
        self.open, self.nan, self.runs, self.refused, self.failed, self.long = 0, 0, 0, 0, 0, 0

    def tell(self, what: str, scene: Scene, name: str, why: str) -> None:
        """A line on a finding; its scene is kept."""
        self.say(f"{what}: {scene.title}, {name}: {why}")
        if self.kept is not None:
            write(scene.case, self.kept / str(scene.seed))

    def judge_alone(self, name: str, scene: Scene, record: Record, back: Back) -> None:
        """Count what is wrong with a run by itself."""
        self.runs += 1
        if not record.history:
            return
        if told := not_numbers(record):
            self.nan += 1
            self.tell("no number", scene, name, ", ".join(told[:3]))
        if not (left := open_books(record, scene.case, back)) <= CLOSED:
            self.open += 1
            self.tell("open books", scene, name, f"{left:.1e}")

    def judge(self, name: str, scene: Scene, base: Record, record: Record, back: Back) -> None:
        """Compare a run with that of the scene as it is."""
        row = self.rows.setdefault(name, Row())
        self.judge_alone(name, scene, record, back)
        row.scenes += 1
        if record.code != base.code:
            others = [shake.code for shake, _ in scene.shakes()]
            if record.code in others:
                row.explained += 1
                row.condition.append(math.inf)
                self.tell(EXPLAINED, scene, name, f"exit {record.code} for {base.code}, shaken {others}")
                return
            row.broken += 1
            why = " ".join((record.message if record.code else base.message).split())
            self.tell(BROKEN, scene, name, f"exit {record.code} for {base.code}: {why[-300:]}")
            return
        found = differences(scene.case, base, record, back) if base.history else {}
        over = {key: value for key, value in found.items() if not value <= SAME}
        if base.code != 0:
            names = (
                *scene.case.data["fracture"],
                *(well["name"] for well in scene.case.data.get("well", ())),
                "block ",
            )
            if any(name in record.message for name in names):
                row.alike += 1
            else:
                row.broken += 1
                self.tell(BROKEN, scene, name, f"exit {record.code} names nothing: {record.message[-300:]}")
            return
        if not over:
            row.alike += 1
            self._worst(row, scene, found)
            return
        widest = max(float(each.history["step/widening"].max()) for each in (base, record))
        if widest > WIDENS:
            row.explained += 1
            row.widened = max(row.widened, widest)
            self.tell("several solutions", scene, name, f"an aperture grew {widest:.3g} times as wide in one step")
            return
        moved = {key: max(d.get(key, 0.0) for _, d in scene.shakes()) for key in over}
        left = {key: value for key, value in over.items() if not moved[key] >= LIKEWISE * value}
        told = ", ".join(f"{key} {value:.1e} (shaken {moved[key]:.1e})" for key, value in sorted(over.items()))
        if left:
            row.above += 1
            self._worst(row, scene, left)
            self.tell(OVER, scene, name, told)
        else:
            row.explained += 1
            row.condition.append(max(moved.values()) / SHAKEN)
            self.tell(EXPLAINED, scene, name, told)

    def _worst(self, row: Row, scene: Scene, found: Differences) -> None:
        key = max(found, key=lambda key: found[key], default="")
        if key and found[key] > row.worst:
            row.worst, row.where = found[key], f"{key}, seed {scene.seed}"

    @property
    def wrong(self) -> int:
        """Number of findings that nothing explains."""
        return self.open + self.nan + sum(row.above + row.broken for row in self.rows.values())

    def show(self, console: Console) -> None:
        """Print the table."""
        table = Table(title=f"differences over natural size; above is above {SAME:g}")
        for heading in ("way", "scenes", "alike", "worst difference", "above", "ill-conditioned", "by", "failed alone"):
            table.add_column(heading)
        for name, row in self.rows.items():
            by = f"{min(row.condition):.0e} to {max(row.condition):.0e}" if row.condition else ""
            by += f" widened {row.widened:.3g}" if row.widened else ""
            worst = f"{row.worst:.1e} {row.where}" if row.where else "0"
            table.add_row(
                name, *map(str, (row.scenes, row.alike)), worst, str(row.above), str(row.explained), by, str(row.broken)
            )
        console.print(table)


def steps_of(record: Record) -> int:
    """Number of steps on record."""
    return len(record.history.get("time", [0])) - 1


def judge_scene(scene: Scene, tally: Tally, only: frozenset[str]) -> None:
    """Write a scene down in every way, and compare."""
    random = np.random.default_rng([scene.seed, 99])
    limit = PATIENCE * LIMIT
    for turn in TURNS:
        draws = np.random.default_rng(random.integers(2**32))
        if turn.fits(scene.case) and (not only or turn.name in only):
            case, back = turn.make(scene.case, draws)
            record = at_once(case, scene.folder / "other", limit)
            tally.judge(turn.name, scene, scene.base, record, back)
    if scene.base.code != 0 or steps_of(scene.base) < 2:
        return
    if not only or RESUMED in only:
        after = int(random.integers(1, steps_of(scene.base)))
        record = resumed(scene.case, scene.folder / "other", limit, after + 1)
        tally.judge(RESUMED, scene, scene.base, record, Back())
    kinds = {stage["kind"] for stage in scene.case.data["stage"]}
    if (not only or TOLERANT in only) and kinds <= {"quasi-static", "dynamic"} and "accuracy" not in scene.case.data:
        case = twin(scene.case, copied(scene.case) | {"accuracy": {"tolerance": 1e-2}})
        base = at_once(case, scene.folder / "other", limit)
        if base.code == 0 and steps_of(base) > 1:
            tally.judge_alone(TOLERANT, scene, base, Back())
            after = int(random.integers(1, steps_of(base)))
            record = resumed(case, scene.folder / "other", limit, after + 1)
            tally.judge(TOLERANT, scene, base, record, Back())


def judge_on_ranks(scenes: list[Scene], ranks: int, tally: Tally, folder: Path) -> None:
    """Run scenes on ranks, and compare."""
    folders = []
    for scene in scenes:
        folders.append(folder / f"ranks{ranks}" / str(scene.seed))
        write(scene.case, folders[-1])
    on_ranks(folders, ranks, HANGS)
    for scene, place in zip(scenes, folders, strict=True):
        tally.judge(f"{ranks} ranks", scene, scene.base, left_by_ranks(place), Back())
        shutil.rmtree(place)


def scenes_of(count: int, first: int, folder: Path, tally: Tally) -> Iterator[Scene]:
    """So many scenes that run to an end in time; those that do not, or are refused, are counted and passed over."""
    found, seed = 0, first
    while found < count:
        scene = Scene(seed, draw(seed), folder)
        seed += 1
        tally.judge_alone("as it is", scene, scene.base, Back())
        if scene.base.seconds > LIMIT:
            tally.long += 1
            tally.say(f"too long: {scene.title}: more than {LIMIT:g} CPU s, passed over")
        elif scene.base.code == 2:
            tally.refused += 1
        else:
            tally.failed += scene.base.code == 3
            found += 1
            yield scene


def main() -> int:
    """Print findings as they come, and the table; exit code 1 if one is not explained."""
    parser = argparse.ArgumentParser(prog="scripts/bench metamorphic", description=(__doc__ or "").splitlines()[0])
    names = [turn.name for turn in TURNS] + [RESUMED, TOLERANT, "ranks"]
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--only", nargs="+", choices=names, default=[], metavar="KIND", help=", ".join(names))
    parser.add_argument("--ranks-every", type=int, default=4, help="which scenes run on 2 and 3 ranks; 0: none")
    parser.add_argument("--out", type=Path, help="folder for scene and mesh of each finding")
    chosen = parser.parse_args()
    only, began = frozenset(chosen.only), time.monotonic()
    tally = Tally(lambda line: print(line, flush=True), chosen.out)
    on_many: list[Scene] = []
    with tempfile.TemporaryDirectory(prefix="metamorphic-") as name:
        folder = Path(name)
        for done, scene in enumerate(scenes_of(chosen.scenes, chosen.seed, folder, tally)):
            if scene.base.code not in (0, 3):
                tally.rows.setdefault("as it is", Row()).broken += 1
                tally.tell(BROKEN, scene, "as it is", f"exit {scene.base.code}: {scene.base.message[-300:]}")
                continue
            judge_scene(scene, tally, only)
            if chosen.ranks_every and done % chosen.ranks_every == 0:
                on_many.append(scene)
            spent = time.monotonic() - began
            left = spent / (done + 1) * (chosen.scenes - done - 1)
            print(
                f"{done + 1} of {chosen.scenes} scenes, {spent:.0f} s, {left:.0f} s left", file=sys.stderr, flush=True
            )
        for ranks in (2, 3) if on_many and (not only or "ranks" in only) else ():
            judge_on_ranks(on_many, ranks, tally, folder)
    tally.show(Console(width=150))
    print(
        f"{chosen.scenes} scenes, {tally.failed} of them failed by name, {tally.refused} more refused,"
        f" {tally.long} more took too long; {tally.runs} runs: {tally.open} open energies, {tally.nan} with NaN,"
        f" {tally.wrong} findings; {time.monotonic() - began:.0f} s"
    )
    return int(tally.wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
