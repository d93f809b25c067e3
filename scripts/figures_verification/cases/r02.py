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
    """Largest error of the displacement, and of what the joints have slipped at last, over the largest displacement."""

    def at(step: float) -> tuple[float, ...]:
        table = {"time": [0.0, 3.4], "value": [2.25, 0.0], "interpolation": "step"}
        if not push.name.startswith("rect"):
            times = np.linspace(0.0, push.end, round(push.end / FINEST) + 1)
            table = {"time": times.tolist(), "value": [float(push.force(t)) for t in times], "interpolation": "linear"}
        force = ", ".join(f'{key} = "{value}"' if key == "interpolation" else f"{key} = {value}" for key, value in table.items())
        given = (f"load.0.traction=[{{{force}}}, 0]", f"stage.0.time_step={step}", f"stage.0.end={push.end}")
        found = solve(SCENE, *given, f"fracture.default.stick_slip_ratio={push.ratio}")
        right = exact(found.history["time"], push)
        return (float(np.abs(found.probe("block", "displacement")[:, 0] - right).max() / np.abs(right).max()),)

    return at


SIZES, QUICK = (0.2, 0.1, 0.05), (0.2, 0.1)
BARS = {"A": 8e-4, "B": 1.6e-3, "C": 6e-4, "D": 4e-4, "E": 4e-4}
CASES = tuple(
    Case(f"R02-{name} {push.name}", (Bar("displacement", BARS[name], 1.8),), errors(push), SIZES, QUICK if name in "BC" else (), "dt")
    for name, push in PUSHES.items()
)
