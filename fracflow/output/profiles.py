"""profiles.h5: pressure, aperture and plastic slip along the fractures at some hundred times of a run, for its report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.output.history import HistoryFile, read_history

FILE = "profiles.h5"
KEPT = ("pressure", "aperture", "plastic_slip")
MOST, FEWEST = 64, 8  # intervals of the time that has passed, each of which has a profile
LARGEST = 32 << 20  # bytes that the profiles of so many intervals may take


def intervals(ends: int) -> int:
    """Number of intervals for profiles with so many joint ends."""
    return int(np.clip(LARGEST // (8 * len(KEPT) * max(ends, 1)), FEWEST, MOST))


@dataclass
class Timetable:
    """When a profile is due: first in an interval, whose length is a power of two, and where the regime changes.

    The intervals lengthen as time passes, so that a run of N steps has about MOST (1 + log2(N/MOST)/2) profiles.

    rows  profiles so far
    time  of the last one
    kind  its regime, as ``step/kind`` has it
    """

    rows: int = 0
    time: float = 0.0
    kind: int = -1

    def is_due(self, time: float, kind: int, most: int = MOST) -> bool:
        """Whether the state at a time is to have one, at most about ``most`` in equal intervals."""
        if not self.rows or kind != self.kind:
            return True
        if time <= self.time:
            return False
        width = 2.0 ** math.ceil(math.log2(time / most))
        return math.floor(time / width) > math.floor(self.time / width)

    def add(self, time: float, kind: int) -> None:
        """Count a profile."""
        self.rows, self.time, self.kind = self.rows + 1, time, kind


class ProfileFile:
    """Writer of profiles.h5, a history whose rows are profiles. Rank 0 only."""

    def __init__(self, folder: Path, rows: int = 0) -> None:
        """Begin, or go on after so many rows. Rows that cannot be read are given up: no run goes on from them."""
        self.lost = ""
        try:
            self._file = HistoryFile.resume(folder / FILE, rows) if rows else HistoryFile(folder / FILE)
        except InputError as error:
            self.lost = f"{str(error).partition(';')[0]}: the profiles begin anew"
            (folder / FILE).unlink(missing_ok=True)
            self._file = HistoryFile(folder / FILE)

    def append(self, time: float, step: int, values: Mapping[str, NDArray[Any]]) -> None:
        """Add the profile of a state, from values at all joint ends (n, ...) in the order of the fields. Raises OSError."""
        if values:
            self._file.append({"time": time, "step": step, **values})

    def close(self) -> None:
        """Close the file with all rows in it. Raises OSError."""
        self._file.close()


def read_profiles(folder: Path) -> dict[str, NDArray[Any]]:
    """Profiles by name: time (k,), step (k,), fields (k, n, ...) at all joint ends; empty where there are none.

    Raises InputError for a file that is no history.
    """
    if not (folder / FILE).is_file():
        return {}
    found = read_history(folder / FILE)
    rows, step = len(found.get("time", ())), found.get("step", np.zeros(0))
    if rows and (step.ndim != 1 or step.dtype.kind != "i"):
        raise InputError(f"{folder / FILE}: has no steps; put back a copy of the file")
    return found if rows else {}
