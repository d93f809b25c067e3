"""Laminar flow between parallel walls: mean cubed aperture of a tapered element, and its conductance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracflow.laws.base import Floats, Parameter

MeanCube = Callable[[Parameter, Parameter], tuple[Floats, Floats, Floats]]


def _walls(aperture_1: Parameter, aperture_2: Parameter) -> tuple[Floats, Floats]:
    """End apertures, those below zero taken as closed."""
    d1, d2 = np.broadcast_arrays(np.asarray(aperture_1, dtype=float), np.asarray(aperture_2, dtype=float))
    return np.maximum(d1, 0.0), np.maximum(d2, 0.0)


def report_mean_cube(aperture_1: Parameter, aperture_2: Parameter) -> tuple[Floats, Floats, Floats]:
    """(3.14f) The report's mean of d^3 over an element of linear aperture, and its two derivatives.

    aperture_1, aperture_2 (n,) end apertures [length], negative ones count as closed. Returns the mean
    [length^3], d mean / d aperture_1 and d mean / d aperture_2 [length^2]. An arithmetic mean: it conducts
    through a closed end.
    """
    d1, d2 = _walls(aperture_1, aperture_2)
    mean = (d1 + d2) * (d1**2 + d2**2) / 4.0
    slope_1 = (3.0 * d1**2 + 2.0 * d1 * d2 + d2**2) / 4.0
    slope_2 = (3.0 * d2**2 + 2.0 * d1 * d2 + d1**2) / 4.0
    return mean, np.where(d1 > 0.0, slope_1, 0.0), np.where(d2 > 0.0, slope_2, 0.0)


def exact_mean_cube(aperture_1: Parameter, aperture_2: Parameter) -> tuple[Floats, Floats, Floats]:
    """(3.4) integrated: 1 / mean(1/d^3) = 2 d1^2 d2^2 / (d1 + d2), exact where d is linear.

    Arguments and results as for ``report_mean_cube``; 0 with zero derivatives if either end is closed.
    """
    d1, d2 = _walls(aperture_1, aperture_2)
    total = d1 + d2
    share_1 = d1 / np.where(total > 0.0, total, 1.0)
    share_2 = d2 / np.where(total > 0.0, total, 1.0)
    mean = 2.0 * share_1 * d1 * d2 * d2
    slope_1 = 2.0 * share_1 * share_2 * d2 * (total + d2)
    slope_2 = 2.0 * share_1 * share_2 * d1 * (total + d1)
    return mean, slope_1, slope_2


MEANS: dict[str, MeanCube] = {"exact": exact_mean_cube, "report": report_mean_cube}


def conductance(mean_cube: Parameter, length: Parameter, viscosity: Parameter) -> Floats:
    """(3.14a,e) Flow rate a unit of pressure difference drives: mean_cube / (12 mu L), per unit depth.

    mean_cube (n,) [length^3], length (n,) [length], viscosity [stress time]; result [length^2/(stress time)].
    """
    resistance = 12.0 * np.asarray(viscosity, dtype=float) * np.asarray(length, dtype=float)
    result: Floats = np.asarray(mean_cube, dtype=float) / resistance
    return result
