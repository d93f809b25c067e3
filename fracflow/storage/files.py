"""Files that strangers give: regular ones of a bounded size, looked at before they are opened; and our own, never links."""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fracflow.errors import InputError

# Line ends and NUL have no place in names, of files least of all; other controls and marks of direction steer terminals.
_CONTROLS = r"\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069"
PLAIN_TEXT = f"[^{_CONTROLS}]+"
_STEERS = re.compile(f"[{_CONTROLS}]")
LARGEST = 64 << 20  # bytes of a text, where whoever reads it states no less
CHUNK = 1 << 20


def read_bytes(path: Path, remedy: str, largest: int = LARGEST) -> bytes:
    """All bytes of a regular file. Raises InputError, with the remedy, where there is none or it is larger."""
    # a pipe without a writer would hold an open for ever
    with _looked_at(path, remedy), open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        _check(path, os.fstat(file.fileno()), remedy, largest)
        found = bytearray()  # grown with what is read: a limit is no size to make room for
        while len(found) <= largest and (part := file.read(min(CHUNK, largest + 1 - len(found)))):
            found += part
    if len(found) > largest:  # it grew since
        raise InputError(_too_large(path, largest, remedy))
    return bytes(found)


def read_text(path: Path, remedy: str, largest: int = LARGEST) -> str:
    """The text of a regular file in UTF-8, with a mark of its order or without. Raises InputError as read_bytes does."""
    try:
        return read_bytes(path, remedy, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}; save it as UTF-8") from None


def check_regular(path: Path, remedy: str, largest: int) -> None:
    """Look at a file that a library will open by its name. Raises InputError as read_bytes does."""
    with _looked_at(path, remedy):
        _check(path, os.stat(path), remedy, largest)


@contextmanager
def _looked_at(path: Path, remedy: str) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {remedy}") from None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}; {remedy}") from None


def steers(text: str) -> bool:
    """Whether a name has characters that a terminal would take for commands."""
    return _STEERS.search(text) is not None


def shown_plain(text: str) -> str:
    """A text as a terminal may show it: such characters are question marks, and all others that it has no shape for."""
    return "".join(char if char.isprintable() else "?" for char in text)


def fresh(path: Path) -> Path:
    """An empty file in the place of whatever has its name: a link there is taken away and not followed. Raises OSError."""
    os.close(open_fresh(path))
    return path


def part_of(path: Path) -> Path:
    """Where a file is written before it takes its place."""
    return path.with_name(path.name + ".part")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Where to write what then takes the place of ``path``, whole; nothing of it stays if an error comes. Raises OSError."""
    part = part_of(path)
    try:
        yield part
        os.replace(part, path)
    except BaseException as error:
        with suppress(OSError):
            part.unlink()
        if isinstance(error, OSError) and error.filename in (None, str(part), part):
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


def open_fresh(path: Path) -> int:
    """A descriptor, to read and write, of such an empty file. Raises OSError."""
    path.unlink(missing_ok=True)
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)


def create_text(path: Path, text: str) -> None:
    """Write a text into a file that is new. Raises FileExistsError for one that is there, or a link, and OSError."""
    number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    with open(number, "w", encoding="utf-8") as file:
        file.write(text)


def open_own(path: Path, flags: int) -> int:
    """A descriptor of a file that is changed in its place: regular, no link, without a second name.

    flags  as of ``os.open``

    Raises InputError for anything else, which could be a way to a file elsewhere, and OSError.
    """
    try:
        number = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO, errno.EISDIR):
            raise InputError(no_plain_file(path)) from None
        raise
    found = os.fstat(number)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
        os.close(number)
        raise InputError(no_plain_file(path))
    return number


def no_plain_file(path: Path) -> str:
    """Say that an entry of a run folder is no file, or one that is known by another name too."""
    return f"{path}: is a link, or no file: it leads out of the folder; remove it, or name another folder"


def _check(path: Path, found: os.stat_result, remedy: str, largest: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is no regular file (a folder, pipe or device); {remedy}")
    if found.st_size > largest:
        raise InputError(_too_large(path, largest, remedy))


def _too_large(path: Path, largest: int, remedy: str) -> str:
    return f"{path}: has more than {largest >> 20} MiB; {remedy}"
