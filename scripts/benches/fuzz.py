"""Scenes, tables, meshes, geometries and run folders out of order: each is read, or refused in one useful line.

    scripts/bench fuzz [--inputs 100000] [--seed 0] [--jobs 2] [--only KIND ...] [--way WAY ...] [--case NUMBER ...] [--out DIR]

Most inputs are read in one process; Gmsh, which may crash, in a child of it. At least 2 % go through the command line,
some through Gmsh's own process, some hundred through processes started afresh. An input fails that raises anything but the
program's own errors, crashes, warns, prints, takes 30 s or 1 GiB, writes outside its folder or runs what lies there, loses
or changes a folder it refuses to resume, resumes to other results, or is refused in more than one line or without a
remedy. Failures of one kind at one place are one row of the table; the first of each is reduced and kept in OUT/cases.

Exit code 1 if anything failed.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import re
import selectors
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
import _fuzz_cases as cases
import _fuzz_commands as commands
from _fuzz_cases import COMMAND, FRESH, GMSH, PROCESS, SHARES, Bases, Case, kind_and_way
from _fuzz_judge import HANGS, Box, Found, bounded, of_error, peak

SILENT = 2.0 * HANGS  # seconds without a word from a worker: it hangs where no signal reaches it
MOST_KEPT = 3  # cases of one failure


@dataclass
class Tally:
    """The findings: key -> how often; of which inputs; where the first was kept."""

    failures: Counter[str] = field(default_factory=Counter)
    kinds: dict[str, Counter[str]] = field(default_factory=dict)
    kept: dict[str, str] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    done: Counter[tuple[str, str]] = field(default_factory=Counter)
    seconds: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add(self, kind: str, number: int, key: str, kept: str) -> None:
        """One failure more."""
        self.failures[key] += 1
        self.kinds.setdefault(key, Counter())[kind] += 1
        self.numbers.setdefault(key, number)
        if kept:
            self.kept.setdefault(key, kept)


def perform(case: Case, box: Box, bases: Bases) -> list[tuple[str, Found]]:
    """Lay a case out and do with it what is to be done: what is wrong."""
    cases.lay_out(case, box.case, bases, box.outside)
    if case.way == PROCESS:
        with commands.forking_gmsh():
            found = cases.in_one_process(case, box)
    else:
        found = commands.at_command(case, box, bases)
    return found + [("around", fault) for fault in box.marks()]


def keep(case: Case, key: str, detail: str, folder: Path, bases: Bases, box: Box) -> str:
    """Leave a case in a folder of its own, reduced."""

    def fails(trial: Case) -> bool:
        return key in {fault.key for _, fault in perform(trial, box, bases)}

    small = case if "hang" in key else cases.reduced(case, fails, 60 if case.way == PROCESS else 12)
    words = re.sub(r"[^A-Za-z0-9]+", "-", f"{case.kind} {key}").strip("-")[:70]
    place = folder / f"{words}-{case.number}"
    cases.lay_out(small, place, bases, box.outside)
    (place / "why.txt").write_text(
        f"{key}\n{cases.notes_of(case)}\n\n{detail}\n", encoding="utf-8", errors="backslashreplace"
    )
    return str(place)


def work(numbers: list[int], seed: int, root: Path, kept: Path, bases: Bases, write: int) -> None:
    """Do cases one after another; a line to ``write`` before each, a line of JSON for each failure."""
    box = Box(root)
    log = os.open(box.log, os.O_CREAT | os.O_RDWR | os.O_APPEND | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.chdir(box.case.parent)
    bounded()
    seen: Counter[str] = Counter()
    for number in numbers:
        os.write(write, f"{number}\n".encode())
        began = time.process_time() + sum(os.times()[2:4])
        try:
            case = cases.draw(seed, number, bases, box)
            found = perform(case, box, bases)
        except Exception as error:  # no fault of the program; the other cases go on
            found = []
            told = {"n": number, "key": f"the bench itself failed: {of_error(error).key}", "kept": ""}
            os.write(write, (json.dumps(told) + "\n").encode())
            os.write(write, b"!" + of_error(error).detail.replace("\n", "\r").encode() + b"\n")
        for ending, fault in {each.key: (ending, each) for ending, each in found}.values():
            seen[fault.key] += 1
            where = keep(case, fault.key, f"{ending}\n{fault.detail}", kept, bases, box) if seen[fault.key] == 1 else ""
            os.write(write, (json.dumps({"n": number, "key": fault.key, "kept": where}) + "\n").encode())
        spent = time.process_time() + sum(os.times()[2:4]) - began
        os.write(write, f"={spent:.6f}\n".encode())
    os.write(write, b"end %d\n" % (peak() >> 20))


class Worker:
    """A process that does the cases of every ``jobs``-th number; a new one goes on after a crash."""

    def __init__(self, numbers: list[int], seed: int, root: Path, kept: Path, bases: Bases) -> None:
        """Start it."""
        self.numbers, self.seed, self.root, self.kept, self.bases = numbers, seed, root, kept, bases
        self.start()

    def start(self) -> None:
        """Fork a process for what is left."""
        self.now, self.is_done, self.heard, self.rest, self.told = -1, False, time.monotonic(), b"", 0
        read, write = os.pipe()
        self.child = os.fork()
        if self.child == 0:
            code = 1
            try:
                os.close(read)
                os.setpgid(0, 0)
                work(self.numbers, self.seed, self.root, self.kept, self.bases, write)
                code = 0
            except BaseException:
                import traceback

                os.write(write, b"!" + traceback.format_exc().replace("\n", "\r").encode() + b"\n")
            finally:
                os._exit(code)
        os.close(write)
        self.pipe = read

    def lines(self) -> Iterator[str]:
        """Its output since then."""
        data = os.read(self.pipe, 1 << 16)
        self.heard = time.monotonic()
        *whole, self.rest = (self.rest + data).split(b"\n")
        yield from (line.decode() for line in whole)

    def ended(self) -> str:
        """How a process ended that is to say no more."""
        _, status = os.waitpid(self.child, 0)
        os.close(self.pipe)
        code = os.waitstatus_to_exitcode(status)
        return f"crash by signal {-code}" if code < 0 else f"the bench itself failed with code {code}"


def run_all(numbers: list[int], options: argparse.Namespace, bases: Bases, console: Console) -> tuple[Tally, int]:
    """Do all cases: what failed, and the peak of memory [MiB]."""
    tally, most, kept = Tally(), 0, options.out / "cases"
    kept.mkdir(parents=True, exist_ok=True)
    jobs = max(1, options.jobs)
    workers = [Worker(numbers[k::jobs], options.seed, options.out / f"box{k}", kept, bases) for k in range(jobs)]
    selector = selectors.DefaultSelector()
    for worker in workers:
        selector.register(worker.pipe, selectors.EVENT_READ, worker)
    left, told = len(workers), time.monotonic()
    while left:
        for entry, _ in selector.select(timeout=1.0):
            worker: Worker = entry.data
            lines = list(worker.lines())
            for line in lines:
                most = max(most, _hear(line, worker, tally, options.seed, console))
            if not lines and not worker.rest:
                selector.unregister(worker.pipe)
                how = worker.ended()
                if worker.is_done:
                    left -= 1
                    continue
                _crashed(worker, how, tally, options, bases, console)
                selector.register(worker.pipe, selectors.EVENT_READ, worker)
        for worker in workers:
            if not worker.is_done and time.monotonic() - worker.heard > SILENT:
                os.killpg(worker.child, signal.SIGKILL)
        if time.monotonic() - told > 60.0:
            told = time.monotonic()
            console.print(f"{sum(tally.done.values())} inputs, {len(tally.failures)} kinds of failures")
    return tally, most


def _hear(line: str, worker: Worker, tally: Tally, seed: int, console: Console) -> int:
    """Book what a worker says; gives its peak of memory when it ends [MiB]."""
    if line.startswith("="):
        key = kind_and_way(seed, worker.now)
        tally.done[key] += 1
        tally.seconds[key] += float(line[1:])
    elif line.startswith("{"):
        found = json.loads(line)
        if found["kept"]:
            console.print(f"input {found['n']}: {found['key']}", markup=False, soft_wrap=True)
        kind, way = kind_and_way(seed, found["n"])
        tally.add(f"{kind}, {way}", found["n"], found["key"], found["kept"])
    elif line.startswith("end "):
        worker.is_done = True
        return int(line[4:])
    elif line.startswith("!"):
        console.print(line[1:].replace("\r", "\n"), markup=False)
    else:
        worker.now = int(line)
    return 0


def _crashed(
    worker: Worker, how: str, tally: Tally, options: argparse.Namespace, bases: Bases, console: Console
) -> None:
    """Book the input that took a worker with it, keep it, and go on after it."""
    if worker.now < 0:
        raise RuntimeError(how)
    box = Box(worker.root)
    case = cases.draw(options.seed, worker.now, bases, box)
    key = f"{how}: {case.target.rpartition('/')[2]}"
    place = options.out / "cases" / f"crash-{case.number}"
    cases.lay_out(case, place, bases, box.outside)
    (place / "why.txt").write_text(f"{key}\n{cases.notes_of(case)}\n", encoding="utf-8")
    console.print(f"input {case.number}: {key}", markup=False)
    tally.add(f"{case.kind}, {case.way}", case.number, key, str(place))
    tally.done[kind_and_way(options.seed, case.number)] += 1
    worker.numbers = worker.numbers[worker.numbers.index(worker.now) + 1 :]
    worker.start()


def chosen(options: argparse.Namespace) -> list[int]:
    """The numbers of the cases to be done."""
    if options.case:
        return list(options.case)
    numbers = range(options.inputs)
    if options.only or options.way:
        kinds, ways = options.only or {kind for kind, _ in SHARES}, options.way or {way for _, way in SHARES}
        keys = {n: kind_and_way(options.seed, n) for n in numbers}
        return [n for n, (kind, way) in keys.items() if kind in kinds and way in ways]
    return list(numbers)


def tell(tally: Tally, most: int, console: Console) -> None:
    """The tables: inputs, and failures."""
    table = Table("input", PROCESS, GMSH, COMMAND, FRESH, "ms a case", "failures", box=None)
    for kind in dict.fromkeys(kind for kind, _ in SHARES):
        count = [tally.done[kind, way] for way in (PROCESS, GMSH, COMMAND, FRESH)]
        spent = sum(tally.seconds[kind, way] for way in (PROCESS, GMSH, COMMAND, FRESH))
        bad = sum(n for each in tally.kinds.values() for name, n in each.items() if name.startswith(f"{kind}, "))
        table.add_row(kind, *map(str, count), f"{1e3 * spent / max(sum(count), 1):.1f}", str(bad))
    console.print(table)
    if tally.failures:
        table = Table("failure", "times", "of", "first input", "kept in", box=None)
        for key, times in tally.failures.most_common():
            table.add_row(
                key, str(times), "; ".join(tally.kinds[key]), str(tally.numbers[key]), tally.kept.get(key, "")
            )
        console.print(table, markup=False)
    total, spent = sum(tally.done.values()), sum(tally.seconds.values())
    console.print(
        f"{total} inputs in {spent:.0f} CPU s ({1e3 * spent / max(total, 1):.1f} ms each), at most {most} MiB of memory:"
        f" {sum(tally.failures.values())} failures of {len(tally.failures)} kinds"
    )


def main(words: list[str] | None = None) -> int:
    """Run the bench; 1 if anything failed."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench fuzz", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=100000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=sorted({kind for kind, _ in SHARES}), help="kinds of inputs")
    parser.add_argument("--way", nargs="+", choices=(PROCESS, GMSH, COMMAND, FRESH), help="ways of reading them")
    parser.add_argument("--case", nargs="+", type=int, help="these inputs alone")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"))
    options = parser.parse_args(words)
    options.out = options.out.absolute()
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 200)
    options.out.mkdir(parents=True, exist_ok=True)
    mine = (options.out / "lock").open("w")
    try:
        fcntl.flock(mine, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        sys.exit(f"fuzz: another run uses {options.out}; give another --out")
    for name in ("cases", "base", *(f"box{k}" for k in range(options.jobs))):
        shutil.rmtree(options.out / name, ignore_errors=True)
    bases = Bases(options.out / "base")
    bases.make(lambda job: commands.forked(job)[0])
    tally, most = run_all(chosen(options), options, bases, console)
    tell(tally, most, console)
    return 1 if tally.failures else 0


if __name__ == "__main__":
    sys.exit(main())
