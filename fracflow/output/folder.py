"""The run folder: made, cleared of an earlier run, and written to so that a kill leaves whole files."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import secrets
from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from fracflow.errors import InputError
from fracflow.storage.files import fresh, no_plain_file, open_own, read_text, replacing

MARKER = ".fracflow"
_OWN_FILES = (
    "scene.toml",
    "mesh.h5",
    "event_mesh.h5",
    "history.h5",
    "history.h5.redo",
    "profiles.h5",
    "profiles.h5.redo",
    "events.csv",
    "plan.json",
    "status.json",
    "checkpoint.h5",
    "log.txt",
    "report.html",
    "*.xdmf",
    "fields.vtkhdf",
    "fields/*.h5",
    "pictures/*.png",
    "csv/*.csv",
)
_OWN_FOLDERS = ("fields", "pictures", "csv")
_UNFINISHED = ("*.part", *(f"{folder}/*.part" for folder in _OWN_FOLDERS))  # files that a kill left half written


def write_atomic(path: Path, text: str) -> None:
    """Write ``text`` aside and rename, so that ``path`` always holds a whole text. Raises OSError."""
    with replacing(path) as part:
        fresh(part).write_text(text, encoding="utf-8")


def to_json(value: Any, indent: int | None = None) -> str:
    """JSON of plain values, NumPy arrays and mappings; nan and inf become strings."""
    return json.dumps(_plain(value), indent=indent, ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    return str(value)


def step_of(file: Path, family: str = "") -> int | None:
    """Number of the step that a file has fields of, by its name; None for a file of anything else, or of another family."""
    found = re.fullmatch(rf"{re.escape(family) or '.+'}_([0-9]{{1,18}})", file.stem)
    return int(found[1]) if found else None


def check_own(path: Path, writes: bool = False) -> None:
    """Check that entries with our names in a run folder are files and folders, not links. Changes nothing.

    A folder may come from anybody: a link in it leads out of it, and a pipe or a device never ends. Raises InputError. Where
    something ``writes``, files that are changed in their place have no second name.
    """
    completed = [name for name in ("history.h5", "profiles.h5") if (path / f"{name}.redo").exists()]
    for file in [path / name for name in (MARKER, "log.txt", *completed)] if writes else ():
        if not file.is_symlink() and file.is_file() and file.stat().st_nlink > 1:
            raise InputError(no_plain_file(file))
    _check_entries(path, [MARKER, *(pattern for pattern in (*_OWN_FILES, *_UNFINISHED) if "/" not in pattern)])
    for name in _OWN_FOLDERS:
        folder = path / name
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise InputError(f"{folder}: is a link, or no folder; remove it, or name another folder")
        inside = [
            pattern.partition("/")[2] for pattern in (*_OWN_FILES, *_UNFINISHED) if pattern.startswith(f"{name}/")
        ]
        _check_entries(folder, inside)


def _check_entries(folder: Path, patterns: Sequence[str]) -> None:
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                is_own = any(fnmatchcase(entry.name, pattern) for pattern in patterns)
                if is_own and not entry.is_file(follow_symlinks=False):
                    raise InputError(no_plain_file(folder / entry.name))
    except (FileNotFoundError, NotADirectoryError):
        pass  # other checks report it


def check_folder(path: Path, resume: bool = False) -> None:
    """Check whether a run can be written to ``path``, changing nothing. Raises InputError as RunFolder does."""
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file; name a folder for the run")
        is_run = (path / MARKER).exists()
        if is_run:
            check_own(path, writes=True)
            _taken(path).close()
        if resume and not is_run:
            raise InputError(f"{path}: holds no run of fracflow; name the folder of an earlier run")
        if not is_run and path.exists() and any(path.iterdir()):
            raise InputError(f"{path}: holds files that are no run's; name a new or empty folder")
        above = next(each for each in (path.absolute(), *path.absolute().parents) if each.exists())
        if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
            raise InputError(f"{path}: cannot be made in {above}; name a folder to write to")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; name a folder to write to") from error


def holds(path: Path, scene: str) -> bool:
    """Whether the scene.toml of a run folder has the text of a ``scene``."""
    try:
        return read_text(path / "scene.toml", "name a run folder") == scene
    except InputError:
        return False


def _taken(path: Path) -> TextIO:
    """The marker of a run folder, made and locked until it is closed. Raises InputError where another run holds it."""
    marker = open(open_own(path / MARKER, os.O_RDWR | os.O_APPEND | os.O_CREAT), "a+", encoding="utf-8")
    try:
        fcntl.flock(marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        marker.seek(0)
        owner = marker.read().strip().rpartition("process ")[2] or "another"
        marker.close()
        raise InputError(
            f"{path}: a run is under way there (process {owner}); wait for its end, or name another folder"
        ) from None
    except OSError:
        pass  # a file system without locks
    return marker


class RunFolder:
    """The folder of one run.

    path    a new or empty folder, or the folder of an earlier run: that run's own files are removed,
            any other file stays
    scene   text of scene.toml: where it is there already, it stays with its mesh, so that a kill leaves what to go on with
    resume  keep the earlier run's files, but for half written ones, and go on

    Until it is closed no other run may have the folder. Raises InputError if ``path`` is a file, if it holds files but no run
    of fracflow, or with ``resume`` no run at all. Likewise if another run is under way in it.
    """

    def __init__(self, path: str | Path, resume: bool = False, scene: str | None = None) -> None:
        self.path, self.unlogged = Path(path), 0
        check_folder(self.path, resume)
        try:
            self._prepare(resume, scene)
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}; name a folder to write to") from error

    def _prepare(self, keep: bool, scene: str | None) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        self._marker = _taken(self.path)
        self._marker.truncate(0)
        self._mark = f"run folder of fracflow, run {secrets.token_hex(4)}, last written to by process {os.getpid()}\n"
        self._marker.write(self._mark)
        self._marker.flush()
        is_same = scene is not None and holds(self.path, scene)
        own = [name for name in _OWN_FILES if not (is_same and name in ("scene.toml", "mesh.h5"))]
        for pattern in _UNFINISHED if keep else (*_UNFINISHED, *own):
            for file in self.path.glob(pattern):
                file.unlink()
        if not keep:
            for name in _OWN_FOLDERS:
                folder = self.path / name
                if folder.is_dir() and not any(folder.iterdir()):
                    folder.rmdir()

    def check(self, is_thorough: bool = False) -> None:
        """Raise OSError where the folder is no more the one that the run began in.

        is_thorough   or where another run has taken it, on a file system without locks
        """
        held, there = os.fstat(self._marker.fileno()), os.stat(self.path / MARKER)
        if (held.st_dev, held.st_ino) != (there.st_dev, there.st_ino):
            raise OSError(
                errno.ESTALE, "another folder was put in its place while the run was under way", str(self.path)
            )
        if is_thorough and (self.path / MARKER).read_text(encoding="utf-8") != self._mark:
            raise OSError(errno.EBUSY, "another run has taken the folder", str(self.path))

    def close(self) -> None:
        """Let other runs have the folder."""
        self._marker.close()

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def write_text(self, name: str, text: str) -> Path:
        """Write a whole text file at once and return its path."""
        write_atomic(self.path / name, text)
        return self.path / name

    def write_json(self, name: str, value: Any) -> Path:
        """Write ``value`` (plain, NumPy, mappings) as indented JSON."""
        return self.write_text(name, to_json(value, indent=2) + "\n")

    def write_plan(self, plan: Any) -> Path:
        """Write the decision record of the run: ``plan.json``."""
        return self.write_json("plan.json", plan)

    def log_bytes(self) -> int:
        """Length of ``log.txt``."""
        path = self.path / "log.txt"
        return path.stat().st_size if path.exists() else 0

    def cut_back(self, steps: int, log_bytes: int, every: int, kept: Collection[int] = ()) -> None:
        """Remove fields and lines of the log after so many steps and bytes; those of the steps ``kept`` stay.

        ``every`` is the number of steps from one file of fields to the next, 0 for the first step's alone. Another file was
        left where an earlier run ended.
        """
        for file in (self.path / "fields").glob("*.h5"):
            number = step_of(file)
            if number is not None and (
                number >= steps or (number not in kept and (number % every if every else number))
            ):
                file.unlink()
        if self.log_bytes() > log_bytes:
            number = open_own(self.path / "log.txt", os.O_WRONLY)
            os.ftruncate(number, log_bytes)
            os.close(number)

    def log(self, line: str) -> None:
        """Append one line to ``log.txt``; it is on disk when this returns, or counted as ``unlogged``."""
        try:
            number = open_own(self.path / "log.txt", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
            with open(number, "a", encoding="utf-8") as file:
                file.write(line.rstrip("\n") + "\n")
        except (OSError, InputError):  # a disk that is full, a link that somebody has put there
            self.unlogged += 1
