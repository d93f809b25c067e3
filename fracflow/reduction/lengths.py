"""Lengths and times that a mesh must resolve, from the numbers of a scene."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fracflow.mesh.data import Floats
from fracflow.scene.time_table import TimeTable

PER_TRIANGLE = 4.0 / 3.0**0.5  # cells of size h in an area h^2


def typical_length(lengths: Floats) -> float:
    """Mean of the lengths (n,) of fractures, each weighted by itself: of the ones that matter; inf of none [length]."""
    return float(np.sum(lengths**2) / np.sum(lengths)) if np.sum(lengths) > 0.0 else np.inf


def mean_spacing(area: float, length: float) -> float:
    """1/P21, area over the length of all fractures in it; inf without any (Dershowitz and Herda 1992) [length]."""
    return area / length if length > 0.0 else np.inf


def front_length(conducting: Floats, normal: Floats, held: Floats | float, time: float) -> Floats:
    """sqrt(D t), the reach of a pressure along a fracture: D = C/(1/k_n + c_f d), C = d^3/(12 mu) [length].

    The diffusivity of (3.9) with walls that move by k_n alone, which gives the shortest reach. All arrays are (n,).
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(conducting / (1.0 / normal + held) * time))


def corner_period(length: float, speed: float) -> float:
    """1/f_c of the waves that slip along a length sends out, f_c = 2.34 c_s/(2 pi r) for a radius r = L/2 (Brune 1970) [time].

    Their displacements have little of what is faster.
    """
    return np.pi * length / (2.34 * speed)


def shortest_period(tables: Iterable[TimeTable], start: float, end: float) -> float:
    """Period of the fastest swing of any table between two times; inf where all stand still, 0 where one jumps [time].

    Half of it is the time of a swing over the whole range at the steepest mean slope of a stretch that rises or falls.
    It is exact for a sine, and twice the length of a ramp. Small fast ripples count by their share of the range.
    """
    found = np.inf
    for table in tables:
        times, values = np.array(table.times), np.array(table.values)
        jumps = table.jumps[0]
        if np.any((jumps >= start) & (jumps < end)):
            return 0.0
        if table.interpolation == "step" or not np.ptp(values) > 0.0:
            continue
        turns = np.sign(np.diff(values))
        first = np.flatnonzero(np.append(True, turns[1:] != turns[:-1]))
        last = np.append(first[1:], len(turns))
        change, lasts = np.abs(values[last] - values[first]), times[last] - times[first]
        here = (change > 0.0) & (lasts > 0.0) & (times[first] < end) & (times[last] > start)
        found = min(found, (2.0 * np.ptp(values) * lasts[here] / change[here]).min(initial=np.inf))
    return float(found)


def cell_count(size: float, fine: float, area: float, length: float, growth: float) -> float:
    """Triangles of a mesh of ``size`` that is ``fine`` along fractures of a length, and grows from there: an upper estimate.

    Around a line, 2 L times the integral of 1/(h + g r)^2 is 2 L/(g h).
    """
    graded = area / size**2 + 2.0 * length / (growth * fine)
    return PER_TRIANGLE * min(graded, area / fine**2)


def affordable(size: float, fine: float, area: float, length: float, growth: float, most: float) -> tuple[float, float]:
    """Sizes that are at least so large that neither part of ``cell_count`` is over half of ``most``."""
    if cell_count(size, fine, area, length, growth) <= most:
        return size, fine
    share = 0.5 * most / PER_TRIANGLE
    fine = max(fine, min(2.0 * length / (growth * share), (area / share) ** 0.5))
    return max(size, (area / share) ** 0.5, fine), fine
