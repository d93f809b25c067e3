"""Tables are integrated exactly: volumes and impulses, whatever the step, wherever a table jumps or bends."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import winkler
from figures_verification.cases.r05 import LINEAR
from figures_verification.runs import solve
from grids import edges_of, msh, quads_of

from fracflow import open as opened
from fracflow.output.checkpoint import read_notes
from fracflow.scene.scene import load
from fracflow.scene.time_table import JUST_AFTER, JUST_BEFORE, Rates
from fracflow.scene.values import TimeTable
from fracflow.simulation.run import resume, run

from .test_along_fractures import ENDS, RIGID
from .test_jumps_in_time import BAR

pytestmark = pytest.mark.serial  # ranks share what one rank samples

DT = 0.1
BLOCK = Path(__file__).parents[2] / "meshes/report_5_2/scene.toml"
TABLES = {
    "at a step's end": {"time": [0.0, 0.2], "value": [1.0, 0.0], "interpolation": "step"},
    "within a step": {"time": [0.0, 0.23], "value": [1.0, 0.0], "interpolation": "step"},
    "pulse in a step": {"time": [0.0, 0.22, 0.26], "value": [0.0, 1.0, 0.0], "interpolation": "step"},
    "soon": {"time": [0.0, 0.01, 0.03], "value": [0.0, 1.0, -1.0], "interpolation": "step"},
    "a little": {"time": [0.0, 0.2, 0.2, 0.4], "value": [1.0, 1.0, 1.005, 0.0]},
    "bent": {"time": [0.0, 0.13, 0.27], "value": [0.0, 1.0, 0.0]},
    "all of these": {"time": [0.0, 0.13, 0.13, 0.2, 0.2, 0.37, 0.4], "value": [0.0, 1.0, 3.0, 2.0, -1.0, 1.0, 0.0]},
}  # fmt: skip
EVERY = pytest.mark.parametrize("name", TABLES)


def table_of(name):
    parts = TABLES[name]
    return TimeTable(tuple(parts["time"]), tuple(parts["value"]), parts.get("interpolation", "linear"))


def as_toml(name):
    parts = TABLES[name]
    end = ', interpolation = "step"' if "interpolation" in parts else ""
    return f"{{time = {parts['time']}, value = {parts['value']}{end}}}"


def integral(name, times):
    """By hand: rectangles and trapezia between all rows."""
    table, found = TABLES[name], []
    steps = "interpolation" in table
    rows = list(zip(table["time"], table["value"], strict=True))
    for time in times:
        total = 0.0
        for (t, v), (end, w) in zip(rows, [*rows[1:], (np.inf, rows[-1][1])], strict=True):
            last = min(time, end)
            if last > t:
                at_last = v if steps or not np.isfinite(end) else v + (w - v) * (last - t) / (end - t)
                total += (last - t) * 0.5 * (v + at_last)
        found.append(total)
    return np.array(found)


@EVERY
def test_means_and_sums_over_uneven_steps(name):
    """Means over the steps, and the trapezoid's sum of values at their ends, add up to the integral."""
    table, times = table_of(name), np.array([0.0, 0.017, 0.11, 0.15, 0.2, 0.31, 0.45])
    dt, exact = np.diff(times), integral(name, times)
    means = [table.mean(a, b) for a, b in pairwise(times)]
    assert np.cumsum(dt * means) == pytest.approx(exact[1:], abs=1e-15)
    before, after = np.append(0.0, dt), np.append(dt, 0.0)
    around = [(t, a, b) for t, a, b in zip(times, before, after, strict=True)]
    values = [table.around(*each)[0] + table.bent(*each) for each in around]
    assert np.sum(0.5 * (before + after) * values) == pytest.approx(exact[-1], abs=1e-15)


