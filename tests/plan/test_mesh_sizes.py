"""Mesh sizes that a scene leaves open: lengths in closed form, what they ask of a mesh, and that half of it changes little."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.cli.app import app
from fracflow.diagnostics import pre_run_checks
from fracflow.mesh.read import GeometrySpec, build_mesh
from fracflow.mesh.rock_cells import RockCells
from fracflow.output import read_history
from fracflow.reduction import mesh_size as mesh_sizes
from fracflow.reduction.mesh_size import (
    affordable,
    cell_count,
    corner_period,
    front_length,
    mean_spacing,
    shortest_period,
    typical_length,
)
from fracflow.reduction.prepare import read_split, with_sizes
from fracflow.reduction.unresolved import unresolved
from fracflow.remarks import note
from fracflow.scene.method import Mesh
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable
from fracflow.simulation.run import run

OF_SLIP = ("joint length scale", "nucleation length", "cohesive zone")


def scene_of(traces, *, fracture=(), stage=(), **more):
    """A square of 100 m of rock with traces; wave speeds are 2191 and 1265 m/s, and E' is 10.67 GPa."""
    named = [{"name": f"f{k}", "points": points} for k, points in enumerate(traces)]
    default = {"normal_stiffness": 1e10, "shear_stiffness": 5e9, "aperture": 1e-3, "friction_angle_deg": 30.0}
    data = {
        "geometry": {"domain": [0, 0, 100, 100], "fracture": named} | more.pop("geometry", {}),
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500.0}},
        "fracture": {"default": default | dict(fracture)},
        "initial_stress": {"xx": -1e7, "yy": -1e7},
        "stage": [{"kind": "quasi-static", "end": 1.0, "time_step": 0.5} | dict(stage)],
        "output": {"pictures": False},
    }
    return Scene.from_data(data | more)


def sized(scene):
    return with_sizes(scene, MPI.COMM_SELF)


@pytest.mark.serial
def test_periods_are_those_of_sines_and_twice_those_of_ramps():
    times = np.linspace(0.0, 1.0, 201)
    sine = TimeTable(tuple(times), tuple(np.sin(2.0 * np.pi * times / 0.2)))
    slow = TimeTable((0.0, 1.0), (0.0, 5.0))
    assert shortest_period([sine], 0.0, 1.0) == pytest.approx(0.2)
    assert shortest_period([slow, sine], 0.0, 1.0) == pytest.approx(0.2)
    assert shortest_period([slow], 0.0, 0.1) == 2.0
    assert shortest_period([slow], 2.0, 3.0) == np.inf == shortest_period([TimeTable.constant(3.0)], 0.0, 1.0)
    jump = TimeTable((0.0, 0.5, 0.5, 1.0), (0.0, 0.0, 1.0, 1.0))
    assert shortest_period([jump], 0.0, 1.0) == 0.0 and shortest_period([jump], 0.6, 1.0) == np.inf
    rippled = TimeTable((0.0, 1.0, 1.01, 2.0), (0.0, 1.0, 0.99, 2.0))  # its ripple is as steep as the ramp
    assert shortest_period([rippled], 0.0, 2.0) == pytest.approx(4.0, rel=0.05)


@pytest.mark.serial
def test_lengths_in_closed_form():
    assert typical_length(np.array([1.0, 3.0])) == 2.5
    assert mean_spacing(100.0, 20.0) == 5.0 and mean_spacing(100.0, 0.0) == np.inf
    assert corner_period(1000.0, 2500.0) == pytest.approx(0.5370, abs=5e-5)  # Brune: f_c = 2.34 c_s/(2 pi r), r = 500 m
    conducting = 1e-3**3 / (12 * 1e-3)  # water in a millimetre: D = d^3 k_n/(12 mu) = 4166.7 m^2/s
    assert front_length(np.array(conducting), np.array(5e10), 0.0, 1.0) == pytest.approx(64.55, abs=0.005)
    assert front_length(np.array(conducting), np.array(5e10), 2e-11, 1.0) == pytest.approx(64.55 / 2**0.5, abs=0.005)


@pytest.mark.serial
def test_cells_are_counted_before_they_are_made():
    for size, fine, growth in ((10.0, 0.5, 0.3), (20.0, 1.0, 0.15), (4.0, 4.0, 0.3)):
        line = (("a", np.array([[0.0, 50.0], [100.0, 50.0]])),)
        cells = len(build_mesh(GeometrySpec(np.array([[0, 0], [100, 0], [100, 100], [0, 100]]), line, size, fine,
                                            growth=growth)).cells)  # fmt: skip
        assert 0.5 * cells < cell_count(size, fine, 1e4, 100.0, growth) < 2.0 * cells
    size, fine = affordable(10.0, 1e-3, 1e4, 100.0, 0.3, 5e3)
    assert size == 10.0 and cell_count(size, fine, 1e4, 100.0, 0.3) <= 5e3
    assert affordable(10.0, 1.0, 1e4, 100.0, 0.3, 1e9) == (10.0, 1.0)


