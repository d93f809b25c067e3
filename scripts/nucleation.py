"""The onset of slip that grows by itself, by an eigenvalue program that shares nothing with fracflow.

A fault in an infinite body in plane strain whose strength (f_p - w d)(sigma - p(x, t)) falls linearly with its slip d
(Uenishi and Rice 2003, Garagash and Germanovich 2012). With x = a cos(phi) and d = sum of c_k sin(k phi), k odd, slip on
-a < x < a takes mu*/(2 a) sum of k c_k sin(k phi)/sin(phi) off its traction, mu* = mu/(1 - nu). At the onset that operator
and the falling strength have a common mode v, and what loads the fault does no work on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.optimize import brentq
from scipy.special import erfc

Floats = NDArray[np.float64]
Pressure = Callable[[Floats, float], Floats]
UNIFORM = 0.57888694  # a w sigma/mu* under a load that is the same everywhere


@dataclass(frozen=True)
class Fault:
    """A fault on which slip has come to D_c nowhere.

    modulus   mu* = mu/(1 - nu) [stress]
    shear     traction before any slip [stress]; ``normal`` sigma, pressure positive [stress]
    friction  f_p; ``falls`` is w, by how much it falls with slip [1/length]
    pressure  (x (n,), t) -> p (n,) [stress], even in x
    """

    modulus: float
    shear: float
    normal: float
    friction: float
    falls: float
    pressure: Pressure
    terms: int = 80

    def mode(self, half: float, time: float) -> tuple[float, Floats, Floats]:
        """Largest eigenvalue of falling strength over rock on a half-length; its slip (n,) at points x (n,) > 0."""
        odd, angle = 2.0 * np.arange(self.terms) + 1.0, np.pi * (np.arange(self.terms) + 0.5) / (2.0 * self.terms)
        x, slip = half * np.cos(angle), np.sin(np.outer(angle, odd))
        rock = self.modulus * odd * slip / (2.0 * half * np.sin(angle)[:, None])
        values, shapes = eig(self.falls * (self.normal - self.pressure(x, time))[:, None] * slip, rock)
        best = int(np.argmax(values.real))
        shape = slip @ shapes[:, best].real
        return float(values[best].real), shape * np.sign(shape.sum()), x

    def half_length(self, time: float, bracket: tuple[float, float]) -> float:
        """The half-length whose eigenvalue is 1."""
        return float(brentq(lambda half: self.mode(half, time)[0] - 1.0, *bracket))

    def work(self, time: float, bracket: tuple[float, float]) -> float:
        """Mean over the mode of traction less strength before any slip [stress]: below 0 until the onset."""
        half = self.half_length(time, bracket)
        _, shape, x = self.mode(half, time)
        weight = shape * np.sqrt(half**2 - x**2)  # dx = a sin(phi) d phi
        excess = self.shear - self.friction * (self.normal - self.pressure(x, time))
        return float(weight @ excess / weight.sum())

    def onset(self, times: tuple[float, float], bracket: tuple[float, float]) -> tuple[float, float]:
        """Time, between two, and half-length at which slip begins to grow by itself."""
        time = float(brentq(lambda time: self.work(time, bracket), *times))
        return time, self.half_length(time, bracket)


def of_a_well(pressure: float, diffusivity: float) -> Pressure:
    """Of a well at x = 0 that keeps its pressure from t = 0 on, while the fault drains to both sides."""
    return lambda x, time: pressure * erfc(np.abs(x) / np.sqrt(4.0 * diffusivity * time))
