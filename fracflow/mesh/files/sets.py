"""Parts of a mesh file as the worker reads it, and the error of a file that is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

DIMS = {"point": 0, "line": 1, "triangle": 2, "quad": 2}
CORNERS = {"point": 1, "line": 2, "triangle": 3, "quad": 4}

Rows = NDArray[np.int64]
Found = tuple[NDArray[Any], dict[str, list[Rows]], dict[str, list[Rows]], list[str], list[tuple[int, int, str]]]
"""Points, nodes and members of each kind of element, other types, and tag, dimension and name of the groups."""

Set = tuple[str, int, NDArray[Any]]
"""Name, block, rows of its cells."""


class FileFault(ValueError):
    """A fault of a file, in a line of our own."""
