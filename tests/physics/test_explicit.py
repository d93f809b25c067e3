"""Explicit stages: d'Alembert at CFL 1, order with a joint, the same as implicit steps, books, refusals, ranks."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.explicit import ExplicitSteps
from fracflow.errors import InputError, NotConverged, SolveError
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve.leapfrog.joints import JointSolver

MESHES = Path(__file__).parents[2] / "meshes"
BAR_GEO = """
n = {n}; h = {h};
For i In {{0:2}}
  Point(2*i + 1) = {{(i - 1)*n*h, 0, 0}};
  Point(2*i + 2) = {{(i - 1)*n*h, h, 0}};
  Line(10 + i) = {{2*i + 1, 2*i + 2}};
EndFor
For i In {{0:1}}
  Line(20 + i) = {{2*i + 1, 2*i + 3}};
  Line(30 + i) = {{2*i + 2, 2*i + 4}};
  Curve Loop(i + 1) = {{20 + i, 11 + i, -(30 + i), -(10 + i)}};
  Plane Surface(i + 1) = {{i + 1}};
EndFor
Transfinite Curve {{10:12}} = 2;
Transfinite Curve {{20, 21, 30, 31}} = n + 1;
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {{1, 2}};
{joint}
Physical Curve("west") = {{10}};
Physical Curve("east") = {{12}};
Physical Curve("south") = {{20, 21}};
Physical Curve("north") = {{30, 31}};
"""
BAR = """
units = "none"
[output]
pictures = false
[method]
stepper = "explicit"
[mesh]
file = "bar.geo"
[rock.rock]
youngs_modulus = 1
poissons_ratio = 0
density = 1
[[support]]
on = ["south", "north"]
components = ["y"]
[[support]]
on = "west"
components = ["x"]
displacement = {{x = {pulse}}}
[[probe]]
name = "before"
at = [-0.5, 0]
[[probe]]
name = "behind"
at = [0.5, 0]
[[probe]]
name = "end"
at = [1, 0]
[[stage]]
kind = "dynamic"
time_step = {dt}
end = {end}
"""
JOINT = """
[fracture.joint]
law = "linear"
normal_stiffness = {k}
shear_stiffness = {k}
"""


@pytest.fixture
def bar(run_scene, shared_tmp):
    """Function (cells in each half, pulse (t, x), end, stiffness or None) -> Ran; half length 1, c = 1, dt = h/c."""

    def once(n, pulse, end, stiffness=None, *overrides):
        curve = 'Physical Curve("joint") = {11};' if stiffness is not None else ""
        if MPI.COMM_WORLD.rank == 0:
            (shared_tmp / "bar.geo").write_text(BAR_GEO.format(n=n, h=1.0 / n, joint=curve))
        text = BAR.format(pulse=[list(map(float, row)) for row in pulse], dt=1.0 / n, end=end)
        return run_scene(text + (JOINT.format(k=stiffness) if stiffness is not None else ""), *overrides)

    return once


def test_nodally_exact_at_cfl_1(bar):
    """A pulse enters in the west, is doubled at the free east end and turned over at the west: u = sum of f(t -+ x)."""
    pulse = np.array([[0.0, 0.0], [0.25, 0.7], [0.5, -0.2], [0.75, 0.0], [100.0, 0.0]])

    def exact(x, t):
        f = lambda s: np.interp(s, *pulse.T, left=0.0)  # noqa: E731
        return sum((-1) ** k * (f(t - x - 4 * k) + f(t + x - 4 * (k + 1))) for k in range(4))

    found = bar(16, pulse, 12.0)
    for name, x in (("before", 0.5), ("behind", 1.5), ("end", 2.0)):
        u = found.probe(name, "displacement")[:, 0]
        assert np.abs(u - exact(x, found.history["time"])).max() < 1e-10
    assert found.closes(1e-12)


def transmitted(t, stiffness):
    """Displacement behind a linear joint of a wave u = sin^2 that comes to it at 0, Z = 1: v_T' = 2k (v_I - v_T)."""
    a, w, s = 2.0 * stiffness, 2.0 * np.pi, np.clip(t, 0.0, 1.0)
    # u_T = a exp(-a t) * integral of exp(a s) (1 - cos w s)/2
    within = 0.5 * (1.0 - np.exp(-a * s))
    within -= 0.5 * a * (a * np.cos(w * s) + w * np.sin(w * s) - a * np.exp(-a * s)) / (a**2 + w**2)
    return np.where(t <= 0.0, 0.0, within * np.exp(-a * np.clip(t - 1.0, 0.0, None)))


