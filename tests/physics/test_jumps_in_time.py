"""Tables that jump, and supports that are moved by jerks."""

from types import SimpleNamespace

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.integrators import HHT, GeneralisedAlpha, Newmark
from fracflow.model.dirichlet import PrescribedValues
from fracflow.scene.advice import advice
from fracflow.scene.scene import load
from fracflow.scene.values import TimeTable
from fracflow.solve.motion_terms import driven_by
from fracflow.solve.request import StepRule

from .test_along_fractures import ENDS, RIGID

STEP = TimeTable((0.0, 1.0), (2.0, 5.0), "step")
ROWS = TimeTable((0.0, 1.0, 1.0, 2.0), (0.0, 2.0, 5.0, 5.0))


@pytest.mark.serial
@pytest.mark.parametrize("table, before, after", [(STEP, 2.0, 5.0), (ROWS, 2.0, 5.0)], ids=["step", "rows"])
def test_a_jump_is_shared_by_the_halves_of_steps_around_it(table, before, after):
    """At the jump the mean; the right side where a stage begins, the left one where it ends; else what lies in the step."""
    assert table.around(1.0, 0.1, 0.1)[0] == pytest.approx(0.5 * (before + after), rel=1e-14)
    assert table.around(1.0, 0.0, 0.1)[0] == after
    assert table.around(1.0, 0.1, 0.0)[0] == before
    assert table.around(1.0, 0.0, 0.0)[0] == pytest.approx(table(1.0), rel=1e-14)
    assert table.around(1.0, 0.1, 0.3)[0] == pytest.approx(before + 0.75 * (after - before), rel=1e-14)
    assert table.around(1.02, 0.1, 0.1)[0] == pytest.approx(before + 0.7 * (after - before), rel=1e-12)
    assert table.around(1.06, 0.1, 0.1)[0] == table(1.06)
    assert table.around(0.9, 0.1, 0.1)[0] == table(0.9)


@pytest.mark.serial
@pytest.mark.parametrize("table, before, after", [(STEP, 2.0, 5.0), (ROWS, 2.0, 5.0)], ids=["step", "rows"])
def test_of_no_width_a_jump_is_all_ahead_or_all_past(table, before, after):
    """Only at the jump itself is half of it there; rows are linear up to it: 2 t."""
    left = 2.0 * 0.7 if table is ROWS else before
    assert table.around(np.array([0.7, 1.0, 1.3]), 0.0, 0.0).tolist() == [left, 0.5 * (before + after), after]
    assert [table(t) for t in (-1.0, 0.7, 1.0, 1.3, 9.0)] == [table(0.0), left, 0.5 * (before + after), after, after]


@pytest.mark.serial
def test_a_table_has_its_own_values_at_its_times():
    times, values = (0.0, 0.3, 0.7, 1.1), (0.1, 0.3, 0.2, 0.7)
    assert [TimeTable(times, values)(t) for t in times] == list(values)


@pytest.mark.serial
@pytest.mark.parametrize("offset", np.linspace(0.0, 1.0, 11))
def test_the_steps_together_give_the_integral(offset):
    """Halves at both ends of a stage: the trapezoid's sum over a step function is its integral wherever it jumps."""
    dt, jump = 0.1, 0.5 + 0.1 * offset
    table = TimeTable((0.0, jump), (2.0, 5.0), "step")
    times = dt * np.arange(21)
    values = table.around(times[1:-1], dt, dt)
    ends = table.around(0.0, 0.0, dt)[0] + table.around(2.0, dt, 0.0)[0]
    assert dt * (values.sum() + 0.5 * ends) == pytest.approx(2.0 * jump + 5.0 * (2.0 - jump), rel=1e-12)


