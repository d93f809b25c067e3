"""R06: Wijesinghe (1986), a fracture in compressed rock injected at constant pressure; cubic law.

Fracture, fluid and stress of the public benchmark "single_fracture" of OpenGeoSys (LIE, hydro-mechanics). Clean: rock of
1 Pa, so that each node of the film opens by itself, and the hyperbolic law. As in that benchmark: rock of 60 GPa, 0.1 m high
on either side of 25 m of fracture with linear joints; its bending is not in the similarity solution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from grids import tensor

from figures_verification.case import Bar, Case
from figures_verification.cases.r05 import BOOKS, SCENE, film, injection, similarity
from figures_verification.runs import solve

APERTURE, STIFFNESS, VISCOSITY, AT_REST, PUMPED = 1e-5, 1e11, 1e-3, 11e6, 11.9e6
DIFFUSIVITY = APERTURE**3 * STIFFNESS / (12 * VISCOSITY)
END, SHOWN = 100.0, 12.0
FRACTURE = f"""
[fracture.film]
normal_stiffness = {STIFFNESS}
shear_stiffness = {STIFFNESS}
aperture = {APERTURE}
"""
CLEAN = (
    SCENE.replace('units = "none"', "")
    .replace("youngs_modulus = 1e-15", "youngs_modulus = 1")
    .replace("viscosity = 1", f"viscosity = {VISCOSITY}")
    .replace("yy = -{pressure}", "yy = -50e6")
    .format(pressure=AT_REST)
)
CLEAN = (
    CLEAN[: CLEAN.index("[fracture.film]")]
    + FRACTURE
    + "friction_angle_deg = 30\n"
    + CLEAN[CLEAN.index("[[support]]") :]
)
ROCK = f"""
rock.rock = {{youngs_modulus = 60e9, poissons_ratio = 0}}
fluid = {{viscosity = {VISCOSITY}, initial_pressure = {AT_REST}}}
initial_stress.yy = -50e6
support = [{{on = "south", components = ["y"]}}, {{on = ["west", "east"], components = ["x"]}}]
load = [{{on = "north", traction = "initial-stress"}}]
{FRACTURE}
law = "linear"
"""


def clean(rule: str) -> Callable[[float], tuple[float, ...]]:
    """Of pressure and aperture after 100 s, over what is imposed, and of the volume; h and dt in equal parts of the whole."""
    w, flux = similarity(1 + (PUMPED - AT_REST) / (STIFFNESS * APERTURE))

    def at(size: float) -> tuple[float, ...]:
        n = round(1 / size)
        x = np.linspace(0, 9 * np.sqrt(DIFFUSIVITY * END), n + 1)
        found, pressure, opening = film(x, CLEAN + injection(f"pressure = {PUMPED}", END, n), rule)
        right = w(x / np.sqrt(4 * DIFFUSIVITY * END)) - 1
        fields = (pressure - AT_REST) / (STIFFNESS * APERTURE), opening / APERTURE
        volume = float(np.sum((opening[1:] + opening[:-1]) / 2 * np.diff(x)))
        lost = abs(volume / (flux * APERTURE * np.sqrt(DIFFUSIVITY * END)) - 1)  # of F0 d0 sqrt(D0/t)/2
        return *(float(np.abs(field - right).max() / 0.9) for field in fields), lost, found.open_books

    return at


def in_rock(triangles: bool) -> Callable[[float], tuple[float, ...]]:
    """Root mean square of the error of pressure and aperture on x < 12 m, over that of what they should be."""
    w, _ = similarity(1.9)

    def at(size: float) -> tuple[float, ...]:
        x = np.linspace(0, 25, round(25 / size) + 1)
        mesh = tensor(x, np.linspace(-0.1, 0.1, 5), {"film": (0.0, 0.0, 25.0)}, triangles)
        scene = ROCK + injection(f"pressure = {PUMPED}", END, round(10 / size))
        last = solve(scene, "method.flow_integrator=bdf2", "method.coupling=whole-lu", mesh=mesh).fractures[-1]
        place = last.points[:, 0]
        right, near = w(place / np.sqrt(4 * DIFFUSIVITY * END)) - 1, place <= SHOWN
        fields = (last.point["pressure"] - AT_REST) / (STIFFNESS * APERTURE), last.point["opening"] / APERTURE
        return tuple(float(np.sqrt(np.sum((f - right)[near] ** 2) / np.sum(right[near] ** 2))) for f in fields)

    return at


SOME = (1 / 24, 1 / 48)
ASKED = 2e-3  # of a rule of second order


def bars(most: float, order: float, asked: float | None = None) -> tuple[Bar, ...]:
    """Of the fields, of the volume and of the books."""
    fields = Bar("pressure", most, order, asked), Bar("aperture", most, order, asked)
    return *fields, Bar("volume", most, order - 0.25), BOOKS


CASES = (
    Case("R06 Wijesinghe, clean, backward-euler", bars(4.2e-3, 0.9), clean("backward-euler"), SOME, SOME, "h and dt"),
    Case("R06 Wijesinghe, clean, bdf2", bars(3.6e-4, 1.75, ASKED), clean("bdf2"), (*SOME, 1 / 96), SOME, "h and dt"),
    *(Case(f"R06 Wijesinghe in rock of 60 GPa, {'T3' if triangles else 'Q4'}", (Bar("pressure", 5e-3), Bar("aperture", 5e-3)),
           in_rock(triangles), (0.5, 0.25, 0.125), (0.25,), "h and dt")
      for triangles in (False, True)),
)  # fmt: skip
