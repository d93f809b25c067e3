"""Laminar flow between parallel walls: mean cubed aperture of a tapered element, and the laws of its conductance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from fracflow.laws.base import INSTANT, Floats, History, LawStep, Parameter
from fracflow.laws.roughness import Roughness


def _walls(aperture_1: Parameter, aperture_2: Parameter) -> tuple[Floats, Floats]:
    """End apertures, those below zero taken as closed."""
    return np.maximum(np.asarray(aperture_1, dtype=float), 0.0), np.maximum(np.asarray(aperture_2, dtype=float), 0.0)


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
    """(3.4) integrated: 1 / mean(1/d^3) (n,) = 2 d1^2 d2^2 / (d1 + d2), exact where d is linear.

    Arguments and results as for ``report_mean_cube``; 0 with zero derivatives if either end is closed.
    """
    d1, d2 = _walls(aperture_1, aperture_2)
    total = d1 + d2
    divisor = np.where(total > 0.0, total, 1.0)
    share_1, share_2 = d1 / divisor, d2 / divisor
    mean = 2.0 * share_1 * d1 * d2 * d2
    slope_1 = 2.0 * share_1 * share_2 * d2 * (total + d2)
    slope_2 = 2.0 * share_1 * share_2 * d1 * (total + d1)
    return mean, slope_1, slope_2


def conductance(mean_cube: Parameter, length: Parameter, viscosity: Parameter) -> Floats:
    """(3.14a,e) Flow rate a unit of pressure difference drives: mean_cube / (12 mu L), per unit depth.

    mean_cube (n,) [length^3], length (n,) [length], viscosity [stress time]; result [length^2/(stress time)].
    """
    return np.asarray(np.asarray(mean_cube, dtype=float) / _resistance(length, viscosity))


def _resistance(length: Parameter, viscosity: Parameter) -> Floats:
    """The mean cube that drives no more than a unit: 12 mu L."""
    return np.asarray(12.0 * np.asarray(viscosity, dtype=float) * np.asarray(length, dtype=float))


@dataclass(frozen=True, eq=False)
class Conductance:
    """Conductances of n elements, flow rate per unit depth and pressure difference, and their derivatives.

    value       (n,) [length^2/(stress time)]
    by_opening  (n, 2) d value / d opening of either end [length/(stress time)]
    by_slip     (n, 2, dim-1) d value / d slip of either end; None of a law that does not know slip
    """

    value: Floats
    by_opening: Floats
    by_slip: Floats | None = None


@dataclass(frozen=True, eq=False)
class FlowLaw(ABC):
    """Frozen parameters, and a pure function of the walls at both ends of n elements.

    aperture                    (n, 2) d0, or the hydraulic aperture w_h0 where one is given [length]
    minimum_hydraulic_aperture  (n, 2) [length]
    length                      (n,) of the elements [length]
    viscosity                   [stress time]
    roughness                   by which ``Flow.conduct`` turns openings into hydraulic ones; None of walls without keys for it

    Parameters of its own, (n, 2), are declared with ``key``: tables of fractures have them, where the scene chooses the law.

    knows_slip  its conductance changes with slip
    reads       history variables of joint laws that it is given, by name
    """

    aperture: Floats
    minimum_hydraulic_aperture: Floats
    length: Floats
    viscosity: float
    roughness: Roughness | None = field(default=None, kw_only=True)

    knows_slip: ClassVar[bool] = False
    reads: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def conductance(self, opening: Floats, slip: Floats, history: History, step: LawStep = INSTANT) -> Conductance:
        """Conductances at openings (n, 2) and slips (n, 2, dim-1) beyond the initial state [length].

        history  name -> (n, 2) or (n, 2, dim-1), of the joint sections at that instant; NaN where their law has none
        step     the way there; ``dt`` 0 where an accepted state is looked at
        """


class CubicLaw(FlowLaw):
    """(3.4) The cubic law of a hydraulic aperture, by a mean over the element that ``mean_cube`` gives."""

    @staticmethod
    @abstractmethod
    def mean_cube(aperture_1: Parameter, aperture_2: Parameter) -> tuple[Floats, Floats, Floats]:
        """Mean of the cubed aperture [length^3] over elements of end apertures (n,), and its two derivatives (n,)."""

    def hydraulic(
        self, opening: Floats, slip: Floats, history: History, step: LawStep
    ) -> tuple[Floats, Floats, Floats | None]:
        """Hydraulic aperture (n, 2), its derivatives by opening (n, 2), and by slip (n, 2, dim-1) or None: d0 + opening."""
        mechanical = self.aperture + opening
        least = self.minimum_hydraulic_aperture
        return np.maximum(mechanical, least), (mechanical >= least).astype(float), None

    def conductance(self, opening: Floats, slip: Floats, history: History, step: LawStep = INSTANT) -> Conductance:
        """(3.14a,e) Mean cube over 12 mu L, of openings (n, 2); arguments and results as for ``FlowLaw``."""
        return self._between(*self.hydraulic(opening, slip, history, step))

    def _between(self, hydraulic: Floats, by_opening: Floats, by_slip: Floats | None) -> Conductance:
        """The same of hydraulic apertures (n, 2) and their derivatives."""
        slope = np.empty_like(hydraulic)
        mean, slope[:, 0], slope[:, 1] = self.mean_cube(hydraulic[:, 0], hydraulic[:, 1])
        slope /= self._resists[:, None]
        return Conductance(
            mean / self._resists, slope * by_opening, None if by_slip is None else slope[:, :, None] * by_slip
        )

    @cached_property
    def _resists(self) -> Floats:
        """12 mu L (n,), as ``conductance`` divides by it."""
        return _resistance(self.length, self.viscosity)


class ExactCubic(CubicLaw):
    """Exact two-node mean of the cubed aperture, where it is linear."""

    mean_cube = staticmethod(exact_mean_cube)


FRONT = 1.0 / 8.0
"""Share of d1^3 that an element lets through whose other end is shut, behind a front of opening: its middle's cube."""