BAR = """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0
density = 2500
[geometry]
domain = [0, 0, 4, 1]
size = 1
cells = "quads"
[[support]]
on = ["north", "south"]
components = ["y"]
[[support]]
on = "west"
displacement = {x = [[0, 0], [1e-3, 1e-3], [3e-3, -1e-3]]}
[[probe]]
name = "moved"
at = [0, 0]
[[probe]]
name = "end"
at = [4, 0]
[[stage]]
kind = "dynamic"
time_step = 1e-4
end = 2e-3
"""


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_a_support_moved_by_jerks_drives_at_its_own_velocity(run_scene, mass):
    """1 m/s, then -1 m/s, the mean between; Newmark's rule for the nodes held would ring between 0 and 2 m/s for ever."""
    found = run_scene(BAR, f"method.mass={mass}")
    speed, time = found.probe("moved", "velocity")[:, 0], found.history["time"]
    kink = int(np.argmin(np.abs(time - 1e-3)))
    assert speed[1:kink] == pytest.approx(1.0, rel=1e-9)  # the first row is the start, at rest
    assert speed[kink] == pytest.approx(0.0, abs=1e-9)
    assert speed[kink + 1 :] == pytest.approx(-1.0, rel=1e-9)
    assert found.closes()


@pytest.mark.parametrize("stepper", ["newmark", "explicit"])
@pytest.mark.parametrize("start", ["{x = 1e-3}", "{x = [[0, 0], [0, 1e-3], [1, 1e-3]]}"], ids=["displaced", "jumps"])
def test_a_support_that_begins_displaced_moves_there_in_the_first_step(run_scene, start, stepper):
    """Its work is that of the motion: 1 to 6 % of the energy was lost where the first instant put it there."""
    moved = f'support.1={{on = "west", displacement = {start}}}'
    found = run_scene(BAR, moved, f"method.stepper={stepper}", "method.mass=lumped")
    at = found.probe("moved", "displacement")[:, 0]
    assert at[0] == 0.0 and at[1:] == pytest.approx(1e-3, rel=1e-12)
    assert found.closes(1e-12) and found.history["energy/work_boundaries"][-1] > 0.0


@pytest.mark.serial
@pytest.mark.parametrize(
    ("override", "warns"),
    [
        ("support.1={on = 'west', displacement = {x = 1e-3}}", True),
        ("support.1={on = 'west', displacement_gradient = [[0, 0], [[[0, 1e-4], [1, 0]], 0]]}", True),
        ("title=x", False),
    ],
)
def test_a_support_that_begins_displaced_is_told(tmp_path, override, warns):
    (tmp_path / "scene.toml").write_text(BAR, encoding="utf-8")
    told = any("displaced from the start" in line for line in advice(load(tmp_path / "scene.toml", [override])))
    assert told == warns


FREE = BAR.replace("domain = [0, 0, 4, 1]", "domain = [0, 0, 1, 1]").replace("at = [4, 0]", "at = [1, 0]")
FREE = FREE.replace("time_step = 1e-4\nend = 2e-3", "time_step = 5e-6\nend = 5e-4")


def followed(times, jump, speed):
    """Displacement (n,) of the end of two cells that share their masses, whose other end jumps at once and goes on at a speed.

    M_ff u'' + K_ff u = -M_fh h'' - K_fh h: of w = u + M_ff^-1 M_fh h, which stays as it is in a jump of h, by modes.
    """
    mass, stiff = 2500 * 0.5 / 6 * np.array([[4, 1], [1, 2]]), 1e10 / 0.5 * np.array([[2, -1], [-1, 1]])
    share = np.linalg.solve(mass, 2500 * 0.5 / 6 * np.array([1, 0]))
    push = stiff @ share + 1e10 / 0.5 * np.array([1, 0])
    squared, modes = np.linalg.eig(np.linalg.solve(mass, stiff))
    omega, size = np.sqrt(squared), np.linalg.solve(modes, np.linalg.solve(mass, push)) / squared
    angle = np.outer(times, omega)
    found = size * (jump * (1 - np.cos(angle)) + speed * (times[:, None] - np.sin(angle) / omega))
    return found @ modes[1] - share[1] * (jump + speed * times)


