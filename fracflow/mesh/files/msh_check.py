"""A .msh before a library reads it: that it is one, and that its counts fit into the file."""

from __future__ import annotations

import mmap
import re
from pathlib import Path
from typing import Literal

from fracflow.errors import InputError
from fracflow.storage.files import check_regular

LARGEST = 16 << 30  # bytes
SAVE = "save it with Mesh.MshFileVersion = 4.1"
AGAIN = "save it again from Gmsh"
LONGEST_LINE = 256
SECTION = re.compile(rb"\n\$(PhysicalNames|Nodes|Elements|Periodic)[ \t]*\r?\n")
LEAST = 4  # bytes that an entry of a section takes
Order = Literal["little", "big"]


def check_msh(path: Path) -> int:
    """The version of a .msh, 2 or 4. Raises InputError for a file that Gmsh would take for something else."""
    check_regular(path, "mesh.file names a Gmsh mesh", LARGEST)
    try:
        return _check(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; mesh.file names a Gmsh mesh") from None


def _check(path: Path) -> int:
    with path.open("rb") as file:
        # Gmsh takes a file with another first line for a program, whatever its name is.
        if file.readline(64).rstrip(b"\r\n") != b"$MeshFormat":
            raise InputError(f"{path}: is no Gmsh mesh of version 2 or 4; {SAVE}, $MeshFormat in its first line")
        found = re.fullmatch(rb"([24])(?:\.\d+)?[ \t]+([01])[ \t]+(\d+)[ \t]*\r?\n", file.readline(64))
        if found is None:
            raise InputError(f"{path}: is no Gmsh mesh of version 2 or 4; {SAVE}")
        version, is_binary = int(found[1]), found[2] == b"1"
        order: Order = "big" if is_binary and file.read(4) == b"\0\0\0\1" else "little"
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as whole:
            for section in SECTION.finditer(whole):
                at = section.end()
                if version == 4 and is_binary and section[1] != b"PhysicalNames":
                    count = _binary_count(whole[at : at + 16], section[1], order)
                else:
                    count = _count(whole[at : at + LONGEST_LINE], version)
                if count is None or count * LEAST > len(whole) - at:
                    stated = "no number of" if count is None else f"{count:.4g}"
                    name = section[1].decode()
                    why = f"${name} has {stated} entries, more than there is room for"
                    raise InputError(f"{path}: cannot be read as a Gmsh mesh: {why}; {AGAIN}")
    return version


def _count(found: bytes, version: int) -> int | None:
    """The most that a line of counts states: in version 4 of blocks and of entries, then come least and greatest number."""
    numbers = found.partition(b"\n")[0].split()[: 2 if version == 4 else 1]
    if not numbers or not all(re.fullmatch(rb"\d{1,18}", number) for number in numbers):
        return None
    return max(map(int, numbers))


def _binary_count(found: bytes, name: bytes, order: Order) -> int | None:
    """The same of a binary file; $Periodic has one number only."""
    places = (0,) if name == b"Periodic" else (0, 8)
    if len(found) < places[-1] + 8:
        return None
    return max(int.from_bytes(found[at : at + 8], order) for at in places)
