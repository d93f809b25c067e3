"""Sides that absorb waves: pulses through a joint, reflections, reactions at the switch, energy that leaves."""

import numpy as np
import pytest

from fracflow._petsc import MPI

RHO, CP, CS, PULSE, SPEED = 2700.0, 5000.0, 2900.0, 1e-3, 0.01
SHEAR = RHO * CS**2
LAME = RHO * CP**2 - 2 * SHEAR
YOUNG, POISSON = SHEAR * (3 * LAME + 2 * SHEAR) / (LAME + SHEAR), LAME / (2 * (LAME + SHEAR))
ROCK = f"""
[output]
pictures = false
[rock.rock]
youngs_modulus = {YOUNG!r}
poissons_ratio = {POISSON!r}
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


@pytest.fixture
def column(shared_tmp):
    """Function (kind of wave, elements to 5 m, stiffness, steps) -> scene: a pulse up a column, an element a step."""

    def make(kind, each, stiffness, steps):
        speed = CP if kind == "p" else CS
        geo = shared_tmp / f"column{each}.geo"
        if MPI.COMM_WORLD.rank == 0:
            geo.write_text(GEO.format(each=each, size=5.0 / each))
        return (
            ROCK
            + f"""
[mesh]
file = "{geo}"
[fracture.joint]
law = "linear"
normal_stiffness = {stiffness}
shear_stiffness = {stiffness}
[[support]]
on = "rims"
components = ["{"y" if kind == "p" else "x"}"]
[[absorbing]]
on = "west"
wave = {{kind = "{kind}", velocity = {pulse()}}}
[[absorbing]]
on = "east"
[[probe]]
name = "joint"
at = [5, 0]
on = "joint"
[[probe]]
name = "far"
at = [15, 0]
[[stage]]
kind = "dynamic"
time_step = {5.0 / each / speed!r}
steps = {steps}
"""
        )

    return make


def transmitted(time, impedance, stiffness):
    """Schoenberg (1980): v_T' = a (v_I - v_T), a = 2k/Z, for v_I = V sin^2(pi t/T), in closed form."""
    a, w = 2 * stiffness / impedance, 2 * np.pi / PULSE

    def inside(t):
        part = 0.5 * SPEED * (1 - (a * a * np.cos(w * t) + a * w * np.sin(w * t)) / (a * a + w * w))
        return part - 0.5 * SPEED * (1 - a * a / (a * a + w * w)) * np.exp(-a * t)

    after = inside(PULSE) * np.exp(-a * np.clip(time - PULSE, 0, None))
    return np.where(time <= 0, 0.0, np.where(time <= PULSE, inside(np.clip(time, 0, PULSE)), after))


def joint_error(run_scene, column, kind, each, stiffness):
    """Relative root mean square error of the jump Z v_T/k, until 2.2 ms after the pulse has arrived there."""
    speed = CP if kind == "p" else CS
    found = run_scene(column(kind, each, stiffness, int(2.2e-3 * speed / (5.0 / each)) + each))
    jump = found.probe("joint", "opening" if kind == "p" else "slip")
    right = transmitted(found.history["time"] - 5.0 / speed, RHO * speed, stiffness) * RHO * speed / stiffness
    assert found.closes()
    return np.sqrt(np.sum((np.abs(jump) - right) ** 2) / np.sum(right**2))


@pytest.mark.parametrize("stiffness, expected", [(1.35e9, 1), (1.35e10, 3.2e-3), (1.35e11, 1)])
def test_a_p_pulse_through_a_joint(run_scene, column, stiffness, expected):
    """Second order, down to what lumped masses and the trapezoid have: 3.2e-3 at 50 elements of 5 m and 13.5 GPa/m."""
    errors = [joint_error(run_scene, column, "p", each, stiffness) for each in (25, 50)]
    print(stiffness, errors)
    assert np.log2(errors[0] / errors[1]) > 1.8


@pytest.mark.parametrize("stiffness", [1.35e9, 1.35e10, 1.35e11])
def test_an_s_pulse_through_a_joint(run_scene, column, stiffness):
    errors = [joint_error(run_scene, column, "s", each, stiffness) for each in (50, 100)]
    print(stiffness, errors)
    assert np.log2(errors[0] / errors[1]) > 1.8