JERKS = {  # motion of the support; jump, speed, time at which they come
    "displaced": ("1e-3", 1e-3, 0.0, 0.0),
    "jump at the start": ("[[0, 0], [0, 1e-3], [1, 1e-3]]", 1e-3, 0.0, 0.0),
    "jump": ("[[0, 0], [2e-4, 0], [2e-4, 1e-3], [1, 1e-3]]", 1e-3, 0.0, 2e-4),
    "ramp": ("[[0, 0], [1, 1]]", 0.0, 1.0, 0.0),
    "ramp in a second stage": ("[[0, 0], [2e-4, 0], [1.0002, 1]]", 0.0, 1.0, 2e-4),
}


@pytest.mark.parametrize(
    ("jerk", "stepper", "limit"),
    [(jerk, "newmark", 5e-2 if "start" in jerk or jerk == "displaced" else 2e-2) for jerk in JERKS]
    + [("ramp", "hht", 2e-3), ("ramp", "generalised-alpha", 2e-3), ("displaced", "implicit-euler", 0.1)],
)
def test_nodes_share_the_impulse_of_a_support_that_their_masses_couple_to(run_scene, jerk, stepper, limit):
    """Without M_fh of its first velocity they were off by a third of the motion, and by more as 1/dt in a jump."""
    moved, jump, speed, begin = JERKS[jerk]
    stages = (
        'stage=[{kind = "dynamic", time_step = 5e-6, end = 2e-4}, {kind = "dynamic", time_step = 5e-6, end = 5e-4}]'
    )
    more = [stages] if "second" in jerk else []
    support = f"support.1={{on = 'west', displacement = {{x = {moved}}}}}"
    found = run_scene(FREE, support, f"method.stepper={stepper}", "method.mass=consistent", *more)
    time = found.history["time"] - begin
    # in the first instants u follows the mean over the steps around a jump
    late = time > 2e-5
    right = followed(time[late], jump, speed)
    assert np.abs(found.probe("end", "displacement")[late, 0] - right).max() < limit * np.abs(right).max()
    assert found.closes()
    if stepper == "newmark":  # the support brings all: its inertia is no work of the scheme
        energy = found.history
        assert np.abs(energy["energy/scheme"]).max() < 1e-9 * np.abs(energy["energy/work_boundaries"]).max()


@pytest.mark.serial
@pytest.mark.parametrize(
    ("stepper", "refused"), [("hht", True), ("generalised-alpha", True), ("implicit-euler", False)]
)
@pytest.mark.parametrize("moved", ["1e-3", "[[0, 0], [1e-3, 0], [1e-3, 1e-4]]"], ids=["displaced", "jumps"])
def test_a_jump_of_a_support_whose_mass_free_nodes_share_is_refused_by_rules_that_lead(
    tmp_path, stepper, refused, moved
):
    (tmp_path / "scene.toml").write_text(BAR, encoding="utf-8")
    support = f"support.1={{on = 'west', displacement = {{x = {moved}}}}}"
    settings = [support, f"method.stepper={stepper}"]
    if refused:
        with pytest.raises(InputError, match="which jumps"):
            load(tmp_path / "scene.toml", [*settings, "method.mass=consistent"])
    else:
        load(tmp_path / "scene.toml", [*settings, "method.mass=consistent"])
    load(tmp_path / "scene.toml", settings)


PLATES = RIGID.replace('kind = "steady"\ntime_step = 1\nsteps = 2', 'kind = "dynamic"\ntime_step = 0.01\nsteps = 20')
FILM = (PLATES + ENDS, "fracture.slot.aperture='1 mm'", "rock.rock.density=2500", "initial_stress={xx = 0, yy = 0}",
        "well.in.pressure=0")  # fmt: skip