WEAKENING = {"law": "slip-weakening", "dynamic_friction_coefficient": 0.3, "slip_weakening_distance": 2e-3}


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scene", "why"),
    [
        (scene_of([[[0, 40], [100, 60]]], fracture={"stick_slip_ratio": 0.8}), "E'/k_s / 4 = 0.533, f0 at ("),
        (scene_of([[[0, 40], [100, 60]]], fracture=WEAKENING | {"slip_weakening_distance": 2e-3}), " / "),
        (scene_of([[[45, 50], [55, 50]]]), "length of fractures / 16 = 0.625, f0 at ("),
        (scene_of([[[0, 50], [100, 50]]], fluid={"viscosity": 1e-3, "specific_weight": 1e4},
                  fracture={"aperture": 1e-4, "normal_stiffness": 3e11}), "reach of a pressure in 1 s / 8 = 0.625, f0 at ("),
    ],
    ids=["drop", "weakening", "crack", "film"],
)  # fmt: skip
def test_a_proposed_mesh_resolves_what_it_was_made_for(scene, why):
    scene = sized(scene)
    mesh = read_split(scene)
    assert why in next(line for line in scene.notes if "size_at_fractures" in line)
    assert unresolved(scene, mesh, {}) == []
    assert not any(number.out_of_range for number in pre_run_checks(scene, mesh, {}) if number.name in OF_SLIP)
    assert 100 < len(mesh.cells) < 20_000
    again = Scene.from_data(scene.model_dump(exclude_none=True))
    assert sized(again) == again == scene and again.notes == ()
    assert np.array_equal(read_split(again).points, mesh.points)


@pytest.mark.serial
def test_cells_that_keep_the_waves_of_drops_are_told():
    """Joints of 2 m: cells of 6 m carry nothing under 12 m, a drop at one joint makes waves of 8 m."""
    more = {"absorbing": [{"on": ["west", "east", "south", "north"]}], "stage": {"kind": "auto"}}

    def said(size, drop, **method):
        sizes = {"size": size, "size_at_fractures": 2.0, "growth": 0.5}
        scene = scene_of(
            [[[40, 50], [60, 50]]], fracture={"stick_slip_ratio": drop}, method=method, geometry={}, **more
        )
        scene = scene.with_geometry(sizes)
        return [line for line in unresolved(scene, read_split(scene), {}) if "a tenth of the rock" in line]

    (told,) = said(6.0, 0.95)
    assert (
        "over 2 times the joints of 2 m" in told and "or have cells below 4 m" in told and "generalised-alpha" in told
    )
    assert said(3.0, 0.95) == said(6.0, 1.0) == said(6.0, 0.95, stepper="generalised-alpha") == []


@pytest.mark.serial
def test_waves_of_loads_have_ten_cells():
    """A sine of 0.02 s, whose S wave is 25.3 m long."""
    times = np.linspace(0.0, 0.1, 101).tolist()
    table = [[time, float(np.sin(100.0 * np.pi * time))] for time in times]
    side = {"on": ["south"], "wave": {"kind": "s", "velocity": table}}
    scene = sized(scene_of([], fracture={}, absorbing=[side], stage={"kind": "dynamic", "time_step": 1e-3}))
    mesh = read_split(scene)
    assert "wave of 20 ms, a load in stage dynamic, / 10 = 2.53, rock at (" in scene.notes[0]
    assert 2.0 < RockCells.of(mesh).size.max() <= 0.02 * (4e9 / 2500.0) ** 0.5 / 10
    coarse = scene.with_geometry({"size": 8.0})
    (told,) = unresolved(coarse, read_split(coarse), {})
    assert "it needs cells of 2.53 m, and has " in told and "rock at (" in told


@pytest.mark.serial
@pytest.mark.parametrize(
    "traces",
    [
        [[[10, 50], [90, 50]], [[10, 50.349], [90, 49.651]]],
        [[[20, 50], [70, 50]], [[30, 50.4], [80, 50.8]], [[50, 20], [50.1, 49.9]]],
        [[[5, 40], [95, 60]], [[20, 80], [20.4, 80]]],
    ],
    ids=["half a degree", "nearly touching", "one long, one short"],
)
def test_near_traces_take_no_more_cells_than_they_need(traces):
    scene = sized(scene_of(traces))
    mesh = read_split(scene)
    assert set(mesh.fractures) == {f"f{k}" for k in range(len(traces))}
    assert len(mesh.cells) < 50_000


