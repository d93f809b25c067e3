"""``fracflow.converge`` and ``--converge``: order and error it tells are those that a closed form shows."""

import subprocess
import sys

import numpy as np
import pytest
import winkler
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import fracflow
from fracflow._petsc import MPI
from fracflow.cli.app import app, with_levels
from fracflow.simulation.levels import at_level, order_in_time

# A bar of E = rho = 1 and nu = 0, so that c = 1, held at one end and pushed at the other.
BAR = """
units = "none"
title = "a bar pushed at its end"
output.pictures = false
rock.rock = {{youngs_modulus = 1, poissons_ratio = 0, density = 1}}
mesh.file = "bar.geo"
support = [{{on = ["south", "north"], components = ["y"]}}, {{on = "west"}}]
load = [{{on = "east", traction = [{push}, 0]}}]
probe = [
  {{name = "end", at = [1, 0], quantities = ["displacement", "velocity"]}},
  {{name = "middle", at = [0.51, 0], quantities = ["stress"]}},
]
stage = [{{kind = "dynamic", time_step = {step}, end = 1.5}}]
"""
GEO = """
n = {cells};
Point(1) = {{0, 0, 0}}; Point(2) = {{1, 0, 0}}; Point(3) = {{1, 0.1, 0}}; Point(4) = {{0, 0.1, 0}};
Line(1) = {{1, 2}}; Line(2) = {{2, 3}}; Line(3) = {{3, 4}}; Line(4) = {{4, 1}};
Curve Loop(1) = {{1, 2, 3, 4}}; Plane Surface(1) = {{1}};
Transfinite Curve {{1, 3}} = n + 1; Transfinite Curve {{2, 4}} = 2; Transfinite Surface {{1}}; Recombine Surface {{1}};
Physical Surface("rock") = {{1}};
Physical Curve("south") = {{1}}; Physical Curve("east") = {{2}};
Physical Curve("north") = {{3}}; Physical Curve("west") = {{4}};
"""


def bar(folder, push, cells=16, step=0.05):
    if MPI.COMM_WORLD.rank == 0:
        (folder / "bar.geo").write_text(GEO.format(cells=cells))
        (folder / "scene.toml").write_text(BAR.format(push=push, step=step))
    MPI.COMM_WORLD.barrier()
    return folder / "scene.toml"


def smooth(t):
    """sin^4(pi t) up to t = 1, whose third derivative is continuous."""
    return np.where(t < 1.0, np.sin(np.pi * np.minimum(t, 1.0)) ** 4, 0.0)


def by_name(rows):
    return {row.name: row for row in rows}


def test_smooth_wave_has_order_two_and_its_error_within_a_factor_of_two(shared_tmp):
    """d'Alembert: a push T(t) on the end of a bar makes it move at T(t); until the echo is back at t = 2."""
    times = np.linspace(0.0, 1.5, 1201)
    scene = fracflow.load(bar(shared_tmp, [[float(t), float(smooth(t))] for t in times]))
    run, rows = fracflow.converge(scene, shared_tmp / "out", 3)
    found = by_name(rows)
    coarse = fracflow.open(shared_tmp / "out" / "level-0").times
    assert run.times[::4] == pytest.approx(coarse, abs=1e-12)
    speed = run.probe("end")["velocity"][::4, 0]
    moved = run.probe("end")["displacement"][::4, 0]
    exact = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (smooth(times[1:]) + smooth(times[:-1])))])
    for name, wrong in (
        ("end velocity", speed - smooth(coarse)),
        ("end displacement", moved - np.interp(coarse, times, exact)),
    ):
        error = np.sqrt((wrong**2).mean())
        assert found[name].order == pytest.approx(2.0, abs=0.2) and not found[name].warning
        assert error / 2 <= found[name].error <= 2 * error
    assert found["kinetic"].order == pytest.approx(2.0, abs=0.3)
    assert found["middle stress"].order >= 1.0 - 0.3  # on a node of the coarsest mesh, at 0.5


