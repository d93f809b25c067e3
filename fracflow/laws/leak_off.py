"""Leak-off: fluid that a fracture loses to the porous half spaces behind its walls, which no mesh has.

    dp/dt = c d2p/dx2 in each, c = permeability/(viscosity storage), with the fracture's pressure change at x = 0: into
    both walls together, per area of the fracture, flows

    q = 2 sqrt(k S/mu) int (dp/dtau)/sqrt(pi (t - tau)) dtau     (Carslaw and Jaeger 1959, 2.4 (7), by superposition)

The kernel is a sum of exponentials, each with its own memory, so that a step needs no earlier ones (Beylkin and Monzon 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow.laws.base import Floats

SPACING = 1.0  # of the logarithms of the rates: the sum is then within 2.8 exp(-pi^2/SPACING) = 1.5e-4 of the kernel
RANGE = 1000  # of their numbers, as of all floating-point numbers
SLOW = 1e-3  # a rate times the longest time, below which an exponential stays 1
FAST = 30.0  # a rate times the shortest time, above which it is over at once


@dataclass(frozen=True)
class Exponentials:
    """1/sqrt(pi t) = sum w exp(-r t) from the shortest to the longest time.

    rates    r (m,), ascending; the first is 0, the others exp(SPACING n) for n from ``lowest`` on [1/time]
    weights  w (m,) [time^-1/2]
    rest     integral of what is left out, that of the fastest rates [time^1/2]
    """

    rates: Floats
    weights: Floats
    rest: float
    lowest: int

    def kernel(self, time: Floats) -> Floats:
        """The sum at times (n,) [time^-1/2]."""
        found: Floats = np.exp(-np.multiply.outer(time, self.rates)) @ self.weights
        return found


def exponentials(shortest: float, longest: float) -> Exponentials:
    """The sum for times [time] from ``shortest`` to ``longest``: trapezoidal rule in x = ln r of int exp(x/2 - t e^x) dx/pi.

    About ln(longest/shortest) + 11 of them.
    """
    lowest = int(np.floor(np.log(SLOW / longest) / SPACING))
    highest = int(np.ceil(np.log(FAST / shortest) / SPACING))
    x = SPACING * np.arange(lowest, highest + 1)
    weights = SPACING * np.exp(0.5 * x) / np.pi
    # what is left out on either side is a geometric sum
    slow, fast = (
        SPACING * np.exp(0.5 * (end - SPACING)) / np.pi / (1.0 - np.exp(-0.5 * SPACING)) for end in (x[0], -x[-1])
    )
    return Exponentials(np.append(0.0, np.exp(x)), np.append(slow, weights), float(fast), lowest)


def leak_off_coefficient(permeability: Floats, storage: Floats, viscosity: float) -> Floats:
    """2 sqrt(k S/mu) (...) of both walls [length/(stress time^1/2)]."""
    found: Floats = 2.0 * np.sqrt(permeability * storage / viscosity)
    return found


def memory_after(kernel: Exponentials, memory: Floats, change: Floats, dt: float) -> Floats:
    """Memories (..., m) [stress] after a step in which the pressure changes evenly by ``change`` (...), from ``memory``."""
    mean, _ = _shares(kernel, dt)
    found: Floats = np.exp(-kernel.rates * dt) * memory + mean * change[..., None]
    return found


def memory_of(kernel: Exponentials, memory: Floats, lowest: int) -> Floats:
    """Memories (..., m) of this sum, from those (..., k) of one for other times, whose rates are from ``lowest`` on.

    Slower exponentials than it had are still as the one that never fades; faster ones follow the rate of the pressure.
    """
    rates = lowest + np.arange(memory.shape[-1] - 1)
    wanted = kernel.lowest + np.arange(len(kernel.rates) - 1)
    fades = np.exp(SPACING * np.minimum(rates[-1] - wanted, 0))
    found = memory[..., 1:][..., np.clip(wanted - lowest, 0, len(rates) - 1)] * fades
    found[..., wanted < lowest] = memory[..., :1]
    return np.concatenate([memory[..., :1], found], axis=-1)


def leaked_volume(kernel: Exponentials, memory: Floats, change: Floats, dt: float) -> tuple[Floats, float]:
    """Volume (...) that leaves in such a step over the coefficient [stress time^1/2], and its derivative by the change."""
    mean, of_change = _shares(kernel, dt)
    slope = float(of_change @ kernel.weights) + kernel.rest
    return memory @ (kernel.weights * mean * dt) + slope * change, slope


def _shares(kernel: Exponentials, dt: float) -> tuple[Floats, Floats]:
    """With z = r dt (m,): mean of exp(-r t) over a step; integral over it of the memory of an even change of 1 [time]."""
    z = kernel.rates * dt
    small = z < 1e-3
    safe = np.where(small, 1.0, z)
    mean = np.where(small, 1.0 - z / 2.0 + z**2 / 6.0, -np.expm1(-safe) / safe)
    return mean, dt * np.where(small, 0.5 - z / 6.0 + z**2 / 24.0, (1.0 - mean) / safe)
