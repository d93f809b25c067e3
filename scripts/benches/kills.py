"""Faults at the n-th file operation of a run: what is left can be read, and a resume gives what it would have given.

    scripts/bench kills [--cases 1000] [--ranks-share 0.3] [--seed 0] [--jobs 1] [--only SCENE] [--case N ...] [--keep DIR]

Each case draws a scene, a fault and an operation of the run on its folder (open, write, rename, ...): kill -9 before it,
half of it and kill -9, half of it and a full disk, a disk that is full from there on or once, an I/O error once, SIGTERM,
SIGINT; on two ranks also kill -9 of the other rank. A quarter of those on one rank are killed again while they go on.
Exit code 1 where a run hangs, says more than a line, ends with another code than it should, leaves what cannot be read, or
its resume, on as many ranks, differs in any bit from the undisturbed run. Needs a C compiler, named cc.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parent))
from _kills_runs import HUNG, complaints, copied, environment, on_ranks, resumed_on_ranks

ROOT = Path(__file__).resolve().parents[2]
KILL, HALF_KILL, FULL, FULL_ONCE, EIO_ONCE, HALF_FULL, TERM, INT, OTHER = range(1, 10)
MODES = {
    KILL: "kill -9", HALF_KILL: "half, kill -9", FULL: "full disk", FULL_ONCE: "full once", EIO_ONCE: "I/O error once",
    HALF_FULL: "half, full disk", TERM: "SIGTERM", INT: "SIGINT", OTHER: "kill -9 of the other rank",
}  # fmt: skip
CODES = {
    **{mode: {-9, 0, 137} for mode in (KILL, HALF_KILL, OTHER)},
    **{mode: {0, 2, 3} for mode in (FULL, FULL_ONCE, EIO_ONCE, HALF_FULL)},
    **{mode: {0, 130, -15, 143} for mode in (TERM, INT)},
}
AGAIN = 0.25  # of cases are killed again while they go on
EARLY = 0.2  # of faults come in the first operations
BATCH = 10  # folders that one job of two ranks resumes

WELLS = """
[rock.rock]
youngs_modulus = 1e10
poissons_ratio = 0.25
density = 2700
[fracture.crack]
normal_stiffness = 1e10
shear_stiffness = 1e10
aperture = 1e-3
friction_angle_deg = 30
[geometry]
domain = [0, 0, 4, 3]
size = 1.5
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 2]]
[initial_stress]
xx = -5e6
yy = -5e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
[[support]]
on = ["south", "north", "east", "west"]
[[well]]
name = "in"
at = {fracture = "crack", end = "start"}
flow_rate = 1e-5
[[well]]
name = "out"
at = {fracture = "crack", end = "end"}
pressure = "initial"
[[probe]]
name = "middle"
at = [2, 1.5]
[[stage]]
kind = "quasi-static"
time_step = 1e-3
steps = 12
"""


@dataclass(frozen=True)
class Scene:
    """A scene under test: its file or its text, settings, and how often it is drawn."""

    source: str
    settings: tuple[str, ...]
    share: float


SCENES = {
    "fault": Scene("report_5_5", ("stage.failure.steps=8", "output.checkpoint_every=3", "output.fields_every=5"), 0.35),
    "block": Scene("report_5_2", ("stage.0.end=1.2", "output.checkpoint_every=4", "output.fields_every=3"), 0.3),
    "wells": Scene(WELLS, ("output.checkpoint_every=2", "output.fields_every=4"), 0.3),
    "auto": Scene(
        "failures/two_modes",
        (
            "stage.push.end=430", "stage.push.dynamic_time_step=0.5", "stage.push.at_rest=0.1",
            "output.checkpoint_every=8", "output.fields_every=20",
        ),
        0.05,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One fault; ``at`` and ``second`` are shares of the run's operations, the latter of a kill while it goes on."""

    number: int
    ranks: int
    scene: str
    mode: int
    at: float
    is_early: bool
    second: float | None