@pytest.mark.serial
@pytest.mark.parametrize("stiffness", [0.5, 5.0])
def test_second_order_with_a_joint_at_cfl_1(bar, stiffness):
    errors = []
    for n in (16, 32, 64):
        t = np.arange(3 * n + 1) / n
        rows = np.c_[t, np.where(t < 1.0, np.sin(np.pi * t) ** 2, 0.0)]
        found = bar(n, rows, 39 / 16, stiffness)
        u = found.probe("behind", "displacement")[:, 0]
        errors.append(np.abs(u - transmitted(found.history["time"] - 1.5, stiffness)).max())
        assert found.closes(1e-11)
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.25)
    assert errors[-1] < 4e-3


CRACK = """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.5 mm"
friction_angle_deg = 30
[geometry]
domain = [0, 0, 4, 3]
size = 0.8
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 2]]
[[geometry.fracture]]
name = "branch"
points = [[2, 0.5], [2, 2.5]]
[initial_stress]
xx = -6e6
yy = -5e6
xy = 2.72e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
compressibility = {compressibility}
[[support]]
on = ["south", "north", "east", "west"]
[[well]]
name = "in"
at = [2, 1.5]
flow_rate = [[0, 0], [0.004, 6e-3], [1, 6e-3]]
[[well]]
name = "out"
at = {{fracture = "crack", end = "end"}}
pressure = "initial"
[[probe]]
name = "middle"
at = [2, 1.5]
on = "crack"
[[probe]]
name = "quarter"
at = [1, 1.25]
[[stage]]
kind = "dynamic"
time_step = 4e-5
end = 0.006
"""


AT_ENDS = "method.events=at-step-ends"


@pytest.mark.parametrize("compressibility", [0.0, 4.5e-10])
def test_injection_as_by_implicit_steps(run_scene, compressibility):
    """Both of second order, steps a fifth of the critical one: pressures, openings and slips to 1 % of their changes."""
    text = CRACK.format(compressibility=compressibility)
    undamped = "method.fault_damping=0"  # the equations of both are the same then
    implicit, explicit = (
        run_scene(text, f"method.stepper={each}", AT_ENDS, undamped) for each in ("newmark", "explicit")
    )
    away = ["slip", "shear_traction"]  # in the middle they are nothing, by symmetry
    for probe, more in (("middle", []), ("quarter", away)):
        for quantity in ("pressure", "opening", "flow_rate", *more):
            one, other = implicit.probe(probe, quantity), explicit.probe(probe, quantity)
            assert np.abs(one - other).max() <= 0.01 * np.ptp(one), (probe, quantity)
    assert explicit.history["step/slipping"].max() > 0
    assert explicit.closes(1e-11)
    # in parts: three times the critical step, and the wells still climb between
    coarse = run_scene(text, "method.stepper=explicit", "stage.0.time_step=6e-4")
    assert coarse.closes(1e-11)
    assert coarse.probe("middle", "opening")[-1] == pytest.approx(explicit.probe("middle", "opening")[-1], rel=0.05)


def test_ranks_agree(shared_tmp):
    """All ranks, and the first alone, to 1e-11 of natural sizes: accelerations t/(rho h) = 5e3, velocities 5e3 x 1e-4."""
    comm, file = MPI.COMM_WORLD, shared_tmp / "scene.toml"
    if comm.rank == 0:
        file.write_text(CRACK.format(compressibility=0.0).replace("4e-5", "1e-4"))
    comm.barrier()
    run(load(file, ["method.stepper=explicit"]), shared_tmp / "all", comm)
    if comm.rank == 0:
        run(load(file, ["method.stepper=explicit"]), shared_tmp / "one", MPI.COMM_SELF)
        one, many = (read_history(shared_tmp / name / "history.h5") for name in ("one", "all"))
        for name in one:
            if name.startswith(("probe/", "energy/")) and "residual" not in name:
                kind = name.rsplit("/", 1)[-1] if name.startswith("probe/") else "energy/"
                size = max(np.nanmax(np.abs(one[key]), initial=0.0) for key in one if kind in key)
                size = {"acceleration": 5e3, "velocity": 0.5, "slip_rate": 0.5}.get(kind, size)
                assert np.nanmax(np.abs(one[name] - many[name]), initial=0.0) <= 1e-11 * size, name
    comm.barrier()