def film(name, *settings, kind="quasi-static", well="flow_rate", more=f"time_step = {DT}\nsteps = 5"):
    """Times, what the film of three nodes holds, and what is open in the books; k_n = 1 without a drain."""
    x = np.linspace(0, 1, 3)
    text = f'[[well]]\nname = "in"\nat = {{fracture = "film", end = "start"}}\n{well} = {as_toml(name)}\n'
    text += "".join(f'[[probe]]\nname = "{i}"\nat = [{a}, 0]\non = "film"\n' for i, a in enumerate(x.tolist()))
    found = solve(LINEAR + text + f'[[stage]]\nkind = "{kind}"\n{more}\n', *settings, mesh=winkler.mesh(x))
    opening = np.stack([found.probe(str(i), "opening") for i in range(3)], axis=1).reshape(-1, 3)
    return found, opening @ [0.25, 0.5, 0.25]


@EVERY
@pytest.mark.parametrize("rule", ["backward-euler", "bdf2", "trapezoid"])
def test_volume_in_a_film_without_a_drain(name, rule):
    """To round-off after every step; of the trapezoid, whose values at steps' ends share it, where nothing follows."""
    found, volume = film(name, f"method.flow_integrator={rule}")
    wrong = np.abs(volume - integral(name, found.history["time"]))
    assert (wrong[-1] if rule == "trapezoid" else wrong.max()) <= 2e-15
    assert found.open_books <= 1e-10


def test_volume_in_a_film_whatever_the_step():
    """Two hours of pumping by a step table, in steps of one and of a half: by means at jumps it would be 75 and 87.5 %."""
    for dt in (0.2, 0.1, 0.05):
        found, volume = film("at a step's end", more=f"time_step = {dt}\nend = 0.4")
        assert volume[-1] == pytest.approx(0.2, rel=1e-14)
        assert len(found.history["time"]) == 1 + round(0.4 / dt)


@pytest.mark.parametrize("rule", ["backward-euler", "bdf2", "trapezoid"])
def test_volume_in_a_film_of_a_stage_auto(rule):
    """Steps end within a billionth of one before a jump; the trapezoid foresees the next one, which may become another."""
    steps = f"time_step = {DT}\nend = 0.5\ndynamic_time_step = 1e-3"
    for name in ("pulse in a step", "a little", "bent", "all of these"):
        found, volume = film(name, f"method.flow_integrator={rule}", "accuracy.max_halvings=2", kind="auto", more=steps)
        wrong = np.abs(volume - integral(name, found.history["time"]))
        assert (wrong[-1] <= 1e-5 * volume[-1]) if rule == "trapezoid" else (wrong.max() <= 1e-12)
        assert found.open_books <= 1e-10


def test_volume_in_a_film_with_inertia():
    """A rate that begins at nothing, for walls at rest take up none at once."""
    for stepper in ("newmark", "explicit"):
        found, volume = film("bent", f"method.stepper={stepper}", kind="dynamic")
        assert volume[-1] == pytest.approx(0.135, rel=1e-13) and found.open_books <= 1e-10


def test_what_a_well_at_a_pressure_has_brought(tmp_path):
    """Of a stage auto, as the catalogue of events has it: what is in the film."""
    (tmp_path / "film.msh").write_text(winkler.mesh(np.linspace(0, 1, 3)))
    text = winkler.SCENE.format(pressure=0)
    text += (
        '[[well]]\nname = "in"\nat = {fracture = "film", end = "start"}\npressure = [[0, 0], [3, 1e-3], [9, 4e-3]]\n'
    )
    text += '[[well]]\nname = "out"\nat = {fracture = "film", end = "end"}\nflow_rate = [[0, 0], [5, -1e-4]]\n'
    text += "".join(f'[[probe]]\nname = "{i}"\nat = [{a}, 0]\non = "film"\n' for i, a in enumerate((0.0, 0.5, 1.0)))
    for number, stage in enumerate(
        ('kind = "auto"\ntime_step = 2\nend = 9', 'kind = "quasi-static"\ntime_step = 2\nsteps = 4')
    ):
        first = "[[stage]]\n" + stage + "\n"
        last = '[[stage]]\nkind = "auto"\ntime_step = 2\nend = 11\n'
        (tmp_path / "scene.toml").write_text(text + first + last)
        run(load(tmp_path / "scene.toml", ["output.pictures=false"]), tmp_path / str(number))
        found = opened(tmp_path / str(number))
        volume = np.array([found.probe(str(i))["opening"][-1] for i in range(3)]).ravel() @ [0.25, 0.5, 0.25]
        injected = read_notes(tmp_path / str(number) / "checkpoint.h5")["injected"]
        assert injected == pytest.approx(volume, rel=1e-12) and volume > 1e-3


