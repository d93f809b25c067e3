"""A Python process of its own beside a rank, and a temporary folder for it.

It is no rank itself, and ends with the process that waits for it. A folder whose process was killed goes when a process on that
machine makes the next of its kind.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

OF_RANKS = ("OMPI_", "PMIX_", "PMI_", "SLURM_")  # a process that they name would be taken for a rank
ALONE = {"OPENBLAS_NUM_THREADS": "1", "HDF5_USE_FILE_LOCKING": "FALSE"}
LONGEST_REPORT = 4096
PACKAGE_PARENT = Path(__file__).resolve().parents[2]
PR_SET_PDEATHSIG = 1  # of prctl
IN_USE = "in-use"  # a file in the folder: it names the machine, and the process that made the folder locks it
YOUNG = 60.0  # seconds in which a folder may have no lock yet


def environment() -> dict[str, str]:
    """The variables of this process, without those that make it a rank."""
    return {name: value for name, value in os.environ.items() if not name.startswith(OF_RANKS)} | ALONE


def run_module(module: str, words: Sequence[str], folder: Path, wall: float | None = None) -> tuple[int | None, str]:
    """Run a module of fracflow in a folder, said.txt beside it: its exit code, None after ``wall`` s, and what it said last.

    Its temporary files lie in that folder too. Whatever ends this process, or the wait, ends the module and all that it
    started. Raises OSError where it cannot start.
    """
    paths = [str(PACKAGE_PARENT), *filter(None, [os.environ.get("PYTHONPATH")])]
    with (folder / "said.txt").open("wb") as said:
        worker = subprocess.Popen(
            [sys.executable, "-m", module, *words],
            cwd=folder,
            env=environment() | {"PYTHONPATH": os.pathsep.join(paths), "TMPDIR": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )
        code: int | None = None
        try:
            code = worker.wait(wall)
        except subprocess.TimeoutExpired:
            pass
        finally:
            if worker.returncode is None:
                os.killpg(worker.pid, signal.SIGKILL)
                worker.wait()
    with (folder / "said.txt").open("rb") as read:
        read.seek(max(0, (folder / "said.txt").stat().st_size - LONGEST_REPORT))
        return code, read.read().decode("utf-8", "replace")


def end_with(parent: int) -> None:
    """Let the system end this process when its parent ends, or now where that is another by now."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            sys.exit(1)


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