@pytest.mark.serial
def test_a_force_that_jumps_is_told(shared_tmp):
    """The velocity of the end jumps: of at most first order, and the warning says so."""
    scene = fracflow.load(bar(shared_tmp, '{time = [0, 0.313], value = [0, 1], interpolation = "step"}'))
    found = by_name(fracflow.converge(scene, shared_tmp / "out", 3)[1])
    assert "end velocity" in found and found["end velocity"].warning and not found["end velocity"].order > 1.0
    for ending in ("csv", "json", "png"):
        assert (shared_tmp / "out" / f"converge.{ending}").stat().st_size > 100


@pytest.mark.serial
def test_at_the_command_line(tmp_path, capsys):
    """Levels that are there are not run again; two show no order; bad numbers are one line and exit code 2."""
    scene, out = str(bar(tmp_path, "1", 4, 0.25)), tmp_path / "out"
    words = ["run", scene, "-o", str(out), "--converge"]
    app([*words, "2"], standalone_mode=False)
    assert "two levels show no order" in capsys.readouterr().out
    written = (out / "level-1" / "history.h5").stat().st_mtime_ns
    app(with_levels(words), standalone_mode=False)
    told = capsys.readouterr().out
    assert "is there" in told and "Convergence over 3 levels, orders as observed" in told
    assert (out / "level-1" / "history.h5").stat().st_mtime_ns == written
    bad = subprocess.run([sys.executable, "-m", "fracflow", *words, "0"], capture_output=True, text=True)
    told = "fracflow: command line: --converge 0: must be a number of levels from 2 to 8\n"
    assert (bad.returncode, bad.stderr) == (2, told)


@pytest.mark.serial
def test_another_scene_in_its_folder_is_run_anew(tmp_path):
    file = bar(tmp_path, "1", 4, 0.25)
    fracflow.converge(fracflow.load(file), tmp_path / "out", 2)
    run, _ = fracflow.converge(fracflow.load(file, ["stage.0.time_step=0.125"]), tmp_path / "out", 2)
    assert run.steps["dt"][-1] == 0.0625
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("keep me")
    for options, out, told in (
        (["mesh.refine=11"], "new", "cut more than 12 times"),
        ([], "out/level-0", "holds a single run"),
        ([], "mine", "no run's"),
    ):
        with pytest.raises(fracflow.InputError, match=told):
            fracflow.converge(fracflow.load(file, options), tmp_path / out)


CRACK = """
units = "none"
output.pictures = false
rock.rock = {youngs_modulus = 1, poissons_ratio = 0.25, density = 1}
support = [{on = ["south", "north", "east", "west"]}]
geometry = {domain = [-4, -4, 4, 4], size = 2, size_at_fractures = 0.5, fracture = [{name = "c", points = [[-1, 0], [1, 0]]}]}
fracture.c = {law = "linear", normal_stiffness = 1e-9, shear_stiffness = 1e-9, aperture = 1e-3, pressure = 1}
fluid = {viscosity = 1}
probe = [{name = "middle", at = [0.05, 0], quantities = ["opening"]}, {name = "rock", at = [0.6, 0.7]}]
stage = [{kind = "steady", time_step = 1, steps = 1}]
"""


def test_a_crack_tip_leaves_order_one_and_is_told(shared_tmp):
    """K_I^2 h/a of the energy: Strang and Fix. Probes stay on the node that the coarsest mesh had for them."""
    if MPI.COMM_WORLD.rank == 0:
        (shared_tmp / "scene.toml").write_text(CRACK)
    MPI.COMM_WORLD.barrier()
    run, rows = fracflow.converge(fracflow.load(shared_tmp / "scene.toml"), shared_tmp / "out", 4)
    found = by_name(rows)
    assert found["rock_strain"].order == pytest.approx(1.0, abs=0.1)
    for name in ("rock_strain", "middle opening", "rock displacement"):
        assert found[name].order == pytest.approx(1.0, abs=0.3) and not found[name].warning
    places = [fracflow.load(shared_tmp / "out" / f"level-{k}" / "scene.toml").probe for k in (1, 3)]
    assert [probe.at for probe in places[0]] == [probe.at for probe in places[1]]
    assert places[0][1].on == "rock" and run.scene.geometry.refine == 3