def two_films():
    """A mesh like that of ``winkler``, with two films that do not meet, of three nodes each."""
    x = np.concatenate([np.linspace(0, 1, 3), np.linspace(2, 3, 3)])
    node = np.arange(3 * len(x)).reshape(3, -1)
    below, above = (quads_of(node[row : row + 2]) for row in (0, 1))
    points = np.array([[a, y] for y in (-1.0, 0.0, 1.0) for a in x])
    films = [("film", edges_of(node[1][:3])), ("other", edges_of(node[1][3:]))]
    return msh(points, [("wall", below), *films, ("springs", above), ("top", edges_of(node[2]))])


def test_volume_beside_a_well_at_its_limit():
    """Of BDF2: a film gets all that its well is given, though that of another film is kept at a pressure."""
    text = LINEAR.replace("[[support]]", FILM + "[[support]]", 1)
    text += '[[well]]\nname = "in"\nat = {fracture = "other", end = "start"}\nflow_rate = [[0, 1], [0.5, 0]]\n'
    text += '[[well]]\nname = "kept"\nat = {fracture = "film", end = "start"}\nflow_rate = 1\nmaximum_pressure = 0.02\n'
    text += "".join(f'[[probe]]\nname = "{i}"\nat = [{a}, 0]\non = "other"\n' for i, a in enumerate((2.0, 2.5, 3.0)))
    text += '[[probe]]\nname = "well"\nat = [0, 0]\non = "film"\n'
    text += '[[stage]]\nkind = "quasi-static"\ntime_step = 0.1\nsteps = 5\n'
    found = solve(text, "method.flow_integrator=bdf2", mesh=two_films())
    volume = sum(share * found.probe(str(i), "opening").ravel() for i, share in enumerate(SHARES))
    times = found.history["time"]
    assert found.probe("well", "pressure")[1:] == pytest.approx(0.02, rel=1e-12)
    assert volume == pytest.approx(times - times**2, abs=2e-15) and found.open_books <= 1e-10


FILM = """[fracture.other]
law = "linear"
normal_stiffness = 1
shear_stiffness = 1
aperture = 10
conductance = 1
"""
SHARES = (0.25, 0.5, 0.25)
WELLS = {
    "leaves its limit": "flow_rate = [[0, 1e-3], [4, 4e-3], [4.5, -1e-3], [9, -1e-3]]\nmaximum_pressure = 4e-3",
    "jumps": "pressure = [[0, 1e-3], [3, 1e-3], [3, 2e-3], [9, 4e-3]]",
}
AUTO = '[[stage]]\nkind = "auto"\ntime_step = 0.5\nend = 5.5\ndynamic_time_step = 1e-3\n'


def scene_of(folder, well, stage, fluid=""):
    """The file of a scene of a film of three nodes with one well, and a probe at each."""
    (folder / "film.msh").write_text(winkler.mesh(np.linspace(0, 1, 3)))
    text = winkler.SCENE.format(pressure=0).replace("[fluid]", f"[fluid]\n{fluid}")
    text += f'[[well]]\nname = "in"\nat = {{fracture = "film", end = "start"}}\n{well}\n'
    text += "".join(f'[[probe]]\nname = "{i}"\nat = [{a}, 0]\non = "film"\n' for i, a in enumerate((0.0, 0.5, 1.0)))
    (folder / "scene.toml").write_text(text + stage)
    return folder / "scene.toml"


def at_nodes(found, name):
    return np.stack([np.asarray(found.probe(str(i))[name]).ravel() for i in range(3)], axis=1)


