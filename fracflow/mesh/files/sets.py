"""Sets of cells of a mesh file of another program, and the error of a file that is wrong."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

Set = tuple[str, int, NDArray[Any]]
"""Name, block, rows of its cells."""


class FileFault(ValueError):
    """A fault of a file, in a line of our own."""