@pytest.mark.serial
def test_an_event_has_order_two_and_its_error(shared_tmp):
    """The block of R02, u = 2 (1 - cos t), slips when u = 2: at pi/2."""
    given = ["output.pictures=false", "load.0.traction=[2, 0]", "stage.0.end=2"]
    run, rows = fracflow.converge(fracflow.load("meshes/report_5_2/scene.toml", given), shared_tmp / "out")
    found, wrong = by_name(rows)["lower slips first"], abs(run.events["start"].min() - np.pi / 2)
    assert found.order == pytest.approx(2.0, abs=0.15) and not found.warning
    assert wrong / 2 <= found.error <= 2 * wrong


@pytest.mark.serial
def test_both_steps_of_a_stage_auto_are_halved():
    scene = fracflow.load("meshes/failures/two_modes/scene.toml", ["stage.push.dynamic_time_step=0.4"])
    coarse, fine = (at_level(scene, level, {}).stage[0] for level in (0, 2))
    assert (coarse.time_step / fine.time_step, fine.dynamic_time_step) == (4.0, 0.1)
    assert order_in_time(scene) == 2 and scene.stage[0].kind == "auto"


DRAINED, PLACES = 0.2, (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6)


def drained():
    """w(xi) and w w' of (w w')' + 2 xi w' = 0, w(0) = DRAINED, w(inf) = 1, by shooting: Boussinesq's equation.

    On the hyperbola p - p0 = k_n d0 (1 - 1/w) the cubic law gives w_t = D (w w_x)_x, xi = x/sqrt(4 D t), D = d0^3 k_n/12 mu.
    """

    def shoot(flux):
        def slopes(xi, y):
            return [y[1] / y[0], -2.0 * xi * y[1] / y[0]]

        return solve_ivp(slopes, (0, 6), [DRAINED, flux], "DOP853", rtol=1e-11, atol=1e-13, dense_output=True)

    return shoot(brentq(lambda flux: shoot(flux).y[0, -1] - 1.0, 0.1, 2.0, xtol=1e-13)).sol


@pytest.mark.serial
def test_errors_are_within_a_factor_of_two_or_marked(tmp_path):
    """A fracture in columns that move alone, on the hyperbola, is drained at one end: 24 probes before and in the front."""
    start = 1.0 / DRAINED - 1.0  # over the pressure of the well, k_n = d0 = D = 1
    text = winkler.SCENE.format(pressure=start).replace("viscosity = 1", f"viscosity = {1 / 12}")
    text = text.replace('law = "linear"', "friction_coefficient = 0.6\ncohesion = 0").replace(
        "aperture = 10\n", "aperture = 1\n"
    )
    text = (
        text.replace("conductance = 1\n", "")
        + """
[[well]]
name = "out"
at = {fracture = "film", end = "start"}
pressure = 0
[[stage]]
kind = "quasi-static"
time_step = 0.01
steps = 4
"""
    )
    kept = 'quantities = ["opening", "pressure", "flow_rate"]'
    text += "".join(f'[[probe]]\nname = "{x}"\nat = [{x}, 0]\non = "film"\n{kept}\n' for x in PLACES)
    scene = fracflow.load(
        winkler.write(tmp_path, MPI.COMM_WORLD, np.linspace(0, 1, 21), text), ["method.flow_integrator=backward-euler"]
    )
    run, rows = fracflow.converge(scene, tmp_path / "out", 3)
    found, times = by_name(rows), fracflow.open(tmp_path / "out" / "level-0").times[1:]
    profile, ratios = drained(), []
    for x in PLACES:
        width, flux = profile(np.minimum(x / np.sqrt(4.0 * times), 6.0))
        exact = {
            "opening": width - 1.0,
            "pressure": start + 1.0 - 1.0 / width,
            "flow_rate": -flux / np.sqrt(4.0 * times),
        }
        for quantity, right in exact.items():
            history = run.probe(str(x))[quantity].reshape(len(run.times), -1)[4::4, 0 if quantity != "opening" else -1]
            row = found[f"{x} {quantity}"]
            true = np.sqrt(((history - right) ** 2).sum() / (len(times) + 1))  # at the start there is no error
            if not row.warning:
                ratios.append(true / row.error)
    assert len(ratios) >= 12 and min(ratios) >= 0.5 and max(ratios) <= 2.0, ratios
