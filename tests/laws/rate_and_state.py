"""Rate-and-state friction, a law from outside the package: this file, and the line that registers it.

python tests/laws/rate_and_state.py run SCENE -o DIR      the command line, with law = "outside-rate" known to scenes
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from fracflow.laws import JOINT_LAWS, HistoryVariable, JointLaw, JointResponse, LawStep
from fracflow.laws.base import INSTANT, Bools, Floats, History, Parameter, key, per_section, per_tangent, zero_history
from fracflow.laws.closure import NormalClosure

MOST = 200  # iterations of a section
WIDE = 500.0  # range of ln V that is searched
SHARP = 4.0 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class RateAndState(JointLaw):
    """Rate-and-state friction, regularised, with ageing (Dieterich 1979, Ruina 1983; Rice et al. 2001).

    tau = |f_n| a asinh(V/(2 V0) exp((f0 + b ln(V0 theta/d_c))/a)),  d theta/dt = 1 - V theta/d_c, with V the plastic slip
    of the step over its length, and theta exact for a V that lasts over it. At once nothing slips. Parameters are numbers
    or arrays (n,); history: ``plastic_slip`` [length] and ``age`` theta [time].
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    aperture: Parameter
    friction_coefficient: Parameter = field(metadata=key("f0, at the rate V0 in steady state [1]", at_least=0.0))
    direct_effect: Parameter = field(metadata=key("a [1]", above=0.0))
    evolution_effect: Parameter = field(metadata=key("b [1]", at_least=0.0))
    state_distance: Parameter = field(metadata=key("d_c, slip over which the state evolves", "length", above=0.0))
    reference_rate: Parameter = field(metadata=key("V0", "length/time", above=0.0))
    initial_state: Parameter = field(metadata=key("theta at the start", "time", above=0.0))
    initial_normal_traction: Parameter = 0.0
    initial_shear_traction: Parameter = 0.0

    history: ClassVar[dict[str, HistoryVariable]] = {
        "plastic_slip": HistoryVariable("shear", "length", "plastic slip", published=False),
        "age": HistoryVariable("scalar", "time", "theta, the age of the contacts"),
    }
    slides: ClassVar[bool] = True
    opens: ClassVar[bool] = True

    @property
    def closure(self) -> NormalClosure:
        """The normal law."""
        return NormalClosure(self.normal_stiffness, self.aperture, self.initial_normal_traction)

    def initial_history(self, sections: int, dim: int) -> dict[str, Floats]:
        """No slip yet, and the given age."""
        return zero_history(self.history, sections, dim) | {"age": per_section(self.initial_state, sections)}

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """Response to strain (n, dim): the elastic trial, returned to the friction at the rate that it makes."""
        sections, dim = strain.shape
        f_n, k_n, normal_energy = self.closure.evaluate(strain[:, -1])
        k_s, f_s0 = (
            per_section(self.shear_stiffness, sections),
            per_tangent(self.initial_shear_traction, sections, dim - 1),
        )
        is_open, crushed = self.closure.is_open(strain[:, -1]), ~np.isfinite(f_n)
        trial = f_s0 + k_s[:, None] * (strain[:, :-1] - history["plastic_slip"])
        size, compression = np.linalg.norm(trial, axis=1), np.where(crushed, 0.0, np.maximum(-f_n, 0.0))
        slips = (size > 0.0) & (compression > 0.0) & (step.dt > 0.0)
        slip, by_size, by_normal = np.zeros(sections), np.zeros(sections), np.zeros(sections)
        if slips.any():
            found = self._slip(size[slips], compression[slips], k_s[slips], history["age"][slips], step, slips)
            slip[slips], by_size[slips], by_normal[slips] = found
        slip = np.where(is_open, size / k_s, slip)  # open walls carry no shear traction
        ratio = 1.0 - slip * k_s / np.where(size > 0.0, size, 1.0)
        f_s = ratio[:, None] * trial
        direction = trial / np.where(size > 0.0, size, 1.0)[:, None]
        plastic = history["plastic_slip"] + slip[:, None] * direction

        outer = direction[:, :, None] * direction[:, None, :]
        along = np.where(is_open, 0.0, 1.0 - k_s * by_size)
        tangent = np.zeros((sections, dim, dim))
        across = np.where(is_open, 0.0, ratio)[:, None, None] * (np.eye(dim - 1) - outer)
        tangent[:, :-1, :-1] = k_s[:, None, None] * (across + along[:, None, None] * outer)
        tangent[:, :-1, -1] = -(k_s * by_normal * np.where(crushed, 0.0, k_n))[:, None] * direction
        tangent[:, -1, -1] = k_n
        squares = np.einsum("ni,ni->n", f_s, f_s) - np.einsum("ni,ni->n", f_s0, f_s0)
        return JointResponse(
            traction=np.concatenate([f_s, f_n[:, None]], axis=1),
            tangent=tangent,
            stored=normal_energy + squares / (2.0 * k_s),
            inelastic=np.concatenate([plastic, np.zeros((sections, 1))], axis=1),
            strength=np.full(sections, np.inf),
            utilisation=np.zeros(sections),
            is_sliding=np.zeros(sections, dtype=bool),
            is_open=is_open,
            margin=np.full(sections, np.inf),
            history={"plastic_slip": plastic, "age": self._aged(history["age"], slip, step)[0]},
        )

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction to the boundary -d0 of the closure."""
        return self.closure.step_limit(strain, increment)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction of the increment at which the walls part or meet."""
        return self.closure.change_at(strain, increment)

    def _aged(self, theta: Floats, slip: Floats, step: LawStep, chosen: Bools | None = None) -> tuple[Floats, Floats]:
        """Theta after a step in which so much slips at one rate, and d ln theta / d ln V."""
        every = np.ones(len(theta), dtype=bool) if chosen is None else chosen
        x = slip / per_section(self.state_distance, len(every))[every]
        grows = np.where(x > 1e-4, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0 - x / 2.0 + x**2 / 6.0)
        bends = np.where(x > 1e-4, (np.exp(-x) - grows) / np.where(x > 0.0, x, 1.0), -0.5 + x / 3.0)
        aged = theta * np.exp(-x) + step.dt * grows
        return aged, x * (step.dt * bends - theta * np.exp(-x)) / np.where(aged > 0.0, aged, 1.0)

    def _slip(
        self, size: Floats, compression: Floats, k_s: Floats, theta: Floats, step: LawStep, chosen: Bools
    ) -> tuple[Floats, Floats, Floats]:
        """Slip (m,) of the chosen sections, its derivative by ``size``, and minus that by ``compression``.

        Root of k_s V dt + tau(V) = size in ln V, by Newton's method inside a bracket.
        """
        f0, a, b, d_c, v0 = (
            per_section(value, len(chosen))[chosen]
            for value in (
                self.friction_coefficient,
                self.direct_effect,
                self.evolution_effect,
                self.state_distance,
                self.reference_rate,
            )
        )
        high = np.log(size / k_s)  # of ln slip
        low, y = high - WIDE, high - 1.0
        for _ in range(MOST):
            slip = np.exp(y)
            aged, falls = self._aged(theta, slip, step, chosen)
            z = y - np.log(2.0 * v0 * step.dt) + (f0 + b * np.log(v0 * aged / d_c)) / a
            tau = compression * a * np.where(z > 20.0, z + np.log(2.0), np.arcsinh(np.exp(np.minimum(z, 20.0))))
            slope = k_s * slip + compression * (a + b * falls) / np.sqrt(1.0 + np.exp(-2.0 * np.maximum(z, -300.0)))
            left = k_s * slip + tau - size
            low, high = np.where(left < 0.0, y, low), np.where(left > 0.0, y, high)
            new = y - left / np.where(slope > 0.0, slope, 1.0)
            new = np.where((slope > 0.0) & (new > low) & (new < high), new, 0.5 * (low + high))
            if np.all((np.abs(new - y) <= SHARP * np.maximum(np.abs(y), 1.0)) | (left == 0.0)):
                break
            y = np.where(left == 0.0, y, new)
        return slip, slip / slope, slip * (tau / compression) / slope


def steady_friction(law: RateAndState, rate: float) -> float:
    """mu = f0 + (a - b) ln(V/V0), in steady state."""
    f0, a, b, v0 = law.friction_coefficient, law.direct_effect, law.evolution_effect, law.reference_rate
    return float(f0 + (a - b) * np.log(rate / v0))


if __name__ == "__main__":
    JOINT_LAWS["outside-rate"] = RateAndState
    from fracflow.cli.app import main

    main()
