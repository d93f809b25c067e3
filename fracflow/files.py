"""Files that strangers give: regular ones of a bounded size, looked at before they are opened."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from fracflow.errors import InputError

LARGEST = 64 << 20  # bytes of a text: a scene, a table, a list of traces
CHUNK = 1 << 20


def read_bytes(path: Path, remedy: str, largest: int = LARGEST) -> bytes:
    """All bytes of a regular file. Raises InputError, with the remedy, where there is none or it is larger."""
    try:
        # a pipe without a writer would hold an open for ever
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _check(path, os.fstat(file.fileno()), remedy, largest)
            found = bytearray()  # grown with what is read: a limit is no size to make room for
            while len(found) <= largest and (part := file.read(min(CHUNK, largest + 1 - len(found)))):
                found += part
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {remedy}") from None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}; {remedy}") from None
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
    try:
        _check(path, os.stat(path), remedy, largest)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {remedy}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}; {remedy}") from None


def _check(path: Path, found: os.stat_result, remedy: str, largest: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is no regular file (a folder, pipe or device); {remedy}")
    if found.st_size > largest:
        raise InputError(_too_large(path, largest, remedy))


def _too_large(path: Path, largest: int, remedy: str) -> str:
    return f"{path}: has more than {largest >> 20} MiB; {remedy}"