@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_rigid_blocks_move_as_by_implicit_steps(shared_tmp, ratio):
    """Application 5.2: without rock that deforms nothing is explicit, with located events and drops of strength too."""
    comm, found = MPI.COMM_WORLD, {}
    for name in ("newmark", "explicit"):
        scene = load(
            MESHES / "report_5_2" / "scene.toml",
            [
                "output.pictures=false",
                f"method.stepper={name}",
                f"fracture.default.stick_slip_ratio={ratio}",
                "stage.0.end=8",
            ],
        )
        run(scene, shared_tmp / name, comm)
        found[name] = comm.bcast(read_history(shared_tmp / name / "history.h5") if comm.rank == 0 else None)
    for key in ("displacement", "velocity"):
        one, other = (found[name][f"probe/block/{key}"] for name in ("newmark", "explicit"))
        assert other == pytest.approx(one, abs=1e-11)
    assert np.abs(found["explicit"]["energy/residual"]).max() < 1e-12
    assert "no rock deforms" in (shared_tmp / "explicit" / "log.txt").read_text()


@pytest.mark.serial
@pytest.mark.parametrize("setting", ["mass=consistent", "quadrature=gauss2", "storage=consistent"])
def test_what_it_needs_is_refused_by_name(tmp_path, setting):
    (tmp_path / "scene.toml").write_text(CRACK.format(compressibility=0.0))
    key = setting.partition("=")[0]
    with pytest.raises(InputError, match=rf'method.{key}.*contradicts stepper = "explicit", which needs'):
        load(tmp_path / "scene.toml", ["method.stepper=explicit", f"method.{setting}"])


def test_a_part_without_outlet_that_no_wall_gives_way_to_is_refused(run_scene):
    with pytest.raises(SolveError, match="needs walls that move"):
        run_scene(CRACK.format(compressibility=0.0).replace('pressure = "initial"', "flow_rate = 0"), "support.0.on=rock",
                  "method.stepper=explicit", "well.in.flow_rate=0")  # fmt: skip


RUPTURE = """
[rock.rock]
youngs_modulus = 50e9
poissons_ratio = 0.25
density = 2700
[initial_stress]
xx = -30e6
yy = -30e6
xy = 16e6
unbalanced = "carried"
[[absorbing]]
on = ["west", "east", "south", "north"]
[geometry]
domain = [0, 0, 2000, 1000]
size = 80
size_at_fractures = 40
[[geometry.fracture]]
name = "fault"
points = [[600, 500], [1400, 500]]
[fracture.fault]
law = "slip-weakening"
normal_stiffness = 500e9
shear_stiffness = 500e9
aperture = 1e-3
friction_coefficient = 0.6
dynamic_friction_coefficient = 0.4
slip_weakening_distance = 0.01
[fracture.fault.initial_shear_traction]
along = [0, 300, 310, 490, 500, 800]
value = [16e6, 16e6, 19e6, 19e6, 16e6, 16e6]
[[probe]]
name = "right"
at = [1250, 500]
on = "fault"
[[stage]]
kind = "dynamic"
time_step = 4e-3
end = 0.25
"""


def test_a_rupture_takes_events_at_the_ends_of_its_steps(run_scene):
    """Parts of all lengths would feed waves of the walls: closing and opening, though a flat fault keeps its pressure."""
    found = run_scene(RUPTURE, "method.stepper='explicit'")
    assert found.probe("right", "normal_traction") == pytest.approx(-30e6, rel=0.15)
    assert np.abs(found.history["energy/residual_closed"]).max() < 1e-3 * found.history["energy/friction"][-1]
    assert found.history["time"][-1] == pytest.approx(0.25, rel=1e-12)  # the last step is as long as is left
    assert np.diff(found.history["time"])[:-1] == pytest.approx(4e-3)
    assert found.closes()