@pytest.mark.serial
def test_what_would_take_too_many_cells_is_capped_and_said(monkeypatch):
    monkeypatch.setattr(mesh_sizes, "MOST_CELLS", 4000)
    scene = sized(scene_of([[[20, 40], [80, 60]]], fracture={"stick_slip_ratio": 0.8, "shear_stiffness": 2e11}))
    mesh = read_split(scene)
    assert 2000 < len(mesh.cells) < 1.25 * 4000
    (line,) = [line for line in scene.notes if "size_at_fractures" in line]
    assert "E'/k_s / 4 = 0.0133" in line and "4000 cells, the most that are proposed, do not reach it" in line
    assert any(number.out_of_range for number in pre_run_checks(scene, mesh, {}) if number.name in OF_SLIP)
    assert scene.geometry.growth == 0.3 and scene.geometry.size_at_tips is None


@pytest.mark.serial
def test_what_a_scene_states_stays():
    traces = [[[20, 40], [80, 60]]]
    stated = scene_of(traces, geometry={"size": 8})
    snap = 0.004 * 63.2455532
    assert sized(stated) == stated.with_geometry({"snap": sized(stated).geometry.snap, "growth": 0.3})
    assert sized(stated).geometry.snap == pytest.approx(snap)
    assert sized(stated).notes == (note("geometry.snap = 0.252982 m: 0.4 % of the median length of traces"),)
    partly = sized(scene_of(traces, geometry={"size_at_fractures": 3, "growth": 0.2})).geometry
    assert (partly.size, partly.size_at_fractures, partly.size_at_tips, partly.growth) == (5.0, 3.0, None, 0.2)
    snapped = sized(scene_of(traces, geometry={"snap": 4})).geometry
    assert snapped.snap == 4.0 and snapped.size_at_fractures >= 8.0


@pytest.mark.serial
def test_check_names_what_a_mesh_file_does_not_resolve():
    lines = CliRunner().invoke(app, ["check", "meshes/crossings/scene.toml"]).output.splitlines()
    (told,) = [line for line in lines if "not resolved" in line]
    assert told.startswith("! mesh: length of fractures / 16 is not resolved: it needs joints of 7.08 m, and has ")
    assert ", C at (" in told


def changes(scene, comm, folder, names):
    """Largest change of each history over its largest value, where the same steps run on cells cut in four."""
    found = []
    for refine in (0, 1):
        run(scene.with_geometry({"refine": refine}), folder / f"{refine}", comm)
        found.append(comm.bcast(read_history(folder / f"{refine}" / "history.h5") if comm.rank == 0 else None))
    coarse, fine = found
    return {name: np.abs(fine[f"probe/{name}"] - coarse[f"probe/{name}"]).max() / np.abs(fine[f"probe/{name}"]).max()
            for name in names}  # fmt: skip


def test_half_the_size_changes_slow_slip_by_less_than_the_tolerance(comm, shared_tmp):
    scene = with_sizes(
        scene_of(
            [[[45, 49], [50, 50], [55, 51]]],  # the probe sits on a node of every mesh
            fracture={"normal_stiffness": 1e9, "shear_stiffness": 1e8},
            support=[{"on": ["south"]}],
            load=[{"on": ["north"], "traction": [1e6, -1e6]}],
            initial_stress={},
            probe=[{"name": "middle", "at": [50, 50]}, {"name": "corner", "at": [100, 100]}],
            stage={"time_step": 1.0},
        ),
        comm,
    )
    assert len(set(comm.allgather(scene.dump_toml()))) == 1
    found = changes(
        scene, comm, shared_tmp, ("middle/slip", "middle/opening", "middle/displacement", "corner/displacement")
    )
    assert max(found.values()) < 1e-2, found


def test_half_the_size_changes_a_wave_by_less_than_the_tolerance(comm, shared_tmp):
    times = np.linspace(0.0, 0.1, 41)
    pulse = [[float(time), float(0.01 * np.sin(10.0 * np.pi * time) ** 2)] for time in times]
    scene = with_sizes(
        scene_of(
            [[[30, 40], [50, 50], [70, 60]]],
            absorbing=[{"on": ["north", "east", "west"]}, {"on": ["south"], "wave": {"kind": "s", "velocity": pulse}}],
            probe=[{"name": "middle", "at": [50, 50]}, {"name": "tip", "at": [70, 60]}],
            stage={"kind": "dynamic", "end": 0.12, "time_step": 0.01},
        ),
        comm,
    )
    found = changes(scene, comm, shared_tmp, ("middle/slip", "middle/displacement", "tip/displacement", "tip/velocity"))
    assert max(found.values()) < 1e-2, found


