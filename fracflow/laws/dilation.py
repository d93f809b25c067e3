"""Dilation: rough walls that slip ride up on each other, until they are worn. It goes around any law of friction."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from fracflow.laws.base import (
    INSTANT,
    Bools,
    Floats,
    History,
    HistoryVariable,
    JointLaw,
    JointResponse,
    LawStep,
    Parameter,
    per_section,
)

DILATION = HistoryVariable(
    "scalar", "length", "opening that slip has brought", published=False
)  # output has it as dilation
RIDDEN = HistoryVariable("scalar", "length", "length of the path of plastic slip in contact", published=False)
APART = HistoryVariable("scalar", "1", "1 where the walls are apart, else 0", published=False)
MOST = 100  # iterations of a section
SHARP = 4.0 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Dilatant(JointLaw):
    """(2.11) of the opening less that by dilation u, with the friction of another law.

    law       of friction; its history has ``plastic_slip``, and f_s = f_s0 + k_s (eps_s - plastic slip) while walls touch
    slope     tan psi of walls that have not slipped, >= 0
    distance  d, slip after which they ride up no further [length], > 0; any where the slope is 0

    u(s) = tan psi int_0^s (1 - s'/d) ds' up to s = d, and u(d) beyond. s is the length of the path of plastic slip: walls
    that slip back do not fit again. In contact only; what open walls move by does not count. A parabola is the integral of
    the angle's tangent that falls linearly, where codes of blocks let it end at once (UDEC's limiting shear displacement).
    Dilation here follows slip, as that of Rudnicki and Chen (1988). That of Segall and Rice (1995) follows the slip rate.

    A slip of ds opens by du: the normal traction is that of eps_n - u - du, and the strength follows it. The law of friction
    is evaluated at an opening by dilation that its own slip brings about, found section by section. The more the walls ride
    up, the less they slip: there is one such opening, and Newton's method has it between two bounds.

    Walls in contact ride up while they move apart. A section parts once it moves apart by more than slip without any
    strength lifts it, so that its traction falls to zero continuously. Walls that have parted touch again at u.

    History: that of the law, ``dilation`` u [length], ``ridden`` s [length], and ``apart``, 1 where the walls have parted.
    """

    law: JointLaw
    slope: Parameter
    distance: Parameter

    def __post_init__(self) -> None:
        """Show the history and the kind of the law of friction as its own."""
        for name in ("status", "passes_over", "slides", "opens", "creeps", "weakens_over", "no_drop"):
            object.__setattr__(self, name, getattr(self.law, name))
        object.__setattr__(
            self, "history", {**self.law.history, "dilation": DILATION, "ridden": RIDDEN, "apart": APART}
        )

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """Response to strain (n, dim) after ``history``, at most one change of status: by the strength before it dilates."""
        before = history["dilation"]
        opening, first = self._touching(strain, history, step)
        response = first
        latched = {**history, **{name: first.history[name] for name in self.status}}
        held = replace(step, hold=True)
        slip, by_strain = self._slip(first, history)
        gained, grade = self._gained(history["ridden"], slip)
        left = (opening - before) - gained
        low, high = np.minimum(opening, before + gained), np.maximum(opening, before + gained)
        moves = wanted = gained != 0.0
        for _ in range(MOST):
            if not wanted.any():
                break
            next_one = opening - left / (1.0 + grade * by_strain[:, -1])
            inside = (next_one > low) & (next_one < high)
            opening = np.where(wanted, np.where(inside, next_one, 0.5 * (low + high)), opening)
            response = self.law.evaluate(_less(strain, opening), latched, held)
            slip, by_strain = self._slip(response, history)
            gained, grade = self._gained(history["ridden"], slip)
            left = opening - (before + gained)
            low, high = np.where(left < 0.0, opening, low), np.where(left > 0.0, opening, high)
            moved = np.abs(strain[:, :-1]) + np.abs(response.inelastic[:, :-1])
            moved += np.abs(response.traction[:, :-1]) / per_section(self.shear_stiffness, len(strain))[:, None]
            wanted = wanted & (np.abs(left) > SHARP * (np.abs(opening) + grade * moved.sum(axis=1)))
            wanted &= high - low > SHARP * np.abs(opening)
        response = _either(moves, response, first)
        slip, by_strain = self._slip(response, history)
        _, grade = self._gained(history["ridden"], slip)
        by_dilation = (grade / (1.0 + grade * by_strain[:, -1]))[:, None] * by_strain
        with np.errstate(invalid="ignore"):  # where walls are crushed nothing slips
            back = np.where(by_dilation[:, None, :] == 0.0, 0.0, response.tangent[:, :, -1:] * by_dilation[:, None, :])
        return replace(
            response,
            tangent=response.tangent - back,
            inelastic=np.concatenate([response.inelastic[:, :-1], opening[:, None]], axis=1),
            margin=first.margin,
            history={
                **response.history,
                "dilation": opening,
                "ridden": history["ridden"] + slip,
                "apart": response.is_open.astype(float),
            },
        )

    def _touching(self, strain: Floats, history: History, step: LawStep) -> tuple[Floats, JointResponse]:
        """Least opening (n,) by dilation with which walls in contact stay so, and the response there; u where they part.

        Walls that move apart from u, but by less than slip without strength lifts them, are taken where they just touch.
        """
        before = history["dilation"]
        elastic, closing = _less(strain, before), np.zeros_like(strain)
        first = self.law.evaluate(elastic, history, step)
        leaves = first.is_open & (history["apart"] == 0.0)
        if not leaves.any():
            return before.copy(), first
        closing[:, -1] = -1.0
        gap = np.where(leaves, self.law.change_at(elastic, closing), 0.0)
        least = before + gap + np.where(leaves, SHARP * (np.abs(strain[:, -1]) + gap + before), 0.0)
        touching = self.law.evaluate(_less(strain, least), history, step)
        gained, _ = self._gained(history["ridden"], self._slip(touching, history)[0])
        rides = leaves & (before + gained > least)
        return np.where(rides, least, before), _either(rides, touching, first)

    def _slip(self, response: JointResponse, history: History) -> tuple[Floats, Floats]:
        """Slip (n,) in contact since ``history``, along the way of sliding, and its derivatives by strain (n, dim)."""
        moved = response.inelastic[:, :-1] - history["plastic_slip"]
        if "sliding" in self.status:
            way = response.history["sliding"]
        else:
            size = np.linalg.norm(moved, axis=1)[:, None]
            way = moved / np.where(size > 0.0, size, 1.0)
        way = np.where(response.is_open[:, None] | ~np.isfinite(response.traction[:, -1:]), 0.0, way)
        k_s = per_section(self.shear_stiffness, len(way))
        by_strain = -np.einsum("ni,nij->nj", way, response.tangent[:, :-1]) / k_s[:, None]
        by_strain[:, :-1] += way
        return np.einsum("ni,ni->n", way, moved), by_strain

    def _gained(self, ridden: Floats, slip: Floats) -> tuple[Floats, Floats]:
        """Opening (n,) that a further slip brings, and its derivative by it."""
        slope, distance = per_section(self.slope, len(slip)), per_section(self.distance, len(slip))
        first, last = np.minimum(ridden, distance), np.minimum(ridden + slip, distance)
        dilates = slope > 0.0
        share = np.where(dilates, 1.0 - 0.5 * (first + last) / np.where(dilates, distance, 1.0), 0.0)
        grade = np.where(dilates, 1.0 - last / np.where(dilates, distance, 1.0), 0.0)
        return slope * np.where(dilates, last - first, 0.0) * share, slope * grade

    @property
    def shear_stiffness(self) -> Parameter:
        """That of the law of friction [stress/length]."""
        found: Parameter = getattr(self.law, "shear_stiffness")  # noqa: B009, JointLaw has no parameters of its own
        return found

    def initial_history(self, sections: int, dim: int) -> dict[str, Floats]:
        """That of the law of friction, and zeros (sections,) of its own."""
        none = {name: np.zeros(sections) for name in ("dilation", "ridden", "apart")}
        return self.law.initial_history(sections, dim) | none

    def has_changed(self, old: History, new: History) -> Bools:
        """Whether each section (n,) has another status."""
        return self.law.has_changed(old, new)

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Largest fraction (n,) of the increment (n, dim); ``strain`` less the dilation so far."""
        return self.law.step_limit(strain, increment)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) at which the walls part or meet; ``strain`` less the dilation so far."""
        return self.law.change_at(strain, increment)

    def approach(self, strain: Floats, change: Floats, history: History, step: LawStep = INSTANT) -> Floats:
        """Distances (n, 2) from the next event; where walls touch at u, dilation on the way there changes no sign."""
        opening, rides = history["dilation"], self._touching(strain, history, step)[0] > history["dilation"]
        if rides.any():
            opening = np.where(rides, self.evaluate(strain, history, step).inelastic[:, -1], opening)
        return self.law.approach(_less(strain, opening), change, history, step)

    def with_other_status(self, strain: Floats, history: History, chosen: Bools) -> dict[str, Floats]:
        """``history`` with the other status of friction at the chosen sections (n,)."""
        return self.law.with_other_status(_less(strain, history["dilation"]), history, chosen)

    def steepness(self, traction: Floats, history: History) -> Floats:
        """That of the law of friction (n,): of the strength at a constant normal traction."""
        return self.law.steepness(traction, history)

    def most_steepness(self, compression: float) -> float:
        """That of the law of friction."""
        return self.law.most_steepness(compression)

    def softening(self, traction: Floats, history: History) -> Floats:
        """That of the law of friction (n,): of the strength at a constant normal traction."""
        return self.law.softening(traction, history)

    def strength_drop(self, compression: Floats) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.strength_drop(compression)

    def slip_length(self, sections: int) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.slip_length(sections)

    def state_length(self, history: History) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.state_length(history)

    def front_length(self, history: History) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.front_length(history)

    def slip_rate(self, history: History) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.slip_rate(history)

    def contact_age(self, history: History) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.contact_age(history)

    def rate_effects(self, compression: Floats) -> tuple[Floats, Floats]:
        """Those of the law of friction (n,)."""
        return self.law.rate_effects(compression)

    def radiated(self, slip: Floats, step: LawStep) -> Floats:
        """That of the law of friction (n,)."""
        return self.law.radiated(slip, step)


def _either(chosen: Bools, one: JointResponse, other: JointResponse) -> JointResponse:
    """One response at the chosen sections (n,), the other elsewhere."""

    def pick(first: Any, second: Any) -> Any:
        return np.where(chosen.reshape(-1, *[1] * (first.ndim - 1)), first, second)

    arrays = {each.name: getattr(one, each.name) for each in fields(one) if each.name != "history"}
    history = {name: pick(values, other.history[name]) for name, values in one.history.items()}
    return JointResponse(history=history, **{name: pick(each, getattr(other, name)) for name, each in arrays.items()})


def _less(strain: Floats, opening: Floats) -> Floats:
    """Strain (n, dim) less an opening (n,) by dilation."""
    elastic = strain.copy()
    elastic[:, -1] -= opening
    return elastic


def dilating(law: JointLaw, angle_deg: Floats, distance: Floats) -> JointLaw:
    """A law of friction whose walls ride up at first by an angle (n,) [degree], and no further after a slip (n,) [length]."""
    return Dilatant(law, np.tan(np.radians(angle_deg)), distance)


def may_dilate(law: Any) -> bool:
    """Whether a law of joints, or its class, is of friction as ``Dilatant`` takes it."""
    return bool(law.slides and "plastic_slip" in law.history)
