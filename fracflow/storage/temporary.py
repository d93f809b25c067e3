"""Temporary folders. One whose process was killed is removed when a process on that machine makes the next of its kind."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

IN_USE = "in-use"  # a file in the folder: it names the machine, and the process that made the folder locks it
YOUNG = 60.0  # seconds in which a folder may have no lock yet


@contextmanager
def temporary_folder(kind: str) -> Iterator[Path]:
    """A folder of a kind, which goes as the block ends. Raises OSError."""
    prefix = f"fracflow-{kind}-"
    _remove_left(prefix)
    # what a process has started may write for a moment after it was ended
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name:
        folder = Path(name)
        with (folder / IN_USE).open("w", encoding="utf-8") as file:
            with suppress(OSError):  # where files have no locks, folders of the killed stay
                fcntl.flock(file, fcntl.LOCK_EX)
            file.write(os.uname().nodename)  # elsewhere the lock may not be seen
            file.flush()
            yield folder


def _remove_left(prefix: str) -> None:
    """Remove this user's folders of a kind that no process has a lock on."""
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError, UnicodeError):  # it is in use, without a lock, or gone by now
            found = folder.lstat()
            if found.st_uid == os.getuid() and time.time() - found.st_mtime > YOUNG:
                with (folder / IN_USE).open("r+", encoding="utf-8") as file:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if file.read() == os.uname().nodename:
                        shutil.rmtree(folder)