FILLS = """
[rock.rock]
youngs_modulus = 6e10
poissons_ratio = 0
density = 2700
[fracture.default]
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = 0.1
conductance = 1e-9
friction_coefficient = 0.6
[initial_stress]
xx = -5e7
yy = -5e7
[fluid]
viscosity = 1e-3
compressibility = 1e-8
[geometry]
domain = [0, 0, 4, 2]
size = 1
cells = "quads"
fracture = [{name = "gouge", points = [[0, 1], [4, 1]]}]
[[support]]
on = ["south", "north", "east", "west"]
[[well]]
name = "in"
at = [2, 1]
flow_rate = 2e-6
[[probe]]
name = "middle"
at = [2, 1]
on = "gouge"
[[stage]]
kind = "quasi-static"
time_step = 1000
steps = 10
[[stage]]
kind = "dynamic"
time_step = 1e-5
steps = 5
"""


def test_a_wide_fracture_takes_up_fluid_slower_than_its_volume_rounds_off(run_scene):
    """0.4 m2 with 5 MPa in them take up 2e-11 m2 in a step: 2e-16 of the volume held may not decide whether it converged."""
    found = run_scene(FILLS, "method.stepper=explicit")
    pressure, late = found.probe("middle", "pressure"), found.history["step/stage"] == 1
    assert pressure[-1] > 4e6 and late.sum() == 5
    assert np.ptp(pressure[late]) <= 1e-6 * pressure[-1] and found.closes(1e-10)


SQUARES = """
[rock.rock]
youngs_modulus = 64.08e9
poissons_ratio = 0.25
density = 2670
[output]
pictures = false
[method]
stepper = "explicit"
[geometry]
domain = [-400, -400, 400, 400]
size = 100
cells = "quads"
[[geometry.fracture]]
name = "joint"
points = [[-200, 0], [200, 0]]
[fracture.joint]
law = "linear"
normal_stiffness = 1e12
shear_stiffness = 1e12
[[support]]
on = "south"
[[load]]
on = "north"
traction = [1e6, 1e6]
[[probe]]
name = "middle"
at = [0, 0]
on = "joint"
[[stage]]
kind = "dynamic"
time_step = 18.5e-3          # of 18.57 ms, the critical one
steps = 60
"""


def _refusing(monkeypatch):
    """Every third step that is as long as the longest finds no balance of its joints, once."""
    solve, seen = JointSolver.solve, {"longest": 0.0, "steps": 0, "time": np.nan}

    def refuses(self, before, free, share, step):
        seen["longest"] = max(seen["longest"], share)
        if share > 0.99 * seen["longest"] and step.time != seen["time"]:
            seen["time"], seen["steps"] = step.time, seen["steps"] + 1
            if seen["steps"] % 3 == 0:
                raise NotConverged(f"time {step.time:.6g}: no balance", kind="sections")
        return solve(self, before, free, share, step)

    monkeypatch.setattr(JointSolver, "solve", refuses)


def test_steps_that_are_refused_feed_nothing(run_scene, monkeypatch):
    """Halves between whole steps fed vibrations of the cells, fourfold in 20 steps and without end: they stay halves."""
    plain = run_scene(SQUARES)
    _refusing(monkeypatch)
    found = run_scene(SQUARES)
    lengths = np.diff(found.history["time"])
    assert lengths[0] == pytest.approx(18.5e-3) and lengths[5:] == pytest.approx(9.25e-3)
    traction = [ran.probe("middle", "normal_traction") for ran in (plain, found)]
    assert np.abs(traction[1]).max() <= np.abs(traction[0]).max()
    assert found.closes()


def test_energy_out_of_nothing_ends_a_run(run_scene, monkeypatch):
    """As refused steps made it before: the run says so, and keeps the states before that."""
    _refusing(monkeypatch)
    monkeypatch.setattr(ExplicitSteps, "may_lengthen", lambda self, stepper: True)
    monkeypatch.setattr(ExplicitSteps, "locates", lambda self, stepper, dt: False)
    with pytest.raises(SolveError, match="feeds on itself: energy/scheme has given"):
        run_scene(SQUARES)
