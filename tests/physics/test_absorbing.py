"""Sides that absorb waves: pulses through a joint, reflections, reactions at the switch, energy that leaves."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.elements.dashpot import reflection
from fracflow.errors import InputError, SolveError

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


def joint_error(run_scene, column, kind, each, stiffness, *overrides):
    """Relative root mean square error of the jump Z v_T/k, until 2.2 ms after the pulse has arrived there."""
    speed = CP if kind == "p" else CS
    found = run_scene(column(kind, each, stiffness, int(2.2e-3 * speed / (5.0 / each)) + each), *overrides)
    jump = found.probe("joint", "opening" if kind == "p" else "slip")
    right = transmitted(found.history["time"] - 5.0 / speed, RHO * speed, stiffness) * RHO * speed / stiffness
    assert found.closes()
    return np.sqrt(np.sum((np.abs(jump) - right) ** 2) / np.sum(right**2))


@pytest.mark.parametrize("stiffness, limit", [(1.35e9, 1.32e-3), (1.35e10, 3.2e-3), (1.35e11, 8.8e-3)])
def test_a_p_pulse_through_a_joint(run_scene, column, stiffness, limit):
    """Second order, down to what lumped masses and the trapezoid have: 3.2e-3 at 50 elements of 5 m and 13.5 GPa/m."""
    errors = [joint_error(run_scene, column, "p", each, stiffness) for each in (25, 50)]
    assert np.log2(errors[0] / errors[1]) > 1.8 and errors[1] < limit, errors


@pytest.mark.parametrize("stiffness, limit", [(1.35e9, 1.9e-3), (1.35e10, 5.6e-3)])
def test_an_s_pulse_through_a_joint(run_scene, column, stiffness, limit):
    errors = [joint_error(run_scene, column, "s", each, stiffness) for each in (50, 100)]
    assert np.log2(errors[0] / errors[1]) > 1.8 and errors[1] < limit, errors


@pytest.mark.parametrize("kind, stiffness", [("p", 1.35e9), ("p", 1.35e11), ("s", 1.35e10)])
def test_explicit_steps_pass_a_joint_more_exactly(run_scene, column, kind, stiffness):
    """R03 with C v met at the end of each step: of second order at CFL 1, and nearer than implicit steps of that length.

    The columns of S waves are held along x: their critical step is that of S waves too.
    """
    errors = [joint_error(run_scene, column, kind, each, stiffness, "method.stepper=explicit") for each in (25, 50)]
    assert np.log2(errors[0] / errors[1]) > 1.8 and errors[1] < joint_error(run_scene, column, kind, 50, stiffness)


def test_all_that_came_in_leaves(run_scene, column):
    """Z int v_I^2 dt = 3/8 Z V^2 T comes in; once the pulse has left both ways nothing is in the rock, and none came back."""
    found = run_scene(column("p", 50, 1.35e10, 500))
    brought = 3 / 8 * RHO * CP * SPEED**2 * PULSE * 5.0 / 50
    energy = {name: found.history[f"energy/{name}"] for name in ("work_incident", "radiated", "kinetic", "rock_strain")}
    assert energy["work_incident"][-1] == pytest.approx(brought, rel=1e-5)
    assert energy["radiated"][-1] == pytest.approx(brought, rel=1e-4)
    assert energy["kinetic"][-1] + energy["rock_strain"][-1] < 1e-4 * brought
    assert np.all(np.diff(energy["radiated"]) >= -1e-6 * brought)
    assert found.closes()


OBLIQUE = """
[output]
pictures = false
[rock.rock]
youngs_modulus = 10e9
poissons_ratio = 0.25
density = 2500
[geometry]
domain = [0, 0, 100, 100]
cells = "quads"
"""


@pytest.mark.parametrize("kind, limit", [("s", 0.03), ("p", 0.01)])
def test_a_wave_comes_in_at_an_angle(run_scene, kind, limit):
    """At 31 degrees through two sides it passes (30, 40) as sin^2(pi T/20 ms), T = t - x d/c, along d or across it.

    Of second order in the size of cells; delays by the speed of the other wave would leave about as much as came.
    """
    shear = 10e9 / 2.5
    speed, length = np.sqrt(shear * (3.0 if kind == "p" else 1.0) / 2500), 0.02
    d = np.array([np.cos(np.radians(31.0)), np.sin(np.radians(31.0))])
    table = [[float(t), float(np.sin(np.pi * t / length) ** 2)] for t in np.linspace(0, length, 201)]
    delay = np.array([30.0, 40.0]) @ d / speed
    errors = []
    for size in (2.5, 1.25):
        step = 8e-5 * size
        found = run_scene(
            OBLIQUE + f"size = {size}\n",
            f"absorbing=[{{on=['west', 'south'], wave={{kind='{kind}', velocity={table}, direction={d.tolist()}}}}},"
            " {on=['east', 'north']}]",
            "probe=[{name='inside', at=[30, 40], quantities=['velocity']}]",
            f"stage=[{{kind='dynamic', time_step={step}, steps={int((delay + 1.1 * length) / step)}}}]",
            "method.stepper=explicit",
        )
        since = found.history["time"] - delay
        right = np.where((since > 0) & (since < length), np.sin(np.pi * since / length) ** 2, 0.0)[:, None]
        way = d if kind == "p" else np.array([-d[1], d[0]])
        errors.append(np.linalg.norm(found.probe("inside", "velocity") - right * way) / np.linalg.norm(right))
        assert found.closes(1e-9)
    assert np.log2(errors[0] / errors[1]) > 1.7 and errors[1] < limit, errors


@pytest.mark.serial
@pytest.mark.parametrize(
    "angle, kind, back",
    [(0, "p", 0.0), (45, "p", 0.014), (60, "p", 0.134), (75, "p", 0.413), (0, "s", 0.0), (20, "s", 0.0876)],
)
def test_reflection(angle, kind, back):
    """Poisson's ratio 1/4; those of P at 60 and of S at 20 degrees are what runs show."""
    assert reflection(0.25, angle, kind) == pytest.approx(back, abs=6e-4)