def test_a_plate_that_squeezes_a_film_drives_it_evenly(run_scene):
    """Rigid walls that close at V: p = 6 mu V x (L - x)/d^3 in every step, without a trace of ringing."""
    moving = "[[0, 0], [0, [[0, 0], [0.1, -1e-5], [0.2, -3e-5]]]]"  # the middles of the two blocks are 1 m apart
    found = run_scene(*FILM, f"support.0.displacement_gradient={moving}", "probe.quarter.at=[1, 1]")
    aperture, pressure = found.probe("quarter", "aperture"), found.probe("quarter", "pressure")
    speed = np.repeat([1e-4, 1.5e-4, 2e-4], [9, 1, 10])
    right = 6 * 1e-3 * speed * 1.0 * 2.0 / aperture[1:] ** 3
    assert pressure[1:] == pytest.approx(right, rel=1e-8)
    assert found.closes()


@pytest.mark.serial
@pytest.mark.parametrize("stepper", ["newmark", "explicit", "hht", "implicit-euler"])
@pytest.mark.parametrize("moving", ["-1e-5", "[[0, 0], [0.1, -1e-5], [1, -1e-5]]"], ids=["displaced", "ramp"])
def test_a_film_loses_what_its_walls_close_by(run_scene, moving, stepper):
    """Over its length of 3 m, to the last digit: a first velocity off by a factor of 2 loses half of it."""
    found = run_scene(*FILM, f"support.0.displacement_gradient=[[0, 0], [0, {moving}]]", f"method.stepper={stepper}")
    volumes = [
        found.history[name][-1] for name in found.history if name.startswith("well/") and name.endswith("volume")
    ]
    assert sum(volumes) == pytest.approx(-3e-5, rel=1e-10)
    assert found.closes()


@pytest.mark.parametrize("stepper", ["hht", "generalised-alpha"])
@pytest.mark.parametrize("moving", ["-1e-5", "[[0, 0], [0.1, -1e-5], [1, -1e-5]]"], ids=["displaced", "ramp"])
def test_a_compressible_film_loses_what_its_walls_close_by(run_scene, moving, stepper):
    """To the last digit once its own rates have died out: (1 - gamma)/gamma of them stay in a step.

    A first velocity that counts by 1 - gamma, and not by a half, lost 17 and 19 % of it, and 0.9 % after a ramp.
    """
    moved = f"support.0.displacement_gradient=[[0, 0], [0, {moving}]]"
    found = run_scene(*FILM, moved, f"method.stepper={stepper}", "fluid.compressibility=4e-10", "stage.0.steps=80")
    volumes = [found.history[f"well/{name}/volume"][-1] for name in ("in", "out")]
    assert sum(volumes) == pytest.approx(-3e-5, rel=1e-10)
    assert found.closes()


@pytest.mark.serial
@pytest.mark.parametrize("begins", ["[1e-3, 0], [1e-3, 1e-3]", "[9.5e-4, 0], [2e-3, 1e-3]"], ids=["jump", "bend"])
def test_rock_at_rest_until_a_support_moves_is_no_motion_that_feeds_on_itself(run_scene, begins):
    """One step before, its acceleration is there and works nothing but round-off, of which nothing was brought."""
    moved = f"support.1={{on = 'west', displacement = {{x = [[0, 0], {begins}, [3e-3, 1e-3]]}}}}"
    assert run_scene(BAR, moved, "method.stepper=explicit").closes()


@pytest.mark.serial
@pytest.mark.parametrize(
    ("override", "told"),
    [
        (
            "support.1={on = 'west', displacement = {x = [[0, 0], [1e-3, 5e-3], [2e-3, 0]]}}",
            "table rises by = 5 m/s is 0.0025",
        ),
        ("support.1={on = 'west', displacement = {x = [[0, 0], [1e-3, 1e-3]]}}", ""),
        (
            "absorbing=[{on = 'east', wave = {velocity = [[0, 0], [1e-3, 5]]}}]",
            "absorbing.0.wave.velocity = 5 m/s is 0.0025",
        ),
        ("absorbing=[{on = 'east', wave = {velocity = [[0, 0], [1e-3, 1]]}}]", ""),
    ],
)
def test_a_speed_at_which_rock_breaks_is_told(tmp_path, override, told):
    """c_p is 2000 m/s: of 2 m/s on the strain is a thousandth."""
    (tmp_path / "scene.toml").write_text(BAR, encoding="utf-8")
    lines = [line for line in advice(load(tmp_path / "scene.toml", [override])) if "which rock breaks" in line]
    assert len(lines) == bool(told) and all(told in line for line in lines)


