"""W9: slip by injection (R08), with its rock meshed, condensed to the fault, and not meshed; over the length of joints.

The pressure rises to that of T = 0.5 in even steps. The slip at the end does not depend on the way there, for it grows
everywhere. Meshed rock has sides at 40 a, and cells that grow away from the fault.
"""

from __future__ import annotations

from figures_verification.cases import r08, r18

from figures_work_precision.problem import Answer, Method, Problem

STRESS, STEPS = 0.5, 20
SIZES = (0.2, 0.1, 0.05, 0.025)


def meshed(coupling: str, size: float) -> Answer:
    """Error of the slip over its largest, by a coupling, on joints ``size`` a."""
    found = r08.pushed(STRESS, size, coupled=False, coupling=coupling, ramp=STEPS)
    return Answer(r08.error_of_slip(found, STRESS), found.seconds)


def unmeshed(size: float) -> Answer:
    """The same without cells."""
    found = r18.pushed(STRESS, size, STEPS)
    return Answer(r08.error_of_slip(found, STRESS), found.seconds)


PROBLEM = Problem(
    "W9", "Slip by injection: rock that is meshed, condensed, not meshed", "joint/half length", "slip, over its largest",
    (
        Method("meshed", lambda size: meshed("whole-lu", size), SIZES),
        Method("condensed", lambda size: meshed("condensed", size), SIZES),
        Method("not meshed", unmeshed, (*SIZES, 0.0125), default=True),
    ),
    0.1,
)  # fmt: skip
