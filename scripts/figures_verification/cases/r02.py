"""R02: the block of 5.2 between two joints, pushed until it slips; closed forms from event to event.

m u'' + F = P, F = K (u - u_p) while |F| <= F_y; sliding carries alpha F_y until it would turn round (Fig. 4 of the report);
m = K = 1, F_y = 2. The exact course is that of ``figures_time.events``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from figures_time.events import Push, exact, half_sine, harmonic
from sheets import ROOT

from figures_verification.case import Bar, Case
from figures_verification.runs import solve

SCENE = ROOT / "meshes" / "report_5_2" / "scene.toml"
FINEST = 0.05


def rectangle(ratio: float, end: float) -> Push:
    """2.25 for 3.4 s."""
    return Push(f"rectangle of 2.25, {ratio:g}", lambda t: 2.25 if t < 3.4 else 0.0, (3.4,), end, ratio)


PUSHES = {
    "A": rectangle(1.0, 12.0), "B": half_sine(1.0, 12.0), "C": rectangle(0.8, 12.0),
    "D": harmonic(1.0, 20.0), "E": harmonic(0.9, 20.0),
}  # fmt: skip


def errors(push: Push) -> Callable[[float], tuple[float, ...]]:
    """Largest error of the displacement over its largest value, by the time step."""

    def at(step: float) -> tuple[float, ...]:
        times, kind = np.linspace(0.0, push.end, round(push.end / FINEST) + 1), "linear"
        if push.name.startswith("rect"):
            times, kind = np.array([0.0, 3.4]), "step"
        values = [float(push.force(t)) for t in times]
        force = f'{{time = {times.tolist()}, value = {values}, interpolation = "{kind}"}}'
        given = (f"load.0.traction=[{force}, 0]", f"stage.0.time_step={step}", f"stage.0.end={push.end}")
        found = solve(SCENE, *given, f"fracture.default.stick_slip_ratio={push.ratio}")
        right = exact(found.history["time"], push)
        return (float(np.abs(found.probe("block", "displacement")[:, 0] - right).max() / np.abs(right).max()),)

    return at


BARS = {"A": 8e-4, "B": 1.6e-3, "C": 6e-4, "D": 4e-4, "E": 4e-4}
SIZES = (0.2, 0.1, 0.05)
QUICK = {"B": SIZES[:2], "C": SIZES[:2]}
CASES = tuple(
    Case(f"R02-{name} {push.name.rpartition(',')[0]}, alpha = {push.ratio:g}", (Bar("displacement", BARS[name], 1.8),),
         errors(push), SIZES, QUICK.get(name, ()), "dt")
    for name, push in PUSHES.items()
)  # fmt: skip
