"""Laws of what acts on sides of the rock from outside, or leaves its fractures: frozen parameters, pure functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from fracflow.laws.base import Floats


@dataclass(frozen=True)
class Leakage:
    """Fluid that leaves a fracture through both walls together, per area of it.

    rate         (n,) [length/time]
    by_pressure  (n,) its derivative by the pressure [length/(time stress)]
    by_aperture  (n,) its derivative by the aperture [1/time]
    """

    rate: Floats
    by_pressure: Floats
    by_aperture: Floats


class TermLaw(Protocol):
    """The table of a scene that its name in ``TERM_LAWS`` is the key of; its parameters are declared with ``key``.

    A law that inherits the bodies here has no effect; the first line of its own docstring names its effect.

    places  that the names of the table's ``on`` are of
    entry   of the energy balance for the work on it; an entry of work done by it begins with "work_"
    """

    places: ClassVar[Literal["sides", "fractures"]]
    entry: ClassVar[str]

    def stiffness(self, dim: int) -> Floats | None:
        """Traction against a displacement, (dim, dim) along and, last, across a side [stress/length]."""
        return None

    def damping(self, dim: int) -> Floats | None:
        """Traction against a velocity where there is inertia, (dim, dim) as for ``stiffness`` [stress time/length]."""
        return None

    def leakage(self, pressure: Floats, aperture: Floats) -> Leakage | None:
        """Leakage from a fracture at pressures (n,) [stress] and apertures (n,) [length]."""
        return None
