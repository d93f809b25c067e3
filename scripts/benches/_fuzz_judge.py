"""Faults of a case: it raises, crashes, hangs, takes memory, leaves marks outside, or prints other than one useful line."""

from __future__ import annotations

import hashlib
import os
import re
import resource
import shutil
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from fracflow import errors

PACKAGE = str(Path(__file__).parents[2] / "fracflow")
HANGS = 30.0  # [s]
MEMORY = 1 << 30  # bytes above what the program itself takes
LONGEST = 1600  # characters of a message
REMEDY = re.compile(
    r";|\bmust\b|\ballowed\b|did you mean|needs? |\bgive |\bchoose |\bsuch as\b|\blower\b|\braise\b|\bshould be\b|there are: "
)
NUMPY = re.compile(
    r"encountered in|Warning\b|deprecated|divide by zero|casting|overflow|HDF5-DIAG|Traceback|\[\d+\]PETSC ERROR"
)
ENDS = tuple(
    each
    for each in vars(errors).values()
    if isinstance(each, type) and issubclass(each, Exception) and each is not errors.ReductionInvalid
)


class Hang(BaseException):
    """More than HANGS seconds went by."""


@dataclass
class Found:
    """A failure: ``key`` is the same for all of one cause, ``detail`` shows this one."""

    key: str
    detail: str = ""


@dataclass
class Box:
    """The place of a case, with things around it that must stay as they are.

    root     everything of one worker
    case     the folder a case may write to
    outside  canaries
    """

    root: Path
    case: Path = field(init=False)
    outside: Path = field(init=False)
    log: Path = field(init=False)

    def __post_init__(self) -> None:
        """Lay out canaries."""
        self.case, self.outside, self.log = self.root / "work" / "case", self.root / "outside", self.root / "log"
        self.case.mkdir(parents=True, exist_ok=True)
        self.outside.mkdir(exist_ok=True)
        (self.outside / "canary").write_text("alive\n")
        (self.outside / "danger.geo").write_text(f'SystemCall "touch {self.outside}/hit";\n')
        (self.case.parent / "danger.geo").write_text(f'SystemCall "touch {self.outside}/hit";\n')
        self.before = self.look()

    def look(self) -> dict[str, tuple[int, int, int]]:
        """Size, time and number of every file around the case."""
        found = {}
        for folder in (self.outside, self.case.parent):
            for entry in os.scandir(folder):
                if entry.path != str(self.case):
                    status = entry.stat(follow_symlinks=False)
                    found[entry.path] = (status.st_size, status.st_mtime_ns, status.st_ino)
        return found

    def marks(self) -> list[Found]:
        """Changes around the case since the last look; they are put right."""
        now = self.look()
        odd = sorted(path for path in now.keys() | self.before.keys() if now.get(path) != self.before.get(path))
        if not odd:
            return []
        for path in odd:
            if path not in self.before and Path(path).is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path not in self.before:
                Path(path).unlink(missing_ok=True)
        self.__post_init__()
        return [Found("wrote outside its folder", ", ".join(odd))]


def snapshot(folder: Path) -> dict[str, str]:
    """A hash of every file of a folder, links and pipes by what they are."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"link to {os.readlink(path)}"
        elif path.is_file():
            found[name] = hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()
        elif not path.is_dir():
            found[name] = "special"
    return found


def of_message(text: str) -> list[Found]:
    """Faults of the message of an error."""
    bare = re.sub(r'"[^"]*"|\([^)]*\)|[-+]?\d[\d.]*(?:e[-+]?\d+)?', "#", text.split(": ")[-1])[:60]
    found = []
    if "\n" in text or "\r" in text:
        found.append(Found(f"message of more than one line: {bare}", text))
    if len(text) > LONGEST:
        found.append(Found(f"message over {LONGEST} characters: {bare}", text[:2000]))
    if not REMEDY.search(text):
        found.append(Found(f"message without a remedy: {bare}", text))
    return found


def of_error(error: BaseException) -> Found:
    """An error that nobody should see, by its kind and the place in the program."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename.startswith(PACKAGE)] or frames[-1:]
    place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
    lines = traceback.format_exception(error)
    return Found(f"{type(error).__name__} at {place}", "".join(lines)[-3000:])


@contextmanager
def alarmed(seconds: float) -> Iterator[None]:
    """Raise Hang inside when the time is over, if Python gets to run at all."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def peak() -> int:
    """Bytes of memory that this process has had at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def bounded(more: int = MEMORY) -> None:
    """Let this process have so many bytes more than it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more, hard))


def inside(job: Callable[[], object], log: Path) -> tuple[str, list[Found]]:
    """Do a job in this process: its ending in a word, and what is wrong with it. ``log`` is where 1 and 2 are written to."""
    found: list[Found] = []
    ending, said = "accepted", os.stat(log).st_size
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            with alarmed(HANGS):
                job()
        except ENDS as error:
            ending = "refused"
            found += of_message(str(error))
        except Hang as error:
            ending = "hang"
            found.append(Found(f"hang, {of_error(error).key}", of_error(error).detail))
        except (Exception, SystemExit) as error:
            ending = "failed"
            found.append(of_error(error))
    found += [
        Found(f"{w.category.__name__} at {Path(w.filename).name}:{w.lineno}: {str(w.message)[:60]}", str(w.message))
        for w in caught
        if w.category is not UserWarning
    ]
    if os.stat(log).st_size > said:
        with log.open("rb") as file:
            file.seek(said)
            text = file.read(2000).decode("utf-8", "replace")
        found.append(Found(f"printed: {re.sub(r'[0-9]+', '#', text)[:60].strip()}", text))
    return ending, found


def of_command(code: int, out: str, err: str) -> list[Found]:
    """Faults of the result of a command: its exit code (negative: a signal) and its output."""
    lines = [line for line in err.splitlines() if line.strip()]
    said = [line for line in lines if not line.startswith("note: ")]
    odd = [line for line in lines if NUMPY.search(line)]
    found = []
    if code not in (0, 2, 3):
        last = re.sub(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", "#", said[-1])[:80] if said else ""
        own = [line for line in lines if "fracflow/" in line and "line" in line]
        place = re.sub(r'.*fracflow/([\w/]+\.py)", line (\d+).*', r"\1:\2", own[-1]) if own else ""
        found.append(Found(f"exit code {code}: {last} at {place}", err[-3000:]))
    elif code in (2, 3):
        if len(said) != 1 or not said[0].startswith("fracflow: "):
            found.append(Found(f"exit code {code} with {len(said)} lines on stderr", err[-3000:]))
        else:
            found += of_message(said[0])
    elif said:
        found.append(Found(f"exit code 0 with stderr: {re.sub(r'[0-9.]+', '#', said[0])[:60]}", err[-3000:]))
    if odd and code in (0, 2, 3):
        found.append(Found(f"stderr: {re.sub(r'[0-9.]+', '#', odd[0])[:80]}", err[-3000:]))
    if strange := [c for c in out + err if not c.isprintable() and c not in "\n\t"]:
        found.append(Found(f"output holds {strange[0]!r}", out[-1000:] + err[-1000:]))
    return found
