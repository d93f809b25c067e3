"""R03: a plane pulse that meets a linear joint head on.

Schoenberg (J. Acoust. Soc. Am. 68, 1980): v_T' = a (v_I - v_T), a = 2k/Z, and the joint is strained by Z v_T/k. Central
differences with lumped mass whose step is the time across an element carry the pulse from node to node without error.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from figures_verification.case import Bar, Case
from figures_verification.runs import Floats, Found, solve

RHO, CP, CS, PULSE, SPEED = 2700.0, 5000.0, 2900.0, 1e-3, 0.01
SHEAR = RHO * CS**2
LAME = RHO * CP**2 - 2 * SHEAR
YOUNG, POISSON = SHEAR * (3 * LAME + 2 * SHEAR) / (LAME + SHEAR), LAME / (2 * (LAME + SHEAR))
ROCK = f"""
[output]
pictures = false
[rock.rock]
youngs_modulus = {YOUNG}
poissons_ratio = {POISSON}
density = {RHO}
"""


def pulse(rows=801):
    """V sin^2(pi t/T) as a table."""
    times = np.linspace(0.0, PULSE, rows)
    return [[float(t), float(SPEED * np.sin(np.pi * t / PULSE) ** 2)] for t in times]


GEO = """// A column of one row of quads, with a joint at 5 m and sides to absorb at its ends.
h = {size};
For i In {{0:2}}
  x = (i == 0) ? 0 : (i == 1) ? 5 : 15;
  Point(2*i + 1) = {{x, 0, 0}};
  Point(2*i + 2) = {{x, h, 0}};
  Line(10 + i) = {{2*i + 1, 2*i + 2}};
EndFor
For i In {{0:1}}
  Line(20 + i) = {{2*i + 1, 2*i + 3}};
  Line(30 + i) = {{2*i + 2, 2*i + 4}};
  Curve Loop(i + 1) = {{20 + i, 11 + i, -(30 + i), -(10 + i)}};
  Plane Surface(i + 1) = {{i + 1}};
  Transfinite Curve {{20 + i, 30 + i}} = (i + 1)*{each} + 1;
EndFor
Transfinite Curve {{10, 11, 12}} = 2;
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {{1, 2}};
Physical Curve("joint") = {{11}};
Physical Curve("west") = {{10}};
Physical Curve("east") = {{12}};
Physical Curve("rims") = {{20, 21, 30, 31}};
"""


SCENE = """
support = [{{on = "rims", components = ["{across}"]}}]
absorbing = [{{on = "west", wave = {{kind = "{kind}", velocity = {pulse}}}}}, {{on = "east"}}]
probe = [{{name = "joint", at = [5, 0]{on}}}, {{name = "west", at = [0, 0]}}, {{name = "inside", at = [4, 0]}}]
stage = [{{kind = "dynamic", time_step = {step}, steps = {steps}}}]
"""
JOINT = 'fracture.joint = {{law = "linear", normal_stiffness = {stiffness}, shear_stiffness = {stiffness}}}\n'


def passed(kind: str, each: int, stiffness: float, steps: int, *settings: str) -> Found:
    """A pulse along a column with ``each`` cells to 5 m, an element a step; without stiffness there is no joint."""
    speed, on = CP if kind == "p" else CS, ', on = "joint"' if stiffness else ""
    scene = (JOINT.format(stiffness=stiffness) if stiffness else "") + SCENE.format(
        kind=kind, across="y" if kind == "p" else "x", pulse=pulse(), step=5.0 / each / speed, steps=steps, on=on
    )
    mesh = GEO.format(each=each, size=5.0 / each)
    mesh = mesh if stiffness else mesh.replace('Physical Curve("joint") = {11};', "")
    return solve(scene + ROCK, *settings, mesh=mesh)


def transmitted(time: Floats, impedance: float, stiffness: float) -> Floats:
    """v_T at the joint since the pulse V sin^2(pi t/T) has come there."""
    a, w = 2 * stiffness / impedance, 2 * np.pi / PULSE

    def inside(t: Floats | float) -> Floats:
        part = 0.5 * SPEED * (1 - (a * a * np.cos(w * t) + a * w * np.sin(w * t)) / (a * a + w * w))
        return part - 0.5 * SPEED * (1 - a * a / (a * a + w * w)) * np.exp(-a * np.asarray(t))

    after = inside(PULSE) * np.exp(-a * np.clip(time - PULSE, 0, None))
    return np.where(time <= 0, 0.0, np.where(time <= PULSE, inside(np.clip(time, 0, PULSE)), after))


def errors(kind: str, stiffness: float, *settings: str) -> Callable[[float], tuple[float, ...]]:
    """Root mean square of the error of the jump Z v_T/k, over that of the jump, until 2.2 ms after the pulse came there.

    By the size of the cells [m].
    """
    speed = CP if kind == "p" else CS

    def at(size: float) -> tuple[float, ...]:
        each = round(5.0 / size)
        found = passed(kind, each, stiffness, int(2.2e-3 * speed / size) + each, *settings)
        jump = np.abs(found.probe("joint", "opening" if kind == "p" else "slip"))
        right = transmitted(found.history["time"] - 5.0 / speed, RHO * speed, stiffness) * RHO * speed / stiffness
        return (float(np.sqrt(np.sum((jump - right) ** 2) / np.sum(right**2))),)

    return at


def carried(size: float) -> tuple[float, ...]:
    """Of the displacement at 4 m in a P pulse, against that at 0 m when it was there; explicit, no joint."""
    late = round(4.0 / size)
    found = passed("p", round(5.0 / size), 0.0, 3 * late, EXPLICIT)
    here, there = (found.probe(name, "displacement")[:, 0] for name in ("west", "inside"))
    return (float(np.abs(there[late:] - here[:-late]).max() / np.abs(here).max()),)


EXPLICIT = "method.stepper=explicit"
COARSE, FINE = (0.2, 0.1), (0.1, 0.05)
JUMP = {"p": "opening", "s": "slip"}
IMPLICIT_BARS = (
    ("p", 1.35e9, 1.4e-3, COARSE, ()), ("p", 1.35e10, 3.3e-3, COARSE, ()), ("p", 1.35e11, 9e-3, COARSE, COARSE),
    ("s", 1.35e9, 1.9e-3, FINE, COARSE), ("s", 1.35e10, 5.6e-3, FINE, ()),
)  # fmt: skip
EXPLICIT_BARS = (("p", 1.35e9, 3e-4), ("p", 1.35e11, 2.2e-3), ("s", 1.35e10, 5.6e-3))
CASES = (
    *(Case(f"R03 {kind.upper()} through {k / 1e9:g} GPa/m", (Bar(JUMP[kind], most, 1.8),), errors(kind, k), sizes, quick, "dt")
      for kind, k, most, sizes, quick in IMPLICIT_BARS),
    *(Case(f"R03 {kind.upper()} through {k / 1e9:g} GPa/m, explicit", (Bar(JUMP[kind], most, 1.8),),
           errors(kind, k, EXPLICIT), COARSE, COARSE, "dt")
      for kind, k, most in EXPLICIT_BARS),
    Case("R03 P from node to node, explicit", (Bar("displacement", 1e-10),), carried, (0.5, 0.2), (0.5,)),
)  # fmt: skip
