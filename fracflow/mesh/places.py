"""Places as lines of a log have them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fracflow.mesh.data import Floats

ROUND_OFF = 1e-9  # of the extent of a mesh: smaller coordinates are zero


def extent_of(points: Floats) -> float:
    """The largest difference of coordinates of points (n, dim); 0 without any [length]."""
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


def place_without_round_off(place: Iterable[float], extent: float) -> tuple[float, ...]:
    """The coordinates of a place, zero where they are round-off of points of this ``extent`` [length]."""
    return tuple(0.0 if abs(value) < ROUND_OFF * extent else float(value) for value in place)


def place_text(place: Iterable[float], extent: float) -> str:
    """A place without round-off as text, of six digits."""
    return "(" + ", ".join(f"{value:.6g}" for value in place_without_round_off(place, extent)) + ")"
