"""Excitation of rock by waves that come in, and by loads and supports that jump or change their rate fast.

A load whose rate changes at once by r sets a mode of period T swinging by r T/(2 pi) about the quasi-static response
(Biggs 1964, 2.3); changes within a period may add up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.model.state import State
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable

LARGEST = PETSc.NormType.INFINITY
SHAKES = 0.1  # of the range of a load: a vibration that a stage auto does not leave out
WAVE, LOAD = "a wave comes in", "what is prescribed changes within the longest period"


@dataclass(frozen=True)
class Excitation:
    """A time span, or an instant, in which the rock is excited, and the cause."""

    start: float
    end: float
    why: str


def excitations(scene: Scene, period: float) -> tuple[Excitation, ...]:
    """All of a scene's spans, by their start; ``period`` is the longest period of vibration of its rock."""
    waves = [wave for each in scene.terms for wave in each.waves]
    loads = [table for table in scene.driving_tables if table not in waves]
    found = [span for table in waves for span in _arrivals(table)]
    found += [span for table in loads for span in _rate_jumps(table, period)]
    return tuple(sorted(found, key=lambda span: span.start))


def _arrivals(table: TimeTable) -> Iterator[Excitation]:
    times, values = np.array(table.times), np.array(table.values)
    ends = [*times[1:], np.inf]
    for n, (start, end) in enumerate(zip(times, ends, strict=True)):
        after = values[min(n + 1, len(values) - 1)] if table.interpolation == "linear" else values[n]
        if values[n] != 0.0 or (after != 0.0 and end > start):
            yield Excitation(float(start), float(end), WAVE)


def _rate_jumps(table: TimeTable, period: float) -> Iterator[Excitation]:
    at, _ = table.jumps
    yield from (Excitation(float(time), float(time), LOAD) for time in at)
    if table.interpolation == "step" or table.spread == 0.0:
        return
    times, values = np.array(table.times), np.array(table.values)
    length = np.diff(times)
    moves = length > 0.0
    rates = np.diff(values)[moves] / length[moves]
    changes = np.abs(np.diff(rates, prepend=0.0, append=0.0)) * period / (2.0 * pi * table.spread)
    at = np.append(times[:-1][moves], times[1:][moves][-1])
    total, last = np.concatenate([[0.0], np.cumsum(changes)]), np.searchsorted(at, at + period, side="right")
    for n in np.flatnonzero((total[last] - total[:-1] > SHAKES) & (changes > 0.0)):
        yield Excitation(float(at[n]), float(at[last[n] - 1]), LOAD)


def why_inertia(old: State, new: State, period: float, left: float, most: float) -> str:
    """Why a step planned without inertia needs it: joints slip or open, or a large vibration; else empty. Collective.

    ``left`` and the vibration as in ``swing``, which may come to ``most``.
    """
    before, after = old.sections, new.sections
    changed = np.any(after.is_open != before.is_open) | np.any(after.is_sliding)
    changed |= np.any(after.inelastic[:, :-1] != before.inelastic[:, :-1])
    if new.motion.velocity.comm.tompi4py().allreduce(bool(changed), op=MPI.LOR):
        return "joints slip or open"
    found = swing(old, new, period, left)
    return f"a vibration of {found:.3g} of the displacement would be left out, above {most:g}" if found > most else ""


def swing(old: State, new: State, period: float, left: float) -> float:
    """Amplitude of the vibration that a step without inertia leaves out, over the displacement to come [1]. Collective.

    A rate that changes by r sets off r T/(2 pi), and stopping again as much; ``left`` is how long loads go on at their rate
    """
    change = new.motion.velocity.copy()
    change.axpy(-1.0, old.motion.velocity)
    kick, rate = float(change.norm(LARGEST)), float(new.motion.velocity.norm(LARGEST))
    change.destroy()
    reach = float(new.motion.displacement.norm(LARGEST)) + rate * left
    return kick * period / (pi * reach) if reach > 0.0 else 0.0
