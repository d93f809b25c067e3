"""Mont Terri, DECOVALEX-2019 Task B: a tight fault, 10 um wide, under steps of pressure that lift it open and make it slip.

Parameters of the public deck of OpenGeoSys, with Coulomb friction of 22 degrees. Errors are against the same scene in steps
of 0.25 s, from which those of 0.5 s differ by 7e-5. Slip begins by hand at p = p_0 + sigma' - tau/tan 22 deg = 3.99 MPa, so
in the step to 4.094 MPa at 157 s.
"""

from __future__ import annotations

import numpy as np
from figures_verification.case import Bar

from figures_benchmarks.benchmark import Benchmark, Line, Ran, clocked, rms, table_of

END, FIRST_SLIP, BRIEF, COMMON = 807.0, 157.0, 1e-4, 6.0
SCENE = """
rock.rock = {youngs_modulus = 6.1065e9, poissons_ratio = 0.3275, density = 2450}
initial_stress = {xx = -5.3e6, yy = -7.0e6, zz = -6.0e6}
fluid = {viscosity = 1e-3, initial_pressure = 0.5e6, compressibility = 4.4e-10, specific_weight = 9810, flow_depth = 1}
support = [{on = ["west", "east"], components = ["x"]}, {on = ["south", "north"], components = ["y"]}]
well = [
  {name = "injection", at = [0, 0], pressure = PUMPED},
  {name = "top", at = {fracture = "fault", end = "end"}, pressure = "initial"},
  {name = "bottom", at = {fracture = "fault", end = "start"}, pressure = "initial"},
]
probe = [{name = "injection", at = [0, 0], on = "fault"}, {name = "P1", at = [0.63, 1.36], on = "fault"}]
[geometry]
domain = [-10, -10, 10, 10]
size = 1.5
size_at_fractures = 0.2
fracture = [{name = "fault", points = [[-4.63235, -10], [4.63235, 10]]}]
[fracture.fault]
normal_stiffness = 20e9
shear_stiffness = 20e9
aperture = 10e-6
friction_coefficient = 0.40403
"""
STAGE = 'stage=[{{kind = "quasi-static", time_step = {step}, end = 807}}]'


def pumped() -> list[list[float]]:
    """Pressure at the well: constant between jumps, which take BRIEF; the first a hundredth of a second."""
    table = table_of("task_b.csv")
    rows = zip(table["t_from_s"], table["t_to_s"], table["injection_pressure_Pa"], strict=True)
    points = [[0.0, 0.5e6]]
    for begin, end, value in rows:
        points += [[float(begin) or 0.01, float(value)], [float(end) - (BRIEF if end < END else 0.0), float(value)]]
    return points


def scene() -> str:
    """It without its stage."""
    return SCENE.replace("PUMPED", str(pumped()))


def run(step: float) -> Ran:
    """In steps of so many seconds: errors of slip and opening as each pressure ends, and of the first slip."""
    found, seconds = clocked(scene(), STAGE.format(step=step))
    time, limit = found.history["time"], table_of("task_b_limit.csv")
    curves = {
        "slip": (np.abs(found.probe("injection", "slip")) * 1e3, limit["slip_mm"]),
        "opening": (found.probe("P1", "opening") * 1e6, limit["opening_um"]),
    }
    ends = table_of("task_b.csv")["t_to_s"]
    some = np.isin(limit["t_s"], COMMON * np.ceil(ends / COMMON - 1))  # the last of each constant pressure
    errors = [
        rms(np.interp(limit["t_s"][some], time, values) - right[some], right[some]) for values, right in curves.values()
    ]
    slides = time[np.flatnonzero(np.abs(found.probe("injection", "plastic_slip")) > 0)[0]]
    early = slides <= FIRST_SLIP  # the step of the jump ends after it
    errors.append(1.0 if early else (slides - FIRST_SLIP) / END)
    about = {"slip": "slip at the injection [mm]", "opening": "opening at P1, 1.5 m away [µm]"}
    lines = tuple(
        Line(about[k], "time [s]", about[k], (time, values), (limit["t_s"][::9], right[::9]))
        for k, (values, right) in curves.items()
    )
    return Ran(tuple(errors), seconds, lines)


BENCHMARK = Benchmark(
    "Mont Terri Task B", "Task B",
    "DECOVALEX-2019 Task B with the parameters of OpenGeoSys's public deck TaskB_slip.prj; against steps of 0.25 s",
    "friction of 22 degrees is from memory; measurements at Mont Terri and the deck's own results were not at hand",
    (Bar("slip", 2e-4, None, 0.01), Bar("opening", 2e-5, None, 0.01), Bar("first slip", 4.0 / END)),
    run, (6.0, 3.0, 1.5), (), "time step [s]", own_limit=True,
)  # fmt: skip