STRESSED = (
    ROCK
    + """
[geometry]
domain = [0, 0, 4, 3]
size = 0.8
[[geometry.fracture]]
name = "crack"
points = [[1, 1], [3, 2]]
[fracture.crack]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_angle_deg = 30
cohesion = 1e9
[initial_stress]
xx = -5e6
yy = -8e6
xy = 1e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
[[absorbing]]
on = ["west", "east", "south", "north"]
[[well]]
name = "in"
at = {fracture = "crack", end = "start"}
pressure = 3e6
[[probe]]
name = "inside"
at = [2, 1.5]
quantities = ["velocity", "displacement", "opening"]
[[probe]]
name = "corner"
at = [4, 3]
"""
)
STILL = """
[[stage]]
kind = "steady"
time_step = 1
steps = 1
[[stage]]
kind = "dynamic"
time_step = 1e-5
steps = 20
"""
AT_ONCE = STILL[STILL.index("[[stage]]", 5) :]


@pytest.mark.parametrize("stages", [STILL, STILL + STILL, AT_ONCE], ids=["once", "twice", "at once"])
def test_the_switch_radiates_nothing(run_scene, stages):
    """Sides that a stage without inertia has held hand their reactions over: rock at rest stays so."""
    kept = () if stages.count("steady") else ("well.in.pressure='initial'",)
    found = run_scene(STRESSED + stages, *kept)
    pushed = np.abs(found.probe("inside", "opening")).max()
    assert pushed > 1e-6 or kept
    size = max(pushed, 1e-6) / 1e-5
    assert np.abs(found.probe("inside", "velocity")).max() <= 1e-9 * size
    assert np.abs(found.probe("corner", "velocity")).max() <= 1e-9 * size
    assert np.abs(found.probe("corner", "displacement")).max() <= 1e-9 * size * 1e-5
    assert found.closes()


def test_sides_left_free_hold_nothing_without_inertia(run_scene):
    """Then supports must hold the rock, and here none does: however round-off falls, the block is named."""
    with pytest.raises(SolveError, match=r"block 0 .* has no support in x, y, rotation .*hold it by a \[\[support"):
        run_scene(STRESSED + STILL, "absorbing.0.without_inertia='free'", *BALANCED)


def test_sides_left_free_still_absorb(run_scene):
    """With loads that balance the initial stress the rock is at rest from the start, and a well moves it by steps."""
    found = run_scene(STRESSED + AT_ONCE, "absorbing.0.without_inertia='free'", *BALANCED)
    assert found.history["energy/radiated"][-1] > 0.0
    assert found.closes()


BALANCED = ("load=[{on = ['west', 'east', 'south', 'north'], traction = 'initial-stress'}]",)


@pytest.mark.parametrize(
    "change, message",
    [
        ("absorbing.0.on=['west', 'middle']", 'absorbing.0.on = "middle": not in the mesh'),
        ("absorbing.0.on=['west', 'west']", 'names "west" again'),
        ("absorbing.0.wave={velocity = 1}", "give wave.direction"),
        ("absorbing.0.wave={velocity = 1, direction = [0, 0]}", "is no direction"),
        ("absorbing.0.wave={direction = [0, 1]}", "velocity"),
        ("rock.rock.rigid=true", "lies on a rigid rock"),
    ],
)
def test_bad_input(run_scene, change, message):
    with pytest.raises(InputError) as caught:
        run_scene(STRESSED + STILL, change)
    assert message in str(caught.value) and "\n" not in str(caught.value)
