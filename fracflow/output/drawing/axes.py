"""The unit of an axis, chosen from the size of what it shows: days, MPa and mm where numbers are then easy to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.remarks import digits
from fracflow.scene.units import (
    ACCELERATION,
    DENSITY,
    ENERGY,
    ENERGY_DENSITY,
    FLOW_RATE,
    LENGTH,
    STIFFNESS,
    STRESS,
    SURFACE_ENERGY,
    TIME,
    TIME_LADDER,
    VELOCITY,
    VISCOSITY,
    VOLUME,
    stated_time,
    unit_text,
)

Floats = NDArray[np.float64]
Ladder = tuple[tuple[float, float, str], ...]

LINE_ROUND_OFF = 1e-8  # of the largest value: a line that varies less is constant
NARROW = 1e-2  # of the largest value: lines that span less are drawn as differences from a round number
_LEAST, _MOST = 5e-2, 1e4  # numbers that need no power of ten
_NONE = 1e-250  # smaller numbers are zero in a picture


def _metric(unit: str, *prefixes: str) -> Ladder:
    sizes = {"T": 1e12, "G": 1e9, "M": 1e6, "k": 1e3, "": 1.0, "c": 1e-2, "m": 1e-3, "µ": 1e-6, "n": 1e-9, "p": 1e-12}
    least = {"c": 0.1}
    return tuple((least.get(each, sizes[each]), sizes[each], each + unit) for each in prefixes)


_SI: dict[str, Ladder] = {
    LENGTH: ((1e4, 1e3, "km"), *_metric("m", "", "c", "m", "µ", "n", "p")),
    STRESS: (*_metric("Pa", "G", "M", "k"), (0.0, 1.0, "Pa")),
    ENERGY: _metric("J/m", "T", "G", "M", "k", "", "m"),
    SURFACE_ENERGY: _metric("J/m²", "G", "M", "k", "", "m"),
    ENERGY_DENSITY: _metric("J/m³", "G", "M", "k", "", "m"),
    VELOCITY: _metric("m/s", "", "m", "µ", "n"),
    ACCELERATION: _metric("m/s²", "", "m", "µ"),
    FLOW_RATE: ((1.0, 1.0, "m³/s"), (1e-4, 1e-3, "L/s"), (1e-7, 1e-6, "mL/s"), (0.0, 1e-9, "µL/s")),
    VOLUME: ((1.0, 1.0, "m³"), (1e-3, 1e-3, "L"), (1e-6, 1e-6, "mL")),
    DENSITY: ((0.0, 1.0, "kg/m³"),),
    VISCOSITY: ((0.5, 1.0, "Pa s"), (0.0, 1e-3, "mPa s")),
    STIFFNESS: ((1e8, 1e9, "GPa/m"), (1e5, 1e6, "MPa/m")),
}
"""Dimension -> sizes in SI from which on a unit is used, its size and its name; the largest first."""


@dataclass(frozen=True)
class Axis:
    """How the values of an axis are drawn: ``factor`` (value - ``reference``), in ``unit``.

    base         the reference with a unit, as the label has it; empty for none
    is_constant  whether no line varies by more than round-off
    noise        of a constant line: no value of it is larger than round-off, so that all are zero
    """

    factor: float = 1.0
    unit: str = ""
    reference: float = 0.0
    base: str = ""
    is_constant: bool = False
    noise: float = 0.0

    def __call__(self, values: ArrayLike) -> Floats:
        """Values as they are drawn; a constant line at its median."""
        drawn = self.factor * (np.asarray(values, dtype=float) - self.reference)
        drawn = np.where(np.abs(drawn) <= self.noise, 0.0, drawn) if self.noise else drawn
        known = drawn[np.isfinite(drawn)]
        return np.where(np.isfinite(drawn), np.median(known), drawn) if self.is_constant and known.size else drawn

    def label(self, word: str) -> str:
        """Label of the axis, with its unit, and the number that was taken off."""
        word = f"{word} less {self.base}" if self.base else word
        return f"{word} [{self.unit}]" if self.unit else word

    def text(self, value: float, digits: int = 4) -> str:
        """One value in the unit of the axis."""
        return f"{self.factor * value:.{digits}g} {self.unit}".rstrip()


def unit_for(dimension: str, largest: float, units: Mapping[str, str]) -> tuple[float, str]:
    """Factor and name of the unit that suits values up to ``largest``, which are in ``units``.

    Times of seconds, and all quantities of SI, have units of their own; others keep that of the scene. Where no unit suits,
    the name begins with a power of a thousand. The author's own unit of time goes before all.

    units  names of length, force and time, and as "shown_time" that of the author
    """
    factor, name = suited_unit(dimension, largest, units)
    size = factor * abs(largest) if np.isfinite(largest) and abs(largest) > _NONE else 0.0
    return _in_thousands(factor, name, size) if size else (factor, name)


def suited_unit(dimension: str, largest: float, units: Mapping[str, str]) -> tuple[float, str]:
    """The same without a power of a thousand, for numbers that have one of their own."""
    own, size = unit_text(dimension, units, is_printed=True), abs(largest)
    is_si = (units.get("length"), units.get("force"), units.get("time")) == ("m", "N", "s")
    ladder = _SI.get(dimension, ()) if is_si else ()
    if dimension == TIME and units.get("time") == "s":
        ladder = TIME_LADDER
    base = next((name for _, each, name in ladder if each == 1.0), own)
    if not _NONE < size < np.inf:
        return 1.0, base
    if dimension == TIME and (stated := stated_time(units.get("shown_time"), size)):
        return stated
    fits = ((1.0 / each, name) for least, each, name in ladder if size >= least * (1.0 - 1e-12))
    return next(fits, (1.0, base))


def _in_thousands(factor: float, unit: str, size: float) -> tuple[float, str]:
    """The unit with a power of ten, where numbers up to ``size`` need one."""
    if _LEAST <= size < _MOST:
        return factor, unit
    power = 3 * floor(log10(size) / 3.0)
    return factor * 10.0**-power, f"{power_of_ten(power)} {unit}".rstrip()


def power_of_ten(power: int) -> str:
    """10⁻⁶."""
    return "10" + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(sign)] if sign.isdigit() else "⁻" for sign in str(power))


def axis_of(dimension: str, lines: Sequence[ArrayLike], units: Mapping[str, str], noise: float = 0.0) -> Axis:
    """The axis of some lines, values of one dimension; those that are not finite are left out of account.

    units  names of length, force and time
    noise  what is smaller is round-off
    """
    known = [array[np.isfinite(array)] for array in (np.ravel(np.asarray(line, dtype=float)) for line in lines)]
    known = [array for array in known if array.size]
    largest = max((float(np.abs(array).max()) for array in known), default=0.0)
    if largest <= max(noise, _NONE):
        return Axis(1.0, unit_for(dimension, 0.0, units)[1], is_constant=True, noise=noise)
    if all(float(np.ptp(array)) <= max(LINE_ROUND_OFF * largest, noise) for array in known):
        return Axis(*unit_for(dimension, largest, units), is_constant=True)
    low, high = min(float(array.min()) for array in known), max(float(array.max()) for array in known)
    if high - low >= NARROW * largest:
        return Axis(*unit_for(dimension, largest, units))
    reference = _round_number(0.5 * low + 0.5 * high, high - low)
    factor, unit = unit_for(dimension, max(abs(low - reference), abs(high - reference)), units)
    return Axis(factor, unit, reference, shown(dimension, reference, units))


def shown(dimension: str, value: float, units: Mapping[str, str], count: int = 10) -> str:
    """A value in the unit that suits it, of so many digits: 0.24 s, 1 day, 5.17 days."""
    factor, unit = unit_for(dimension, value, units)
    if unit.startswith("10"):  # a number alone may do without a power of ten
        plain = f"{value:.{count}g}" if 1e-4 <= abs(value) < 1e6 else f"{factor * value:.{count}g}×{unit.split()[0]}"
        return f"{plain} {unit_text(dimension, units, is_printed=True)}".rstrip()
    number = digits(factor * value, count)
    return f"{number} {'day' if (number, unit) == ('1', 'days') else unit}".rstrip()


def _round_number(value: float, span: float) -> float:
    """A round number within some spans of a value."""
    step = 10.0 ** ceil(log10(span))
    return round(value / step) * step
