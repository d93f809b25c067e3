"""Sides that absorb waves: pulses through a joint, reflections, reactions at the switch, energy that leaves."""

import numpy as np
import pytest
import tomllib
from figures_verification.cases import r03

from fracflow.elements.dashpot import (
    energy_over_directions,
    energy_returned,
    reflection,
    reflections,
    returned,
    silent_distance,
)
from fracflow.errors import InputError, SolveError
from fracflow.reduction import ReductionInput, decide
from fracflow.reduction.prepare import prepare
from fracflow.scene.materials import Rock
from fracflow.scene.scene import Scene, load

RHO, CP, SPEED, PULSE = r03.RHO, r03.CP, r03.SPEED, r03.PULSE


def test_all_that_came_in_leaves():
    """Z int v_I^2 dt = 3/8 Z V^2 T comes in; once the pulse has left both ways nothing is in the rock, and none came back."""
    found = r03.passed("p", 50, 1.35e10, 500)
    brought = 3 / 8 * RHO * CP * SPEED**2 * PULSE * 5.0 / 50
    energy = {name: found.history[f"energy/{name}"] for name in ("work_incident", "radiated", "kinetic", "rock_strain")}
    assert energy["work_incident"][-1] == pytest.approx(brought, rel=1e-5)
    assert energy["radiated"][-1] == pytest.approx(brought, rel=1e-4)
    assert energy["kinetic"][-1] + energy["rock_strain"][-1] < 1e-4 * brought
    assert np.all(np.diff(energy["radiated"]) >= -1e-6 * brought)
    assert found.open_books <= 1e-10


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


@pytest.mark.serial
@pytest.mark.parametrize("ratio", [0.0, 0.25, 0.45])
def test_energy_that_comes_back(ratio):
    """A free side sends back all of it, at any angle; P to S at one slowness is S to P (reciprocity); none is gained."""
    slow = np.sqrt((1 - 2 * ratio) / (2 - 2 * ratio))  # c_s/c_p
    for angle in (0.0, 20.0, 45.0, 60.0, 85.0):
        for kind in "ps":
            assert energy_returned(ratio, angle, kind, share=0.0) == pytest.approx(1.0, abs=1e-12)
            assert 0.0 <= energy_returned(ratio, angle, kind) < 1.0
        as_s = np.degrees(np.arcsin(slow * np.sin(np.radians(angle))))  # the way of S at the slowness of P
        from_p, from_s = returned(ratio, angle, "p")[1], returned(ratio, as_s, "s")[0]
        both = slow * np.cos(np.radians([as_s, angle])) / np.cos(np.radians([angle, as_s])) / np.array([1.0, slow**2])
        assert from_p**2 * both[0] == pytest.approx(from_s**2 * both[1], abs=1e-12)


