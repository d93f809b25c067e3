"""W6: a rupture that breaks out of a patch along a fault whose friction weakens with slip, as in meshes/rupture, 12 km long.

Nothing closed is known: the reference is the same fault by explicit steps on squares of half the finest here. When slip
has come to a quarter of the weakening distance at four places is what counts.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from figures_verification.runs import Found, solve
from grids import Floats, tensor

from figures_work_precision.problem import Answer, Method, Problem

REACH, DEPTH, PATCH, END, DISTANCE, FASTEST = 6000.0, 3000.0, 1500.0, 2.6, 0.4, 6000.0
PLACES = (-4500, -3000, 3000, 4500)
SIDES = (500.0, 375.0, 300.0, 250.0)  # each divides the patch
FINER = (187.5, 125.0)
FINEST = 1500.0 / 24
ALONG = (0.0, REACH - PATCH - 1e-3, REACH - PATCH + 1e-3, REACH + PATCH - 1e-3, REACH + PATCH + 1e-3, 2 * REACH)
PROBES = ", ".join(f'{{name = "{x}", at = [{x}, 0], on = "fault", quantities = ["slip"]}}' for x in PLACES)
SCENE = f"""
rock.rock = {{youngs_modulus = "80.1 GPa", poissons_ratio = 0.25, density = 2670}}
initial_stress = {{xx = "-120 MPa", yy = "-120 MPa", xy = "70 MPa", unbalanced = "carried"}}
absorbing = [{{on = ["south", "north", "west", "east"]}}]
probe = [{PROBES}]
[fracture.fault]
law = "slip-weakening"
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = 1
friction_coefficient = 0.677
dynamic_friction_coefficient = 0.525
slip_weakening_distance = {DISTANCE}
initial_shear_traction = {{along = {list(ALONG)}, value = [70e6, 70e6, 81.6e6, 81.6e6, 70e6, 70e6]}}
"""


def rupture(side: float, courant: float, *settings: str, triangles: bool = False) -> Found:
    """On squares of that side, or halves of such, a P wave crossing ``courant`` of one in a step."""
    x, y = (np.linspace(-end, end, round(2 * end / side) + 1) for end in (REACH, DEPTH))
    steps = int(np.ceil(END * FASTEST / (courant * side)))
    stage = f"stage=[{{kind = 'dynamic', time_step = {END / steps}, steps = {steps}}}]"
    return solve(SCENE, stage, *settings, mesh=tensor(x, y, {"fault": (0.0, -REACH, REACH)}, triangles))


def arrivals(found: Found) -> Floats:
    """When slip comes to a quarter of DISTANCE, at each place."""
    slips = [np.abs(found.probe(str(x), "slip")) for x in PLACES]
    return np.array([np.interp(DISTANCE / 4, slip, found.history["time"]) for slip in slips])


@cache
def reference() -> Floats:
    """Of the finest mesh."""
    return arrivals(rupture(FINEST, 0.5, "method.stepper=explicit"))


def run(courant: float, *settings: str, side: float, triangles: bool = False) -> Answer:
    """Root mean square of the errors of the arrivals, over that of the arrivals."""
    found = rupture(side, courant, *settings, triangles=triangles)
    right = reference()
    return Answer(float(np.sqrt(np.sum((arrivals(found) - right) ** 2) / np.sum(right**2))), found.seconds)


def method(name: str, *settings: str, courant: float = 1.0, triangles: bool = False) -> Method:
    """Settings under [method]; ``triangles`` are the squares' halves, mirrored in the fault."""
    given = tuple(f"method.{setting}" for setting in settings)
    cheap = LU not in settings
    levels = SIDES + FINER if cheap else SIDES
    return Method(name, lambda side: run(courant, *given, side=side, triangles=triangles), levels, default=not settings)


ENDS, LU = "events=at-step-ends", "coupling=whole-lu"
PROBLEM = Problem(
    "W6", "A rupture along a weakening fault: steppers, contact, events", "side of the squares [m]", "arrivals",
    (
        method("newmark"),
        method("newmark, located, LU", "events=located", LU),
        method("newmark, at step ends, LU", ENDS, LU),
        method("newmark, at step ends", ENDS),
        method("newmark, lumped contact, at step ends", "contact=lumped", ENDS),
        method("generalised-alpha, at step ends", "stepper=generalised-alpha", ENDS),
        method("explicit", "stepper=explicit", courant=0.5),
        method("explicit, triangles", "stepper=explicit", courant=0.5, triangles=True),
    ),
    0.11, reference,
)  # fmt: skip
