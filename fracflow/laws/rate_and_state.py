"""Rate-and-state friction: strength that depends on the rate of slip and on a state that evolves with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    key,
    per_section,
    per_tangent,
    zero_history,
)
from fracflow.laws.closure import NormalClosure
from fracflow.laws.friction import PLASTIC_SLIP

AGEING, SLIP = "ageing", "slip"
MOST = 200  # iterations of a section
SLOWEST = 650.0  # ln of the largest slip of a step over the smallest that is not nil
LARGE = 20.0  # from here on asinh(e^z) is z + ln 2
TINY = float(np.finfo(float).tiny)
SHARP = 8.0 * float(np.finfo(float).eps)


class _Local(NamedTuple):
    """Data of the scalar equation |T| = stiffness s + sigma a asinh(...) of sections (m,) in a step, s their slip.

    size, stiffness  |T| [stress], and w k_s + eta/dt [stress/length]
    sigma            compression at the weighted instant [stress]
    theta            state as the step begins [time]
    span             from there to the weighted instant, w dt [time]
    rate             of slip in the last step, at which the iteration begins [length/time]
    dt, a, b, f0, v0, d_c, slips  of each section; ``slips`` where the state follows the slip law
    """

    size: Floats
    stiffness: Floats
    sigma: Floats
    theta: Floats
    span: Floats
    rate: Floats
    dt: Floats
    a: Floats
    b: Floats
    f0: Floats
    v0: Floats
    d_c: Floats
    slips: Bools

    def of(self, chosen: NDArray[Any]) -> _Local:
        return _Local(*(each[chosen] for each in self))

    def left(self, y: Floats) -> tuple[Floats, Floats, Floats]:
        """The equation's left side less |T| at ln s = y, its derivative by y, and the friction of the joint [stress]."""
        slip = np.exp(y)
        theta, falls = aged(self.theta, slip / self.dt, self.span, self.d_c, self.slips)
        z = y - np.log(2.0 * self.v0 * self.dt) + (self.f0 + self.b * np.log(self.v0 * theta / self.d_c)) / self.a
        tau = self.sigma * self.a * np.where(z > LARGE, z + np.log(2.0), np.arcsinh(np.exp(np.minimum(z, LARGE))))
        bend = self.sigma * (self.a + self.b * falls) / np.sqrt(1.0 + np.exp(-2.0 * np.maximum(z, -SLOWEST / 2.0)))
        return self.stiffness * slip + tau - self.size, self.stiffness * slip + bend, tau


def aged(theta: Floats, rate: Floats, time: Floats, d_c: Floats, slips: Bools) -> tuple[Floats, Floats]:
    """State (n,) after a ``time`` at one rate V, exact, and d ln theta / d ln V of it; all (n,).

    Ageing law d theta/dt = 1 - V theta/D_c; where ``slips`` the slip law d theta/dt = -(V theta/D_c) ln(V theta/D_c).
    """
    x = rate * time / d_c
    fades = np.exp(-x)
    grows = np.where(x > 1e-4, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0 - x / 2.0 + x**2 / 6.0)
    bends = np.where(x > 1e-4, (fades - grows) / np.where(x > 0.0, x, 1.0), -0.5 + x / 3.0)
    older = theta * fades + time * grows
    falls = x * (time * bends - theta * fades) / older
    if not slips.any():
        return older, falls
    moves = slips & (rate > 0.0)
    from_steady = np.log(np.where(moves, rate, 1.0) * theta / d_c)  # it fades with slip; theta = D_c/V e^(what is left)
    left = from_steady * fades
    by_slip = np.where(moves, d_c / np.where(moves, rate, 1.0) * np.exp(left), theta)
    slopes = np.where(moves, -1.0 + fades - x * left, 0.0)
    return np.where(slips, by_slip, older), np.where(slips, slopes, falls)