@pytest.mark.serial
def test_conversions_of_known_angles():
    """Poisson's ratio 1/4: a free side turns P at 60 degrees into S altogether; dashpots S at 30 as P at 60."""
    assert returned(0.25, 60.0, "p", share=0.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert returned(0.25, 45.0, "p") == pytest.approx((0.0138, 0.0709), abs=1e-4)
    assert energy_returned(0.25, 30.0, "s") == pytest.approx(energy_returned(0.25, 60.0, "p"), rel=1e-9)
    assert returned(0.25, 45.0, "s")[0] == 0.0  # beyond the critical angle P fades


@pytest.mark.serial
@pytest.mark.parametrize("ratio", [0.0, 0.25, 0.45])
def test_energy_over_all_directions(ratio):
    """By a fine midpoint rule over sines; of S 2.3 times that of P at Poisson's ratio 1/4. Both are told."""
    sines = (np.arange(1000) + 0.5) / 1000
    for kind in "ps":
        fine = np.mean([energy_returned(ratio, np.degrees(np.arcsin(each)), kind) for each in sines])
        assert energy_over_directions(ratio, kind) == pytest.approx(fine, rel=2e-3)
    if ratio == 0.25:
        assert energy_over_directions(ratio, "s") / energy_over_directions(ratio, "p") == pytest.approx(2.32, abs=0.02)
        assert all(told in reflections(ratio)[n] for n, told in ((0, "2.4%"), (0, "0.071, 0.134"), (1, "5.6%")))


STRESSED = (
    r03.ROCK
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
EVENTS = '[[stage]]\nkind = "auto"\ntime_step = 60\nend = 3600\n'
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


@pytest.mark.parametrize(
    "sides, said",
    [
        (
            "[{on=['south'], WAVE}, {on=['north', 'east', 'west']}]",
            {"absorbing east, west: the wave of south runs along"},
        ),
        (
            "[{on=['south', 'east', 'west'], WAVE, direction=[0, 1]}}, {on=['north']}]",
            {"absorbing south, east, west: a fra"},
        ),
        ("[{on=['south'], WAVE}, {on=['north']}]", set()),
    ],
)
def test_sides_that_weaken_a_wave_or_know_no_fracture_are_told(shared_tmp, comm, sides, said):
    """Sides along the way of a wave took 55 % of it at their cells; a side beyond a joint is given the wave as it was."""
    wave = "wave={velocity=[[0, 0], [0.01, 1]]" + ("" if "direction" in sides else "}")
    seam = '[geometry]\nfracture = [{name = "seam", points = [[0, 50], [100, 50]]}]\nsize = 50\n'
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(OBLIQUE.replace("[geometry]\n", seam) + LINEAR)
    comm.barrier()
    settings = [f"absorbing={sides.replace('WAVE', wave)}", "stage=[{kind='dynamic', time_step=1e-4, steps=1}]"]
    notes = prepare(load(shared_tmp / "scene.toml", settings), comm).placed.notes
    told = {line for line in notes if "runs along" in line or "a fracture ends" in line}
    assert len(told) == len(said) and all(any(line.startswith(start) for line in told) for start in said)


LINEAR = "[fracture.seam]\nlaw = 'linear'\nnormal_stiffness = 1e9\nshear_stiffness = 1e9\n"


@pytest.mark.parametrize(
    ("kind", "direction", "held", "told"),
    [
        ("p", [0, 1], ["x"], ""),
        ("p", [0, 1], ["x", "y"], "y"),
        ("s", [0, 1], ["y"], ""),
        ("s", [0, 1], ["x"], "x"),
        ("s", [0.6, 0.8], ["x", "y"], ""),
    ],
)
def test_supports_that_hold_a_wave_along_a_side_are_told(shared_tmp, comm, kind, direction, held, told):
    """A joint across such a wave is left with 20 times the shear by an S wave, and 14 times by a P wave, once it has passed."""
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(OBLIQUE.replace("[geometry]\n", "[geometry]\nsize = 50\n"))
    comm.barrier()
    wave = f"wave={{kind='{kind}', velocity=[[0, 0], [0.01, 1]], direction={direction}}}"
    settings = [
        f"absorbing=[{{on=['south'], {wave}}}, {{on=['north']}}]",
        f"support=[{{on=['west', 'east'], components={held}}}]",
        "stage=[{kind='dynamic', time_step=1e-4, steps=1}]",
    ]
    notes = [line for line in prepare(load(shared_tmp / "scene.toml", settings), comm).placed.notes if "held" in line]
    assert len(notes) == bool(told)
    assert all(
        f"support west, east: the wave of south runs along there, and is held where it moves rock along {told}: " in n
        for n in notes
    )


@pytest.mark.serial
def test_less_along_a_side_sends_back_less_in_all_but_something_along_the_normal():
    """Why dashpots are whole: at a ratio of 1/4, 0.75 along them take 6.4 % for 8.1 %; 1/7 of S at 0 degrees is back."""
    whole, less = (sum(energy_over_directions(0.25, kind, (1.0, share)) for kind in "ps") for share in (1.0, 0.75))
    assert (whole, less) == (pytest.approx(0.081, abs=1e-3), pytest.approx(0.064, abs=1e-3))
    others = ((1.1, 0.75), (0.9, 0.75), (1.0, 0.9))
    around = [sum(energy_over_directions(0.25, kind, each) for kind in "ps") for each in others]
    assert min(around) > less
    assert returned(0.25, 0.0, "s", (1.0, 0.75))[1] == pytest.approx(1.0 / 7.0) and returned(0.25, 0.0, "s")[1] < 1e-12


@pytest.mark.serial
def test_the_plan_tells_how_far_sides_must_be_for_nothing_to_come_back():
    """c_p t/2 of all stages with inertia: 20 steps of 10 us, twice. How long events of a stage auto last is not known."""
    assert Rock(youngs_modulus=4.0, poissons_ratio=0.0, density=1.0).p_speed == 2.0 and silent_distance(2.0, 3.0) == 3.0
    said = []
    for more in ("", EVENTS):
        scene = Scene.from_data(tomllib.loads(STRESSED + STILL + STILL + more))
        said += [each.error for each in decide(ReductionInput(scene)) if each.part == "rock beyond absorbing sides"]
    (rock,) = scene.rock.values()
    known, unknown = said
    assert (
        f"put it {silent_distance(rock.p_speed, 4e-4):.3g} m from what slips and probes, so that nothing is back"
        in known
    )
    assert "nothing is back" not in unknown and "move it away" in unknown
