"""status.json: whether a run is under way, has ended, was stopped or has failed."""

from __future__ import annotations

import fcntl
import json
import os
from dataclasses import dataclass
from pathlib import Path

from fracflow.errors import InputError, Interrupted, SolveError
from fracflow.output.folder import MARKER, RunFolder
from fracflow.storage.files import open_own, read_text

RUNNING, ENDED, STOPPED, FAILED, CUT_OFF = "running", "ended", "stopped", "failed", "cut off"
FILE = "status.json"


@dataclass(frozen=True)
class Status:
    """Status of a run, and the message with which it stopped or failed.

    word  running, ended, stopped, failed, or cut off: killed before it could write it; empty where the folder has none
    """

    word: str = ""
    line: str = ""


def last_line(failure: Exception, folder: str | Path) -> str:
    """The message of what ended the run in a folder, with what to do."""
    if isinstance(failure, SolveError):
        return f"{failure}; what was reached is in {folder}: change its scene.toml, then: fracflow resume {folder}"
    return f"{failure}; go on with: fracflow resume {folder}" if isinstance(failure, Interrupted) else str(failure)


def write_status(folder: RunFolder, status: Status) -> None:
    """Put it in the place of the last one."""
    folder.write_json(FILE, {"status": status.word, "line": status.line})


def read_status(folder: str | Path) -> Status:
    """Present status of a folder's run; one marked as under way that no longer holds its folder was cut off."""
    try:
        found = json.loads(read_text(Path(folder) / FILE, "name a run folder"))
        word, line = str(found["status"]), str(found["line"])
    except (InputError, ValueError, KeyError, TypeError, RecursionError):
        return Status()
    return Status(CUT_OFF if word == RUNNING and not _is_held(Path(folder)) else word, line)


def _is_held(folder: Path) -> bool:
    try:
        with open(open_own(folder / MARKER, os.O_RDONLY), encoding="utf-8") as marker:
            fcntl.flock(marker, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (OSError, InputError):
        return True  # a file system without locks: it may be
    return False