class FrontCubic(ExactCubic):
    """The exact mean, and more where a front of opening is in the element: (2 d1^2 d2^2 + FRONT x^4)/(d1 + d2).

    Behind a front d goes as the power 2/3 of the distance to it (Desroches et al., 1994), and the place of the front in the
    element is not known. The mean of a line to the shut end would hold the front back until that end gapes all at once.
    Here x is what the openings of the ends differ by beyond the aperture at rest. Nothing is added where walls part by less,
    and next to nothing where the opening hardly changes along the element. Walls pressed into each other count as shut, so that
    x is no more than the wide end opened by. FRONT is the mean of the middle's d^3 over that of the wide end's, each over all
    places of the front in the element.
    """

    @cached_property
    def _rest(self) -> Floats:
        """Mean apertures (n,) at rest."""
        rest: Floats = self.aperture.mean(axis=1)
        return rest

    def conductance(self, opening: Floats, slip: Floats, history: History, step: LawStep = INSTANT) -> Conductance:
        """As for ``CubicLaw``, of openings (n, 2), with what a front lets through."""
        hydraulic, by_opening, by_slip = self.hydraulic(opening, slip, history, step)
        found, rest = self._between(hydraulic, by_opening, by_slip), self._rest
        apart = np.maximum(opening, -rest[:, None])
        parted = apart[:, 0] - apart[:, 1]
        beyond = np.abs(parted) - rest
        at = np.flatnonzero(beyond > 0.0)
        if not len(at):
            return found
        beyond, total, is_apart = beyond[at], hydraulic[at].sum(axis=1), opening[at] > -rest[at, None]
        front = FRONT * beyond**4 / total / self._resists[at]
        away = (4.0 * front * np.sign(parted[at]) / beyond)[:, None] * np.array([1.0, -1.0]) * is_apart
        narrower = (front / total)[:, None]
        found.value[at] += front
        found.by_opening[at] = found.by_opening[at] + away - narrower * by_opening[at]
        if by_slip is not None and found.by_slip is not None:
            found.by_slip[at] -= narrower[:, :, None] * by_slip[at]
        return found


class ReportCubic(CubicLaw):
    """(3.14f) The report's mean."""

    mean_cube = staticmethod(report_mean_cube)