@pytest.mark.serial
def test_rock_that_coarsens_fast_beside_a_fracture_that_weakens_is_told():
    """Cells that grow by 0.3 of the distance let slip run away 5 % late; 0.1 is enough, and is what no growth stands for."""
    weak = WEAKENING | {"slip_weakening_distance": 1e-2}
    sizes = {"size": 10.0, "size_at_fractures": 1.0}

    def told(in_file=False, **more):
        scene = scene_of([[[30, 50], [70, 50]]], fracture=weak, **more)
        mesh = read_split(sized(scene))
        scene = scene.model_copy(update={"geometry": None, "mesh": Mesh(file="a.h5")}) if in_file else scene
        return [line for line in unresolved(scene, mesh, {}) if "run away late" in line]

    (line,) = told(geometry=sizes | {"growth": 0.3})
    assert "f0" in line and "geometry.growth = 0.1" in line
    (line,) = told(in_file=True, geometry=sizes | {"growth": 0.3})
    assert "geometry" not in line and "give a [mesh] whose cells grow by less there" in line
    assert not told(geometry=sizes) and not told()
    assert not told(geometry=sizes | {"growth": 0.3}, stage={"kind": "dynamic"})
    weakens = scene_of([[[30, 50], [70, 50]]], fracture=weak, geometry=sizes)
    written = Scene.from_data(weakens.model_dump(exclude_none=True))  # a growth left open stays so in what is written
    assert sized(weakens).geometry.growth == sized(written).geometry.growth == 0.1


@pytest.mark.serial
def test_finer_joints_alone_make_a_crack_exact(tmp_path):
    """Cells that grow by 0.3 leave 2.7 % of an opening away at any joint; what no growth stands for falls with the joints."""
    pressure, half, young = 1e5, 20.0, 1e10
    exact = 4.0 * pressure * half / (young / (1.0 - 0.25**2))  # Sneddon (1946), in the middle
    soft = {"normal_stiffness": 1e4, "shear_stiffness": 1e4, "initial_normal_traction": 0.0, "pressure": pressure}

    def missing(fine, **more):
        sizes = {"domain": [-800, -800, 800, 800], "size": 400.0, "size_at_fractures": fine} | more
        scene = scene_of(
            [[[-half, 0], [half, 0]]], geometry=sizes, fracture=soft, stage={"kind": "steady"}, initial_stress={},
            fluid={"viscosity": 1e-3}, support=[{"on": ["west", "east", "south", "north"]}],
            probe=[{"name": "middle", "at": [0, 0], "on": "f0"}],
        )  # fmt: skip
        run(scene, tmp_path, MPI.COMM_SELF)
        return 1.0 - read_history(tmp_path / "history.h5")["probe/middle/opening"][-1] / exact, sized(scene)

    (coarse, _), (fine, scene) = missing(0.8), missing(0.2)
    assert 0.02 < coarse < 0.045 and fine < 0.3 * coarse and scene.geometry.growth == 0.11
    (_, left), (stays, told) = missing(0.8, growth=0.3), missing(0.2, growth=0.3)
    assert stays > 0.025
    cut = sized(scene_of([[[0, 20], [100, 60]]], geometry={"size": 10.0, "size_at_fractures": 0.5})).geometry
    assert cut.growth == 0.3  # it has no end in the rock
    assert "openings are some 2.5% too small" in "".join(told.notes) and "too small" not in "".join(left.notes)


@pytest.mark.serial
@pytest.mark.parametrize("evolution, least, why", [(0.015, 1.185, "L_b"), (0.02, 0.679, "h*")])
def test_joints_resolve_the_lengths_of_rate_and_state(evolution, least, why):
    """A third of L_b = mu* D_c/(b sigma), a tenth of h* = 2/pi L_b (b/(b - a))^2; mu* is 5.33 GPa, sigma 10 MPa."""
    state = dict(law="rate-and-state", reference_slip_rate=1e-6, direct_effect=0.01, evolution_effect=evolution)
    state |= dict(characteristic_slip=1e-4, initial_slip_rate=1e-9)
    found = sized(scene_of([[[20, 50], [80, 50]]], fracture=state))
    assert found.geometry.size_at_fractures == pytest.approx(least, rel=0.01)
    assert any("size_at_fractures" in line and f"{why} of rate-and-state" in line for line in found.notes)