@dataclass
class Finding:
    """The result of a case: the exit code of the faulted run, and its faults."""

    case: Case
    at: int
    code: int = 0
    wrong: list[str] = field(default_factory=list)
    again: str = ""


def draw(seed: int, number: int, share: float, only: str | None = None) -> Case:
    """The case of a number, of any scene or one; those below ``share`` of any hundred are on two ranks."""
    dice = random.Random(f"{seed} {number}")
    ranks = 2 if (number * 61) % 100 < 100 * share else 1
    scene = dice.choices(list(SCENES), [each.share for each in SCENES.values()])[0]
    mode = dice.choice([mode for mode in MODES if mode != OTHER or ranks == 2])
    at, is_early, again = dice.random(), dice.random() < EARLY, dice.random()
    return Case(
        number, ranks, only or scene, mode, at, is_early, dice.random() if again < AGAIN and ranks == 1 else None
    )


class Bench:
    """Compiles the shim, runs scenes undisturbed, and then cases."""

    def __init__(self, folder: Path, kept: Path | None, only: str | None = None) -> None:
        """In an empty folder; what failed is kept in another."""
        self.folder, self.kept = folder, kept
        self.shim = folder / "shim.so"
        source = Path(__file__).with_name("kills_shim.c")
        words = ["cc", "-shared", "-fPIC", "-o", str(self.shim), str(source), "-ldl"]
        subprocess.run(words, check=True, capture_output=True)
        self.files: dict[str, Path] = {}
        self.count: dict[tuple[str, int], int] = {}
        for name, scene in SCENES.items():
            if only not in (None, name):
                continue
            self.files[name] = ROOT / "meshes" / scene.source / "scene.toml"
            if "\n" in scene.source:
                self.files[name] = folder / f"{name}.toml"
                self.files[name].write_text(scene.source, encoding="utf-8")

    def words(self, name: str, folder: Path) -> list[str]:
        """The command of a scene's run."""
        settings = ("output.pictures=false", *SCENES[name].settings)
        return ["run", str(self.files[name]), "-o", str(folder), *(w for each in settings for w in ("--set", each))]

    def reference(self, name: str, ranks: int) -> Path:
        """The folder of the undisturbed run."""
        return self.folder / f"whole_{name}_{ranks}"

    def worker(self) -> Worker:
        """A process with the shim in it, that forks."""
        return Worker(self.shim, sorted(map(str, self.files.values())))

    def prepare(self, names: set[tuple[str, int]], worker: Worker) -> None:
        """Run scenes undisturbed, and count their operations."""
        for name, ranks in sorted(names):
            folder = self.reference(name, ranks)
            if ranks == 1:
                found = worker.ask("fracflow", self.words(name, folder), str(folder), 0, 0)
                code, said, count = found["code"], found["said"], found["seen"]
            else:
                code, said, count = self.on_two(self.words(name, folder), folder, 0, 0)
            if code or count < 50:
                raise SystemExit(f"kills: {name} on {ranks} ranks: exit {code}, {count} operations: {said[-300:]}")
            self.count[name, ranks] = count

    def on_two(self, words: list[str], folder: Path, mode: int, at: int) -> tuple[int, str, int]:
        """Exit code, lines and number of operations of a command on two ranks with a fault on rank 0."""
        count = Path(f"{folder}.count")
        count.unlink(missing_ok=True)
        code, said = on_ranks(
            ["-m", "fracflow", *words], Path(f"{folder}.out"), LD_PRELOAD=self.shim, KILLS_FOLDER=folder, KILLS_MODE=mode,
            KILLS_AT=at, KILLS_RANK=0, KILLS_COUNT=count, KILLS_PID=f"{folder}.pid",
        )  # fmt: skip
        return code, said, int(count.read_text()) if count.exists() else 0

    def fault(self, case: Case, worker: Worker) -> Finding:
        """The faulted run; on one rank also what comes after it."""
        total = self.count[case.scene, case.ranks]
        found = Finding(case, 1 + int(case.at * (min(total, 60) if case.is_early else total)))
        folder = self.place(case)
        if case.ranks == 1:
            told = worker.ask("fracflow", self.words(case.scene, folder), str(folder), case.mode, found.at)
            found.code, said = told["code"], told["said"]
        else:
            found.code, said, _ = self.on_two(self.words(case.scene, folder), folder, case.mode, found.at)
        self.judge(found, "", found.code, said, worker, CODES[case.mode])
        if case.ranks == 1:
            if case.second is not None and folder.exists():
                at = 1 + int(case.second * total)
                told = worker.ask("fracflow", self.go_on(case), str(folder), KILL, at)
                found.again = f", again at {at}"
                self.judge(found, "killed again: ", told["code"], told["said"], worker, {-9, 0})
            told = worker.ask("fracflow", self.go_on(case), str(folder), 0, 0)
            self.judge_end(found, told["code"], told["said"], worker)
        return found

    def place(self, case: Case) -> Path:
        """The run folder of a case."""
        return self.folder / f"case_{case.number}"

    def go_on(self, case: Case) -> list[str]:
        """The command that a user would give: resume, or run where nothing was begun."""
        folder = self.place(case)
        return ["resume", str(folder)] if (folder / "scene.toml").exists() else self.words(case.scene, folder)

    def judge(self, found: Finding, what: str, code: int, said: str, worker: Worker, codes: set[int]) -> None:
        """Look at how a run ended, and at what it left."""
        folder = self.place(found.case)
        if code == HUNG:
            found.wrong.append(f"{what}hangs")
        elif code not in codes:
            lines = [line for line in said.splitlines() if line.strip()]
            found.wrong.append(f"{what}exit code {code}: {lines[-1][:160] if lines else ''}")
        if told := complaints(said):
            found.wrong.append(what + told)
        if folder.exists() and (bad := worker.ask("judge", str(folder), "")["found"]):
            found.wrong.append(f"{what}cannot be read: {bad[:300]}")
        if found.wrong and self.kept is not None:
            copied(folder, self.kept / f"{folder.name}{'_again' if what else ''}")

    def judge_end(self, found: Finding, code: int, said: str, worker: Worker) -> None:
        """Look at a run that went on to its end."""
        folder, case = self.place(found.case), found.case
        self.judge(found, "resumed: ", code, said, worker, {0})
        if code == 0 and (
            bad := worker.ask("judge", str(folder), str(self.reference(case.scene, case.ranks)))["found"]
        ):
            found.wrong.append(f"resumed: differs: {bad[:300]}")
        for path in (*self.folder.glob(folder.name), *self.folder.glob(f"{folder.name}.*")):
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def batch(self, cases: list[Case], worker: Worker) -> Iterator[Finding]:
        """Cases that are resumed together: those on two ranks."""
        found = [self.fault(case, worker) for case in cases]
        # one that begins again has a process to itself: the second partition that a process makes is another than the first
        begun = [self.place(each.case) for each in found if (self.place(each.case) / "checkpoint.h5").exists()]
        ended = resumed_on_ranks(begun, self.folder / f"batch_{cases[0].number}.out")
        for each in found:
            folder = self.place(each.case)
            if folder in ended:
                code, said = ended[folder]
            else:
                code, said = on_ranks(["-m", "fracflow", *self.go_on(each.case)], Path(f"{folder}.out"))
            self.judge_end(each, code, said, worker)
            yield each