def test_volume_of_a_well_that_leaves_its_limit(tmp_path):
    """Of BDF2: from the step in which it leaves it, its film takes up the integral of its table."""
    stage = '[[stage]]\nkind = "quasi-static"\ntime_step = 0.25\nend = 6\n'
    scene = load(scene_of(tmp_path, WELLS["leaves its limit"], stage), ["method.flow_integrator=bdf2"])
    run(scene, tmp_path / "run")
    found = opened(tmp_path / "run")
    taken, (free,) = (
        np.diff(at_nodes(found, "opening") @ SHARES),
        np.nonzero(at_nodes(found, "pressure")[1:, 0] < 3.999e-3),
    )
    table = scene.well[0].flow_rate
    asked = [(b - a) * table.mean(a, b) for a, b in pairwise(found.times)]
    assert 5 < len(free) < 20 and taken[free] == pytest.approx(np.array(asked)[free], abs=1e-14)


@pytest.mark.parametrize("compressibility", [0.0, 0.05])
@pytest.mark.parametrize("rule", ["backward-euler", "bdf2", "trapezoid"])
def test_what_wells_have_brought_is_what_a_film_holds(tmp_path, rule, compressibility):
    """Also at a limit, off it, and where a pressure jumps; a compressible fluid counts by its mass."""
    for name, well in WELLS.items():
        fluid = f"compressibility = {compressibility}" if compressibility else ""
        folder = tmp_path / name.replace(" ", "-")
        folder.mkdir()
        run(load(scene_of(folder, well, AUTO, fluid), [f"method.flow_integrator={rule}"]), folder / "run")
        found = opened(folder / "run")
        opening, pressure = (at_nodes(found, each)[-1] for each in ("opening", "pressure"))
        held = np.array(SHARES) @ (opening + (10.0 + opening) * np.expm1(compressibility * pressure))
        assert read_notes(folder / "run" / "checkpoint.h5")["injected"] == pytest.approx(held, rel=1e-9), name


def test_a_resumed_run_knows_what_wells_have_brought(tmp_path):
    """And what went through a well at its limit: to the last bit, at whatever step it was cut."""
    scene = load(
        scene_of(tmp_path, WELLS["leaves its limit"], AUTO),
        ["method.flow_integrator=bdf2", "output.checkpoint_every=1"],
    )
    run(scene, tmp_path / "whole")
    whole = read_notes(tmp_path / "whole" / "checkpoint.h5")

    def stop(step):
        if step.state.time > 3.2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(scene, tmp_path / "cut", progress=stop)
    resume(tmp_path / "cut")
    again = read_notes(tmp_path / "cut" / "checkpoint.h5")
    assert "resumed after" in (tmp_path / "cut" / "log.txt").read_text()
    assert again["through"] == whole["through"] != {}
    assert again["injected"] == whole["injected"] != 0.0


def momentum(name, *settings):
    """Times and momentum of a block of mass 1 between joints without stiffness."""
    given = ["output.pictures=false", "fracture.default.law=linear", f"load.0.traction=[{as_toml(name)}, 0]"]
    given += ["fracture.default.normal_stiffness=1e-14", "fracture.default.shear_stiffness=1e-14"]
    given += [f"stage.0.time_step={DT}", "stage.0.end=0.6"]
    found = solve(BLOCK, *given, *settings)
    assert found.open_books <= 1e-10
    return found.history["time"], found.probe("block", "velocity")[:, 0]


@pytest.mark.parametrize("events", ["located", "at-step-ends"])
@pytest.mark.parametrize("stepper", ["newmark", "explicit", "implicit-euler"])
def test_impulse_of_a_load(stepper, events):
    for name in (
        "at a step's end",
        "pulse in a step",
        "soon",
        "all of these",
    ):
        times, speed = momentum(name, f"method.stepper={stepper}", f"method.events={events}")
        assert speed[-1] == pytest.approx(integral(name, times)[-1], abs=1e-13), name


@pytest.mark.parametrize("stepper", ["newmark", "explicit", "implicit-euler", "hht", "generalised-alpha"])
def test_a_stage_that_begins_before_a_jump_knows_nothing_of_it(stepper):
    """The first part ends at the jump, a third into the step; until then there is no load."""
    given = ["output.pictures=false", "fracture.default.law=linear", f"method.stepper={stepper}"]
    given += ['load.0.traction=[{time = [0, 0.03], value = [0, 1], interpolation = "step"}, 0]']
    found = solve(BLOCK, *given, f"stage.0.time_step={DT}", f"stage.0.end={DT}")
    assert found.history["time"] == pytest.approx([0.0, 0.03, DT], abs=1e-14)
    kinetic = found.history["energy/kinetic"]
    assert kinetic[1] == 0.0 < kinetic[2]


