"""R17: two fractures that meet as a T, one pressed open and one that slips (Phan, Napier, Gray and Kaiser, 2003).

A vertical fracture of 100 m is pressed open by 100 MPa. A horizontal one of 50 m crosses its upper end, closed by 100 MPa,
with friction 1/sqrt(3); the rock is unbounded. Reference: displacement discontinuities, constant on elements (Crouch, 1976),
of the first order in their length, so that of two lengths the limit follows. Sections of the horizontal one all slip, away from
the other, or part where they would be drawn.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from grids import Floats

from figures_verification.case import Bar, Case
from figures_verification.runs import Found, solve

YOUNG, POISSON, PRESSURE, STRESS, FRICTION = 70e9, 0.2, 100e6, 100e6, 0.577350269
UP = 50.0  # half length of the vertical fracture
ALONG = 25.0  # of the horizontal one
HEIGHTS, PLACES = np.linspace(-49.5, 49.5, 199), np.linspace(0.5, 24.5, 97)  # y of openings and x of slips to compare


class Profiles(NamedTuple):
    """Opening of the vertical fracture at HEIGHTS, and size of the slip of the horizontal one at PLACES [m]."""

    opening: Floats
    slip: Floats


def stresses(x: Floats, y: Floats, half: Floats) -> tuple[Floats, Floats]:
    """Stresses (3, ...) xx, yy, xy at (x, y) by an element on |x| < ``half``, its unit tangential and normal discontinuity.

    A discontinuity is the lower wall's displacement less the upper one's, so that an opening is negative.
    """
    c, two_g = 1.0 / (4.0 * np.pi * (1.0 - POISSON)), YOUNG / (1.0 + POISSON)
    left, right = x - half, x + half
    near, far = left**2 + y**2, right**2 + y**2
    xy, yy = c * y * (1.0 / near - 1.0 / far), -c * (left / near - right / far)
    xyy = c * ((left**2 - y**2) / near**2 - (right**2 - y**2) / far**2)
    yyy = 2.0 * c * y * (left / near**2 - right / far**2)
    tangential = np.stack([2.0 * xy + y * xyy, -y * xyy, yy + y * yyy])
    return two_g * tangential, two_g * np.stack([yy + y * yyy, yy - y * yyy, -y * xyy])


def on_elements(count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Their middles and the unknowns by so many elements on each fracture: y, opening; x, slip to the left below."""
    y, x = (length * (2 * np.arange(count) + 1 - count) / count for length in (UP, ALONG))
    is_up = np.arange(2 * count) < count
    at = np.stack([np.r_[0 * y, x], np.r_[y, 0 * x + UP]], axis=1)
    apart = at[:, None] - at
    ahead = np.where(is_up, apart[..., 1], apart[..., 0])
    beside = np.where(is_up, -apart[..., 0], apart[..., 1])
    parts = stresses(ahead, beside, np.where(is_up, UP, ALONG) / count)
    turned = [np.where(is_up, part[[1, 0, 2]] * np.array([1, 1, -1])[:, None, None], part) for part in parts]
    by_all = np.concatenate(turned, axis=2)  # (3, targets, tangential and normal ones of sources)
    normal, shear = np.where(is_up[:, None], by_all[0], by_all[1]), by_all[2]
    away, parted = np.where(is_up, 0.0, np.sign(at[:, 0])), np.zeros(2 * count, dtype=bool)
    load = np.where(is_up, -PRESSURE, STRESS)
    for _ in range(30):
        free = is_up | parted
        held = np.hstack([np.zeros((2 * count, 2 * count)), np.eye(2 * count) * YOUNG])
        friction = np.where(free, 0.0, away * FRICTION)
        matrix = np.vstack([shear - friction[:, None] * normal, np.where(free[:, None], normal, held)])
        found = np.linalg.solve(matrix, np.r_[-friction * STRESS, np.where(free, load, 0.0)])
        drawn = ~is_up & np.where(parted, found[2 * count :] < 0.0, normal @ found > STRESS)
        if np.array_equal(drawn, parted):
            return y, -found[2 * count : 3 * count], x, found[count : 2 * count]
        parted = drawn
    raise ArithmeticError("R17: elements part and close again and again")


@cache
def limit(count: int = 200) -> Profiles:
    """In the limit of small elements, by so many on each fracture and twice as many; 200 give 0.2 % within 0.5 m of ends."""
    coarse, fine = (
        Profiles(np.interp(HEIGHTS, y, opening), np.interp(PLACES, x, np.abs(slip)))
        for y, opening, x, slip in (on_elements(count), on_elements(2 * count))
    )
    return Profiles(2 * fine.opening - coarse.opening, 2 * fine.slip - coarse.slip)


SCENE = f"""
rock.rock = {{{{youngs_modulus = {YOUNG}, poissons_ratio = {POISSON}}}}}
initial_stress = {{{{xx = 0, yy = -{STRESS}, zz = 0}}}}
fluid = {{{{viscosity = 1e-3, initial_pressure = 0}}}}
support = [{{{{on = ["south", "north", "east", "west"]}}}}]
stage = [{{{{kind = "steady", time_step = 0.5, steps = 2}}}}]
[geometry]
domain = [-1000, -950, 1000, 1050]
size = 100
size_at_fractures = {{size}}
size_at_tips = {{tip}}
growth = {{growth}}
cells = "quads"
fracture = [
  {{{{name = "vertical", points = [[0, -{UP}], [0, {UP}]]}}}},
  {{{{name = "horizontal", points = [[-{ALONG}, {UP}], [{ALONG}, {UP}]]}}}},
]
[fracture.vertical]
normal_stiffness = 1e9
shear_stiffness = 1e9
aperture = 1e-3
friction_coefficient = 0
pressure = [[0, 0], [1, {PRESSURE}]]
[fracture.horizontal]
normal_stiffness = 1e13
shear_stiffness = 1e13
aperture = 1e-3
friction_coefficient = {FRICTION}
pressure = 0
"""


def pressed(size: float) -> Found:
    """Run it on joints of ``size``, a quarter of that at tips; cells grow by a quarter of it a metre, so that rock follows."""
    return solve(SCENE.format(size=size, tip=size / 4, growth=size / 4))


def profiles_of(found: Found) -> Profiles:
    """Those of a run at the same places; the slip is the mean of both sides."""
    state = found.fractures[-1]
    x, y = state.points.T
    up, along = np.abs(x) < 1e-9, (np.abs(y - UP) < 1e-9) & (np.abs(x) > 1e-9)
    heights, first = np.unique(y[up], return_index=True)
    opening = np.interp(HEIGHTS, heights, state.point["opening"][up][first])
    order = np.argsort(x[along])
    x, slip = x[along][order], np.abs(state.point["slip"][along][order])
    return Profiles(opening, 0.5 * (np.interp(PLACES, x, slip) + np.interp(-PLACES, x, slip)))


def errors_of(found: Found) -> tuple[float, ...]:
    """Largest ones of opening and slip, over the largest opening and slip."""
    return tuple(
        float(np.abs(here - there).max() / there.max()) for here, there in zip(profiles_of(found), limit(), strict=True)
    )


def errors(size: float) -> tuple[float, ...]:
    """Those of a run on joints of ``size``."""
    return errors_of(pressed(size))


BARS = (Bar("opening", 0.0095, 0.8, 0.01), Bar("slip", 0.0095, 0.8, 0.01))
CASES = (Case("R17 T of two fractures", BARS, errors, (1.0, 0.5), (0.5,)),)
