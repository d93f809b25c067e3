"""Statistics of an event catalogue: frequency of magnitudes, bound of the moment, front of the distances."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

BIN = 0.1  # of magnitudes
FEWEST = 10  # events of a fit
COVERED = 0.95  # share of the events behind the front


@dataclass(frozen=True)
class GutenbergRichter:
    """log10 N = a - b M, where N events have at least the magnitude M.

    b, error      (Aki 1965, Utsu 1965) and its standard error (Shi and Bolt 1982)
    a             so that the line gives ``count`` at ``completeness``
    completeness  smallest magnitude of the fit
    count         events of at least this magnitude
    """

    b: float
    error: float
    a: float
    completeness: float
    count: int

    def number(self, magnitude: float) -> float:
        """Events of at least a magnitude by the fit."""
        return float(10.0 ** (self.a - self.b * magnitude))


def completeness(magnitudes: ArrayLike, width: float = BIN) -> float:
    """(Wiemer and Wyss 2000) Magnitude of completeness by maximum curvature: the lower edge of the fullest bin.

    magnitudes  (n,), at least one
    width       of the bins, whose edges are its multiples; of two that are as full the lower one counts
    """
    bins, counts = np.unique(np.floor(np.asarray(magnitudes, dtype=float) / width + 1e-9), return_counts=True)
    return float(bins[int(np.argmax(counts))] * width)


def gutenberg_richter(magnitudes: ArrayLike, width: float = BIN) -> GutenbergRichter | None:
    """The b = log10(e)/(mean M - M_c) of the magnitudes (n,) above completeness; None below ten, or all the same.

    The magnitudes are not rounded, so M_c is the lower edge of its bin without Utsu's half bin.
    """
    values = np.asarray(magnitudes, dtype=float)
    values = values[np.isfinite(values)]
    if len(values) < FEWEST:
        return None
    least = completeness(values, width)
    above = values[values >= least - 1e-9 * width]
    excess = float(above.mean() - least)
    if len(above) < FEWEST or excess <= 0.0:
        return None
    b = math.log10(math.e) / excess
    spread = float(((above - above.mean()) ** 2).sum()) / (len(above) * (len(above) - 1))
    error = math.log(10.0) * b**2 * math.sqrt(spread)
    return GutenbergRichter(b, error, math.log10(len(above)) + b * least, least, len(above))


def largest_moment(shear_modulus: float, volume: ArrayLike) -> NDArray[np.float64]:
    """(McGarr 2014) Bound G dV of the largest moment (n,) [force length] after net injected volumes dV (n,) [length^3]."""
    return shear_modulus * np.maximum(np.asarray(volume, dtype=float), 0.0)


def front_diffusivity(distance: ArrayLike, time: ArrayLike) -> float | None:
    """(Shapiro et al. 1997) D of the front r = sqrt(4 pi D t) behind which 95 % of the events lie [length^2/time].

    distance  (n,) of the events from the well [length]
    time      (n,) since injection began [time]

    None where the events give none: fewer than ten, or distances whose rank does not rise with that of time by twice
    its standard error.
    """
    r, t = np.asarray(distance, dtype=float), np.asarray(time, dtype=float)
    used = np.isfinite(r) & np.isfinite(t) & (t > 0.0)
    r, t = r[used], t[used]
    if len(r) < FEWEST or np.ptp(r) == 0.0 or np.ptp(t) == 0.0:
        return None
    correlation = float(np.corrcoef(_ranks(r), _ranks(t))[0, 1])
    if correlation * math.sqrt(len(r) - 1) < 2.0:
        return None
    return float(np.quantile(r**2 / (4.0 * math.pi * t), COVERED))


def _ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks (n,), equal values sharing their mean."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return np.asarray((last - 0.5 * (counts - 1))[inverse], dtype=float)