class Worker:
    """Asks a process that forks."""

    def __init__(self, shim: Path, scenes: list[str]) -> None:
        """Start it, and let it mesh."""
        words = [sys.executable, str(Path(__file__).with_name("_kills_runs.py")), "one"]
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment(LD_PRELOAD=shim)
        )
        for scene in scenes:
            self.ask("mesh", scene)

    def ask(self, *question: Any) -> Any:
        """Ask one thing."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps(question) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit("kills: the process that forks has ended")
        return json.loads(line)

    def close(self) -> None:
        """End it."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def told(found: Finding, chosen: argparse.Namespace) -> str:
    """A line on a finding, with the command that repeats it."""
    case = found.case
    only = f" --only {chosen.only}" if chosen.only else ""
    again = f"scripts/bench kills --seed {chosen.seed} --ranks-share {chosen.ranks_share:g}{only} --case {case.number}"
    return (
        f"{MODES[case.mode]} at operation {found.at}{found.again} of {case.scene} on {case.ranks} ranks:"
        f" {'; '.join(found.wrong)}\n    {again}"
    )


def groups(cases: list[Case]) -> list[list[Case]]:
    """Cases that are done together."""
    found = []
    for ranks in (1, 2):
        some = [case for case in cases if case.ranks == ranks]
        found += [some[at : at + BATCH] for at in range(0, len(some), BATCH)]
    return found


