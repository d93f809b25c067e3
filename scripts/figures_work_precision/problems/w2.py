"""W2: the block of 5.2 shaken past its strength again and again, which drops to 0.9 while it slides; steppers and events.

Exact is DOP853 from event to event (R02), to 1e-12.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from figures_time.events import exact, harmonic
from figures_verification.runs import Floats, solve
from sheets import ROOT

from figures_work_precision.problem import Answer, Method, Problem

SCENE = ROOT / "meshes" / "report_5_2" / "scene.toml"
PUSH = harmonic(0.9, 20.0)
STEPS, MORE = (0.8, 0.4, 0.2, 0.1), (0.05,)
TOLERANCES = (0.5, 0.3, 0.1, 0.03)
TIMES = np.linspace(0.0, PUSH.end, round(PUSH.end / 0.0125) + 1)  # with those of all steps
TABLE = [[float(t), float(PUSH.force(t))] for t in TIMES]
GIVEN = (f"load.0.traction=[{TABLE}, 0]", f"stage.0.end={PUSH.end}", f"fracture.default.stick_slip_ratio={PUSH.ratio}")


@cache
def reference() -> Floats:
    """Displacements at TIMES."""
    return exact(TIMES, PUSH)


def run(*settings: str, step: float) -> Answer:
    """Largest error of the displacement over its largest value."""
    found = solve(SCENE, *GIVEN, f"stage.0.time_step={step}", *settings)
    right = np.interp(found.history["time"], TIMES, reference())
    wrong = np.abs(found.probe("block", "displacement")[:, 0] - right).max() / np.abs(right).max()
    return Answer(float(wrong), found.seconds)


def method(name: str, *settings: str, most: float | None = None) -> Method:
    """Settings under [method]."""
    given = tuple(f"method.{setting}" for setting in settings)
    levels = STEPS if settings else STEPS + MORE
    return Method(name, lambda step: run(*given, step=step), levels, default=not settings, most=most)


STEPPERS = {"generalised-alpha": 0.02, "explicit": 0.02}
"""Stepper -> error that the tests allow."""
PROBLEM = Problem(
    "W2", "A block that slips: steppers, and events inside steps", "time step, or tolerance", "displacement",
    (
        method("newmark"),
        method("newmark, at step ends", "events=at-step-ends", most=0.25),
        *(method(f"{name}, located", f"stepper={name}", most=most) for name, most in STEPPERS.items()),
        method("implicit-euler, at step ends", "stepper=implicit-euler", "events=at-step-ends", most=1.0),
        method("explicit, at step ends", "stepper=explicit", "events=at-step-ends", most=0.25),
        Method("newmark, by tolerance", lambda most: run(f"accuracy.tolerance={most}", step=STEPS[0]), TOLERANCES),
        Method("model = report", lambda step: run("model=report", step=step), STEPS, most=0.25),
    ),
    0.02, reference,
)  # fmt: skip