@pytest.mark.parametrize("stepper", ["hht", "generalised-alpha"])
def test_impulse_of_a_load_on_rules_that_damp(stepper):
    """Exact where they begin anew at jumps between which the load is constant, and once their own transients are over."""
    given = (f"method.stepper={stepper}", "method.rho_infinity=0.2")[: 1 + (stepper == "generalised-alpha")]
    for name, events in (("pulse in a step", "located"), ("bent", "located"), ("all of these", "at-step-ends")):
        times, speed = momentum(name, *given, f"method.events={events}", "stage.0.end=2")
        assert speed[-1] == pytest.approx(integral(name, times)[-1], abs=2e-9), name


ROWS = "[[0, 0], [0.13, 1], [0.13, 3], [0.2, 2], [0.2, -1], [0.37, 1], [0.4, 0]]"


def just_before(times):
    table = table_of("all of these")
    return np.array([table(time, JUST_BEFORE) for time in times])


@pytest.mark.parametrize("kind", ["quasi-static", "steady"])
def test_what_is_prescribed_holds_as_just_before_the_end_of_a_step(run_scene, kind):
    """Supports, loads and pressures; parts of steps end at their jumps, so that 0.13, within one, is on record."""
    bar = BAR.replace("[[0, 0], [1e-3, 1e-3], [3e-3, -1e-3]]", ROWS)
    moved = run_scene(bar, f"stage.0.kind={kind}", "stage.0.time_step=0.1", "stage.0.end=0.5")
    times = moved.history["time"]
    assert times == pytest.approx([0, 0.1, 0.13, 0.2, 0.3, 0.4, 0.5], abs=1e-14)
    assert moved.probe("moved", "displacement")[1:, 0] == pytest.approx(just_before(times[1:]), abs=1e-14)
    pulled = BAR.replace("displacement = {x = [[0, 0], [1e-3, 1e-3], [3e-3, -1e-3]]}", 'components = ["x"]')
    pulled += f'[[load]]\non = "east"\ntraction = [{ROWS}, 0]\n'
    found = run_scene(pulled, f"stage.0.kind={kind}", "stage.0.time_step=0.1", "stage.0.end=0.5")
    stretched = found.probe("end", "displacement")[:, 0] * 1e10 / 4.0
    assert found.closes()
    assert stretched[1:] == pytest.approx(just_before(times[1:]), rel=1e-10, abs=1e-10)
    flow = RIGID + ENDS.replace("pressure = 1e4", f"pressure = {ROWS}")
    found = run_scene(flow, f"stage.0.kind={kind}", "stage.0.time_step=0.1", "stage.0.steps=5")
    ends = found.probe("quarter", "pressure")[1:-2] / just_before(times)[1:-2]
    assert ends == pytest.approx(ends[0], rel=1e-9) and found.closes()


def test_what_is_no_table_is_there_whole_whatever_the_weights():
    for rates in (Rates(), Rates(now=0.7, share=0.3), Rates(now=1.5, last=0.5, share=0.0, begin=1.0)):
        assert rates.of(lambda time: 2.0, 2.0, "load", {"load": 3.0}) == 6.0


def test_sides_of_a_jump_at_the_beginning():
    """A stage, and one that takes no time, begins with what comes after a jump."""
    table = TimeTable((0.0, 0.0), (1.0, 2.0))
    assert [table(0.0, side) for side in (JUST_BEFORE, JUST_AFTER)] == [1.0, 2.0]


def test_a_steady_stage_of_a_number_of_steps_needs_no_time(run_scene):
    found = run_scene(RIGID.replace("time_step = 1\n", "") + ENDS)
    given = run_scene(RIGID + ENDS)
    assert found.history["time"].tolist() == [0.0, 0.0, 0.0]
    assert found.probe("quarter", "pressure") == pytest.approx(given.probe("quarter", "pressure"), rel=1e-14)