def main() -> int:
    """Print findings as they come, and the table; exit code 1 if there is one, 2 without a compiler."""
    parser = argparse.ArgumentParser(prog="scripts/bench kills", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--ranks-share", type=float, default=0.3, help="of cases on two ranks")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(SCENES), help="one scene")
    parser.add_argument("--jobs", type=int, default=1, help="cases at once")
    parser.add_argument("--case", type=int, nargs="+", help="numbers of the only cases")
    parser.add_argument("--keep", type=Path, help="folder for what failures left")
    chosen = parser.parse_args()
    if shutil.which("cc") is None:
        print("kills: no C compiler cc: install one, such as gcc", file=sys.stderr)
        return 2
    numbers = chosen.case or range(chosen.cases)
    cases = [draw(chosen.seed, number, chosen.ranks_share, chosen.only) for number in numbers]
    began, count, failures = time.monotonic(), Counter[tuple[int, int]](), Counter[tuple[int, int]]()
    codes: dict[int, Counter[int]] = {mode: Counter() for mode in MODES}
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        bench = Bench(Path(name).resolve(), chosen.keep, chosen.only)
        first = bench.worker()
        bench.prepare({(case.scene, case.ranks) for case in cases}, first)
        free = [first, *(bench.worker() for _ in range(chosen.jobs - 1))]

        def done(group: list[Case]) -> list[Finding]:
            worker = free.pop()
            try:
                return [*bench.batch(group, worker)] if group[0].ranks == 2 else [bench.fault(c, worker) for c in group]
            finally:
                free.append(worker)

        with ThreadPoolExecutor(chosen.jobs) as pool:
            for findings in pool.map(done, groups(cases)):
                for found in findings:
                    key = (found.case.mode, found.case.ranks)
                    count[key] += 1
                    codes[found.case.mode][found.code] += 1
                    if found.wrong:
                        failures[key] += 1
                        print(told(found, chosen), flush=True)
                spent = time.monotonic() - began
                print(f"{count.total()} of {len(cases)} cases, {spent:.0f} s", file=sys.stderr, flush=True)
        for worker in [*free]:
            worker.close()
    table = Table(title="Faults at the n-th file operation")
    for head in ("fault", "1 rank", "2 ranks", "exit codes", "failures"):
        table.add_column(head)
    for mode, title in MODES.items():
        ends = ", ".join(f"{code}: {number}" for code, number in sorted(codes[mode].items()))
        row = (title, count[mode, 1], count[mode, 2], ends, failures[mode, 1] + failures[mode, 2])
        table.add_row(*map(str, row))
    Console(width=150).print(table)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    seconds = sum(each.ru_utime + each.ru_stime for each in used)
    on_two = sum(number for (_, ranks), number in count.items() if ranks == 2)
    print(
        f"seed {chosen.seed}: {count.total()} faults, {on_two} of them on 2 ranks, {failures.total()} failures;"
        f" {seconds / 60:.1f} CPU minutes, {(time.monotonic() - began) / 60:.1f} minutes"
    )
    return int(failures.total() > 0)


if __name__ == "__main__":
    raise SystemExit(main())