@pytest.mark.serial
@pytest.mark.parametrize(("kind", "told"), [("quasi-static", True), ("dynamic", False)])
def test_a_stepper_that_no_stage_uses_is_told(tmp_path, kind, told):
    (tmp_path / "scene.toml").write_text(BAR, encoding="utf-8")
    scene = load(tmp_path / "scene.toml", ["method.stepper=hht", f"stage.0.kind={kind}"])
    assert any('method.stepper = "hht" does nothing' in line for line in advice(scene)) == told


@pytest.mark.serial
@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("[0, 0], [1e-3, 1e-3], [3e-3, 0], [4e-3, 1e-3]", True),
        ("[0, 0], [1e-3, 0], [4, 1]", False),
        ("[0, 0], [4, 1]", False),
    ],
)
def test_rows_of_a_table_past_the_last_stage_are_told(tmp_path, rows, told):
    """One row past it gives a slope up to there."""
    (tmp_path / "scene.toml").write_text(BAR, encoding="utf-8")
    scene = load(tmp_path / "scene.toml", [f"support.1={{on = 'west', displacement = {{x = [{rows}]}}}}"])
    assert any("support.1.displacement.x: its table goes on to 4 ms" in line for line in advice(scene)) == told


@pytest.mark.serial
@pytest.mark.parametrize("moved", [ROWS, TimeTable((0.0, 0.6, 1.4, 2.0), (2.0, 2.0, 5.0, 5.0))], ids=["jumps", "ramp"])
@pytest.mark.parametrize("stepper", [Newmark(), HHT(), GeneralisedAlpha(), Newmark(0.5, 0.8)])
def test_steps_that_are_cut_carry_on_all_motion_of_a_support(moved, stepper):
    """After a jump as they begin: its volume by rates, and velocities by accelerations, whatever lengths were planned."""
    draw = np.random.default_rng(3)
    held, dt = PrescribedValues(np.array([0]), moved), 0.13
    loads, start = SimpleNamespace(supports=[held]), moved(0.0) - 1.0
    time, at, speed, pushed, around = 0.0, start, float(held.first_speed(0.0, dt, start)), 0.0, (0.0, dt)
    volume, gained = 0.0, float(held.speed_over(0.0, dt, start))
    while time < 4.0:
        length = around[1] * draw.choice([1.0, 0.3, 0.7])
        planned = dt if time + length < 4.0 else 0.0
        alphas = stepper.alphas(length)
        gamma = alphas.gamma
        vectors = [
            SimpleNamespace(getArray=lambda readonly, value=value: np.array([value])) for value in (at, speed, pushed)
        ]
        motion = SimpleNamespace(vectors=vectors)
        state = SimpleNamespace(adjacent_steps=around, time=time, motion=motion)
        (made,) = driven_by(loads, state, StepRule(alphas, (length, planned), inertia=True), time + length)
        volume += length * ((1.0 - gamma) * speed + gamma * float(made.speed)) + float(made.beside_rates[0])
        gained += length * ((1.0 - gamma) * pushed + gamma * float(made.acceleration[0]))
        time, at, speed, pushed = time + length, moved(time + length), float(made.speed), float(made.acceleration[0])
        around = (length, planned)
    assert volume == pytest.approx(moved(4.0) - start, rel=1e-12)
    assert gained == pytest.approx(0.0, abs=1e-3)