@dataclass(frozen=True, eq=False)
class RateAndState(JointLaw):
    """(2.11) with friction of rate and state, regularised (Dieterich 1979, Ruina 1983, Rice et al. 2001).

    normal_stiffness         k_n0 [stress/length], > 0
    shear_stiffness          k_s [stress/length], > 0
    aperture                 d0 [length], > 0: closure can approach, never reach it
    friction_coefficient     f0, of steady slip at V0
    reference_slip_rate      V0 [length/time], > 0
    direct_effect            a > 0
    evolution_effect         b >= 0
    characteristic_slip      D_c [length], > 0
    initial_slip_rate        V at the start [length/time], > 0; the state follows from it and the initial tractions
    state_law                "ageing" (Dieterich) or "slip" (Ruina)
    initial_normal_traction  f_n0 [stress], <= 0, effective
    initial_shear_traction   f_s0 [stress]
    wave_impedance           eta = G/(2 c_s) of the rock beside [stress time/length]
    radiates                 the walls lose eta V to waves in steps without inertia; with it the rock carries them

    Parameters are numbers or arrays (n,), f_s0 may be (n, dim-1); joint frame, tension positive.

    |f_s| = -f_n a asinh(V/(2 V0) exp((f0 + b ln(V0 theta/D_c))/a)) + eta V, along the slip. V is the plastic slip of a step
    over its length, and theta is exact for it (``aged``). Traction and theta are taken at the part w of the step:
    w = 1/2 + min((V dt/D_c)^2, 1/2), V of the step before. That is of second order. Where a step slips far, it is the rule of
    the end, which damps. At once (dt = 0) nothing slips. Open walls carry no shear traction.

    History: ``plastic_slip`` [length], ``state`` theta [time], ``sliding_rate`` V [length/time], and as the step begins, the
    shear traction ``carried`` [stress] and the compression ``pressed`` [stress].

    It has no status, since its traction follows its slip without choice. It counts as sliding while eta V is above the direct
    effect -f_n a: slip that waves limit. Creep is no slip of the catalogue.
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    aperture: Parameter
    friction_coefficient: Parameter = field(metadata=key("f0, of steady slip at reference_slip_rate [1]", at_least=0.0))
    reference_slip_rate: Parameter = field(metadata=key("V0", "length/time", above=0.0))
    direct_effect: Parameter = field(metadata=key("a, of the rate of slip [1]", above=0.0))
    evolution_effect: Parameter = field(metadata=key("b, of the state [1]", at_least=0.0))
    characteristic_slip: Parameter = field(metadata=key("D_c, slip over which the state evolves", "length", above=0.0))
    initial_slip_rate: Parameter = field(
        metadata=key("V at the start; it gives the state there, with the initial tractions", "length/time", above=0.0)
    )
    state_law: str | NDArray[Any] = field(default=AGEING, metadata=key("how the state evolves", choices=(AGEING, SLIP)))
    initial_normal_traction: Parameter = 0.0
    initial_shear_traction: Parameter = 0.0
    wave_impedance: Parameter = 0.0
    radiates: bool = True

    history: ClassVar[dict[str, HistoryVariable]] = {
        "plastic_slip": PLASTIC_SLIP,
        "state": HistoryVariable("scalar", "time", "theta of rate-and-state friction, the age of the contacts"),
        "sliding_rate": HistoryVariable("scalar", "length/time", "mean rate of plastic slip over the last step"),
        "carried": HistoryVariable("shear", "force/length**2", "shear traction as a step begins", published=False),
        "pressed": HistoryVariable("scalar", "force/length**2", "compression as a step begins", published=False),
    }
    slides: ClassVar[bool] = True
    opens: ClassVar[bool] = True
    creeps: ClassVar[bool] = True

    @property
    def closure(self) -> NormalClosure:
        """The normal law."""
        return NormalClosure(self.normal_stiffness, self.aperture, self.initial_normal_traction)

    def initial_history(self, sections: int, dim: int) -> dict[str, Floats]:
        """Without slip; with the state (n,) at which the initial rate balances the initial tractions, D_c/V without any."""
        f0, v0, a, b, d_c = self._friction(sections)
        rate = per_section(self.initial_slip_rate, sections)
        shear = per_tangent(self.initial_shear_traction, sections, dim - 1)
        sigma = np.maximum(-per_section(self.initial_normal_traction, sections), 0.0)
        size = np.linalg.norm(shear, axis=1)
        balanced = (size > 0.0) & (sigma > 0.0) & (b > 0.0)
        z = size / np.where(balanced, sigma * a, 1.0)
        sinh = np.where(z > LARGE, z - np.log(2.0), np.log(np.sinh(np.where(balanced, np.minimum(z, LARGE), 1.0))))
        psi = a * (sinh + np.log(2.0 * v0 / rate))  # f0 + b ln(V0 theta/D_c)
        theta = d_c / v0 * np.exp(np.clip((psi - f0) / np.where(balanced, b, 1.0), -SLOWEST, SLOWEST))
        known = {"state": np.where(balanced, theta, d_c / rate), "sliding_rate": rate.copy()}
        return zero_history(self.history, sections, dim) | known | {"carried": shear.copy(), "pressed": sigma}

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """Response to strain (n, dim): the elastic trial, returned to the friction at the rate that it makes."""
        sections, dim = strain.shape
        f_n, k_n, normal_energy = self.closure.evaluate(strain[:, -1])
        k_s = per_section(self.shear_stiffness, sections)
        f_s0 = per_tangent(self.initial_shear_traction, sections, dim - 1)
        is_open, crushed, dt = self.closure.is_open(strain[:, -1]), ~np.isfinite(f_n), per_section(step.dt, sections)
        _, _, a, _, d_c = self._friction(sections)
        elastic = f_s0 + k_s[:, None] * (strain[:, :-1] - history["plastic_slip"])
        weight = 0.5 + np.minimum((history["sliding_rate"] * dt / d_c) ** 2, 0.5)
        trial = (1.0 - weight)[:, None] * history["carried"] + weight[:, None] * elastic
        pressed = np.where(crushed, history["pressed"], np.maximum(-f_n, 0.0))
        sigma = (1.0 - weight) * history["pressed"] + weight * pressed
        size = np.linalg.norm(trial, axis=1)
        moves = (dt > 0.0) & (size > 0.0) & ~is_open & ~crushed
        slip, by_size, by_sigma = np.zeros(sections), np.zeros(sections), np.zeros(sections)
        if moves.any():
            local = self._local(size, sigma, weight, k_s, history, dt, step.inertia).of(moves)
            slip[moves], by_size[moves], by_sigma[moves] = slip_of(local)
        direction = trial / np.where(size > 0.0, size, 1.0)[:, None]
        moved = np.where(is_open[:, None], elastic / k_s[:, None], slip[:, None] * direction)
        f_s = np.where(is_open[:, None], 0.0, elastic - k_s[:, None] * moved)

        outer = direction[:, :, None] * direction[:, None, :]
        turns = (slip / np.where(size > 0.0, size, 1.0))[:, None, None] * (np.eye(dim - 1) - outer)
        given = (weight * k_s)[:, None, None] * (by_size[:, None, None] * outer + turns)
        tangent = np.zeros((sections, dim, dim))
        tangent[:, :-1, :-1] = np.where(is_open[:, None, None], 0.0, k_s[:, None, None] * (np.eye(dim - 1) - given))
        by_opening = k_s * by_sigma * weight * np.where(crushed | (f_n >= 0.0), 0.0, k_n)
        tangent[:, :-1, -1] = by_opening[:, None] * direction
        tangent[:, -1, -1] = k_n
        plastic = history["plastic_slip"] + moved
        far = np.linalg.norm(moved, axis=1)
        rate = np.where(dt > 0.0, far / np.where(dt > 0.0, dt, 1.0), history["sliding_rate"])
        theta, _ = aged(history["state"], far / np.where(dt > 0.0, dt, 1.0), dt, d_c, self._slips(sections))
        squares = np.einsum("ni,ni->n", f_s, f_s) - np.einsum("ni,ni->n", f_s0, f_s0)
        impedance = per_section(self.wave_impedance, sections)
        return JointResponse(
            traction=np.concatenate([f_s, f_n[:, None]], axis=1),
            tangent=tangent,
            stored=normal_energy + squares / (2.0 * k_s),
            inelastic=np.concatenate([plastic, np.zeros((sections, 1))], axis=1),
            strength=np.full(sections, np.inf),
            utilisation=np.zeros(sections),
            is_sliding=(impedance * rate > a * pressed) & (dt > 0.0) & ~is_open,
            is_open=is_open,
            margin=np.full(sections, np.inf),
            history={
                "plastic_slip": plastic,
                "state": np.where(dt > 0.0, theta, history["state"]),
                "sliding_rate": rate,
                "carried": f_s.copy(),
                "pressed": pressed,
            },
        )

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of an increment (n, dim) to the boundary -d0 of the closure."""
        return self.closure.step_limit(strain, increment)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of an increment (n, dim) at which the walls part or meet."""
        return self.closure.change_at(strain, increment)

    def slip_rate(self, history: History) -> Floats:
        """V (n,), the mean rate of plastic slip over the last step [length/time]."""
        return history["sliding_rate"]

    def contact_age(self, history: History) -> Floats:
        """Theta (n,) [time]."""
        return history["state"]

    def state_length(self, history: History) -> Floats:
        """D_c (n,); by the slip law over |ln(V theta/D_c)| where that is above 1 [length]."""
        theta, rate = history["state"], history["sliding_rate"]
        d_c = per_section(self.characteristic_slip, len(theta))
        away = np.abs(np.log(np.maximum(rate, TINY) / d_c * theta))
        found: Floats = d_c / np.where(self._slips(len(theta)), np.maximum(away, 1.0), 1.0)
        return found

    def front_length(self, history: History) -> Floats:
        """D_c (n,); by the slip law over ln(V0 theta/D_c), for V0 stands for the rate of slip at a front [length]."""
        fast = per_section(self.reference_slip_rate, len(history["state"]))
        return self.state_length({**history, "sliding_rate": np.maximum(history["sliding_rate"], fast)})

    def rate_effects(self, compression: Floats) -> tuple[Floats, Floats]:
        """Direct and evolution effect a sigma, b sigma (n,) under a compression (n,) [stress]."""
        _, _, a, b, _ = self._friction(len(compression))
        return a * compression, b * compression

    def radiated(self, slip: Floats, step: LawStep) -> Floats:
        """Eta V times the slip (n,) of a step without inertia [energy/area]."""
        damping, dt = self._damping(len(slip), step.inertia), per_section(step.dt, len(slip))
        return np.where(dt > 0.0, damping * slip**2 / np.where(dt > 0.0, dt, 1.0), 0.0)

    def _damping(self, sections: int, inertia: bool) -> Floats:
        """Eta (n,) of a step, 0 where the rock carries waves."""
        return np.zeros(sections) if inertia or not self.radiates else per_section(self.wave_impedance, sections)

    def _slips(self, sections: int) -> Bools:
        """Whether sections (n,) follow the slip law."""
        found: Bools = np.broadcast_to(np.asarray(self.state_law) == SLIP, sections)
        return found

    def _friction(self, sections: int) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """f0, V0, a, b and D_c (n,)."""
        f0, v0, a = self.friction_coefficient, self.reference_slip_rate, self.direct_effect
        first = per_section(f0, sections), per_section(v0, sections), per_section(a, sections)
        return *first, per_section(self.evolution_effect, sections), per_section(self.characteristic_slip, sections)

    def _local(
        self, size: Floats, sigma: Floats, weight: Floats, k_s: Floats, history: History, dt: Floats, inertia: bool
    ) -> _Local:
        sections = len(size)
        f0, v0, a, b, d_c = self._friction(sections)
        stiffness = weight * k_s + self._damping(sections, inertia) / np.where(dt > 0.0, dt, 1.0)
        return _Local(
            size, stiffness, sigma, history["state"], weight * dt, history["sliding_rate"], dt, a, b, f0, v0, d_c,
            self._slips(sections),
        )  # fmt: skip


def slip_of(local: _Local) -> tuple[Floats, Floats, Floats]:
    """Slip (m,) of a step, and its derivatives by the size of the trial traction and by the compression.

    Root of the scalar equation in ln s, by Newton's method inside a bracket; 0 where it is below what a number can hold.
    """
    high = np.log(local.size / local.stiffness)
    low = high - SLOWEST
    y = np.clip(np.log(np.maximum(local.rate * local.dt, np.exp(-SLOWEST))), low, high)
    still = local.left(low)[0] >= 0.0
    active = np.flatnonzero(~still)
    for _ in range(MOST):
        if not len(active):
            break
        here, at = local.of(active), y[active]
        left, slope, _ = here.left(at)
        low[active], high[active] = np.where(left < 0.0, at, low[active]), np.where(left > 0.0, at, high[active])
        rises = slope > 0.0
        new = at - left / np.where(rises, slope, 1.0)
        inside = rises & (new > low[active]) & (new < high[active])
        close = SHARP * (np.abs(at) + here.size / np.where(rises, slope, np.inf))
        is_narrow = high[active] - low[active] <= SHARP * np.abs(at)
        done = (left == 0.0) | (rises & (np.abs(left) <= close * slope)) | is_narrow
        y[active] = np.where(done, at, np.where(inside, new, 0.5 * (low[active] + high[active])))
        active = active[~done]
    _, slope, tau = local.left(y)
    slope, slip = np.where(slope > 0.0, slope, np.inf), np.where(still, 0.0, np.exp(y))
    return slip, slip / slope, -slip * tau / np.where(local.sigma > 0.0, local.sigma, 1.0) / slope
