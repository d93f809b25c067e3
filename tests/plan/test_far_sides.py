"""Sides that fractures do not feel are left out, with the mesh, where that is cheaper; and come back where they matter."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import Interrupted
from fracflow.mesh.data import is_unmeshed
from fracflow.mesh.store import load_mesh, save_mesh
from fracflow.output import read_events, read_history
from fracflow.output.reader import load_run_data
from fracflow.reduction import far_sides
from fracflow.reduction.prepare import prepare, read_split
from fracflow.scene.method import Mesh
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import resume, run

TRACES = {"a": [[-20, -8], [14, 10]], "b": [[-12, 16], [16, -14]]}
SIDES = ["west", "east", "south", "north"]


def scene_of(half_width=500.0, **changes):
    data = {
        "rock": {"rock": {"youngs_modulus": 4e10, "poissons_ratio": 0.25}},
        "initial_stress": {"xx": -14e6, "yy": -20e6, "zz": -16e6, "xy": 2e6},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 5e6, "compressibility": 4.5e-10},
        "geometry": {
            "domain": [-half_width, -half_width, half_width, half_width], "size": half_width / 8, "growth": 0.3,
            "size_at_fractures": 2.0, "fracture": [{"name": n, "points": p} for n, p in TRACES.items()],
        },
        "support": [{"on": SIDES}],
        "well": [{"name": "pump", "at": {"fracture": "a", "end": "start"}, "flow_rate": [[0, 0], ["10 h", "8e-4 L/s"]]}],
        "probe": [
            {"name": name, "at": {"fracture": name, "fraction": 0.37}, "quantities": ["slip", "opening", "pressure"]}
            for name in TRACES
        ],
        "stage": [{"kind": "quasi-static", "time_step": "5 h", "steps": 4}],
        "fracture": {
            "default": {
                "normal_stiffness": "40 GPa/m", "shear_stiffness": "20 GPa/m", "friction_coefficient": 0.5,
                "aperture": "0.2 mm",
            }
        },
        "output": {"pictures": False, "checkpoint_every": 1},
    }  # fmt: skip
    return Scene.from_data(data | changes)


def changed(folder, quantity):
    """Values (step, probe) of the probes beyond the start."""
    history = dict(read_history(folder / "history.h5"))
    values = np.stack([history[f"probe/{name}/{quantity}"] for name in TRACES], axis=1)
    return values - values[0]


def row(folder):
    plan = json.loads((folder / "plan.json").read_text())
    return next(each for each in plan["decisions"] if each["part"] == far_sides.PART)


def compare(one, other):
    """Equal to the last bit on one rank; on others MUMPS sums in order of arrival."""
    most = max(np.abs(one[key]).max() for key in one if key.startswith("energy/"))
    for key in one:
        if key.startswith(("probe/", "energy/")):
            size = most if key.startswith("energy/") else np.abs(one[key]).max()
            near = 0.0 if MPI.COMM_WORLD.size == 1 else 1e-8 * size
            np.testing.assert_allclose(other[key], one[key], rtol=0.0, atol=near)


@pytest.fixture
def dear_meshes(monkeypatch):
    """A mesh of any size costs more than none."""
    monkeypatch.setattr(far_sides, "LEAST", 0.0)
    monkeypatch.setattr(far_sides, "CLEARLY", 0.0)


def test_far_sides_are_left_out(shared_tmp, dear_meshes):
    """Within the tolerance of a fine mesh, and nearer to it than the mesh of the scene; on ranks alike.

    Both err by 0.8 and 0.7 % against joints of 0.5 m, 0.1 m at tips, without sides; with a growth of 0.1 the fine one by 0.9 %.
    """
    run(scene_of(), shared_tmp / "free")
    fine = scene_of().with_geometry({"size_at_fractures": 0.7, "size_at_tips": 0.2, "growth": 0.05})
    run(fine.model_copy(update={"model": "full"}), shared_tmp / "full")
    run(scene_of().model_copy(update={"model": "full"}), shared_tmp / "coarse")
    if MPI.COMM_WORLD.size > 1:
        run(scene_of(), shared_tmp / f"alone{MPI.COMM_WORLD.rank}", MPI.COMM_SELF)
        for quantity in ("slip", "opening", "pressure"):
            alone, together = (changed(shared_tmp / n, quantity) for n in (f"alone{MPI.COMM_WORLD.rank}", "free"))
            np.testing.assert_allclose(together, alone, atol=1e-10 * np.abs(alone).max())
    assert row(shared_tmp / "free")["verdict"] == "left out"
    assert is_unmeshed(load_mesh(shared_tmp / "free" / "mesh.h5").cells)
    assert [load_run_data(shared_tmp / name).is_meshed for name in ("free", "full")] == [False, True]
    assert (
        load(shared_tmp / "free" / "scene.toml").geometry.domain
        == load(shared_tmp / "full" / "scene.toml").geometry.domain
    )
    jumps = [np.stack([changed(shared_tmp / n, q) for q in ("slip", "opening")]) for n in ("free", "full", "coarse")]
    assert np.abs(jumps[0] - jumps[1]).max() < 0.01 * np.abs(jumps[1]).max() < np.abs(jumps[2] - jumps[1]).max()
    pressures = [changed(shared_tmp / n, "pressure") for n in ("free", "full")]
    assert np.abs(pressures[0] - pressures[1]).max() < 0.01 * np.abs(pressures[1]).max()


def test_sides_that_matter_come_back(shared_tmp, dear_meshes, monkeypatch):
    """Lengths said that they would not; the jumps show that they do. The run is that of a mesh to the last bit."""
    run(scene_of(60.0), shared_tmp / "kept")
    assert row(shared_tmp / "kept")["saves"] == "nothing: the sides are too near"
    monkeypatch.setattr(far_sides, "estimated", lambda scene: 1e-3)
    run(scene_of(60.0), shared_tmp / "back")
    found = row(shared_tmp / "back")
    assert found["verdict"] == "kept"
    assert "sides would change results by up to" in found["undone"]
    one, other = (dict(read_history(shared_tmp / name / "history.h5")) for name in ("kept", "back"))
    compare(one, other)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("gap", "value"), [(1.5, 2 * (2 / 1.5) ** 2), (498.0, (2 / 498.0) ** 2 + np.pi * (2 / 1000.0) ** 2 * 0.75 / 0.5)]
)
def test_a_small_fracture_beside_a_long_side_keeps_it(gap, value):
    """The distance is that from the nearest place of a side, wherever that is."""
    trace = {"name": "a", "points": [[-438.0, gap - 500.0], [-434.0, gap - 500.0]]}
    if gap > 400.0:
        trace["points"] = [[-2.0, gap - 500.0], [2.0, gap - 500.0]]
    given = scene_of(
        probe=[], well=[], geometry={"domain": [-500.0, -500.0, 500.0, 500.0], "size": 60.0, "fracture": [trace]}
    )
    assert far_sides.estimated(given) == pytest.approx(value, rel=1e-12)


def test_held_sides_keep_the_volume_of_rock(shared_tmp, dear_meshes, monkeypatch):
    """A crack that 2 MPa open in rock of nu = 0.49, between sides at ten times its length: they take 5 % of its opening."""
    crack = {
        "rock": {"rock": {"youngs_modulus": 4e10, "poissons_ratio": 0.49}},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -1e7},
        "geometry": {"domain": [-200, -200, 200, 200], "size": 50, "growth": 0.3, "size_at_fractures": 1.0,
                     "fracture": [{"name": "a", "points": [[-10, 0], [10, 0]]}]},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 0.0},
        "fracture": {"a": {"normal_stiffness": 1e14, "shear_stiffness": 1e13, "aperture": 1e-3, "friction_coefficient": 0.6,
                           "pressure": [[0, 0], [1, 1.2e7]]}},
        "well": [], "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
        "probe": [{"name": "p", "at": [0, 0], "on": "a", "quantities": ["opening"]}],
    }  # fmt: skip
    scene = scene_of(**crack)
    assert far_sides.estimated(scene) == pytest.approx((10 / 190) ** 2 + np.pi * (10 / 400) ** 2 * 0.51 / 0.02)
    near = scene_of(**crack | {"geometry": crack["geometry"] | {"domain": [-100, -100, 100, 100]}})
    for each in (near, in_file(near, shared_tmp / "kept.h5")):
        (line,) = on_sides(each)
        assert "held all round" in line and "17 % less" in line
        assert not on_sides(each.model_copy(update={"support": ()}))
    monkeypatch.setattr(far_sides, "estimated", lambda scene: 1e-3)
    run(scene, shared_tmp / "closed")
    assert "sides would change results by up to 0.05" in row(shared_tmp / "closed")["undone"]


def test_a_run_without_sides_goes_on(shared_tmp, dear_meshes):
    scene = scene_of()
    run(scene, shared_tmp / "whole")

    def stop(step):
        if step.state.time > 9 * 3600:
            raise Interrupted("by hand")

    with pytest.raises(Interrupted):
        run(scene, shared_tmp / "halves", progress=stop)
    resume(shared_tmp / "halves")
    one, other = (dict(read_history(shared_tmp / name / "history.h5")) for name in ("whole", "halves"))
    compare(one, other)


def slipping(**changes):
    """A fault that pressure lets go, with sides that absorb."""
    fault = {"name": "fault", "points": [[-10, 0], [10, 0]]}
    law = {
        "friction_coefficient": 0.6, "stick_slip_ratio": 0.9, "normal_stiffness": "50 GPa/m", "shear_stiffness": "20 GPa/m",
        "aperture": "0.2 mm", "pressure": [[0, 0], [1000, 4e6]],
    }  # fmt: skip
    data = {
        "rock": {"rock": {"youngs_modulus": 3e10, "poissons_ratio": 0.25, "density": 2700.0}},
        "initial_stress": {"xx": -20e6, "yy": -20e6, "zz": -20e6, "xy": 11e6},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 0},
        "geometry": {"domain": [-170, -170, 170, 170], "size": 34, "size_at_fractures": 2, "fracture": [fault]},
        "support": [], "absorbing": [{"on": SIDES}], "well": [], "fracture": {"fault": law},
        "probe": [{"name": "p", "at": [0, 0], "on": "fault", "quantities": ["slip"]}],
        "method": {"stepper": "generalised-alpha", "rho_infinity": 0.6, "events": "at-step-ends"},
        "stage": [{"kind": "auto", "end": 421.8, "time_step": 20, "dynamic_time_step": 3e-3, "at_rest": 0.1}],
        "output": {"pictures": False, "event_length": 1},
    }  # fmt: skip
    return scene_of(**data | changes)


@pytest.mark.serial
def test_explicit_steps_keep_the_mesh(dear_meshes):
    """They divide by the mass of cells, which rock without a mesh has none of; stages without inertia have no such steps."""
    explicit = {"stepper": "explicit"}
    assert far_sides.assessed(slipping()).why == "" and far_sides.assessed(scene_of(method=explicit)).why == ""
    kept = slipping(method=explicit)
    assert far_sides.assessed(kept).why
    assert any("divides by the mass" in each for each in far_sides.one_obstacle(kept))


@pytest.mark.serial
def test_an_event_brings_the_sides_back(tmp_path, dear_meshes):
    """Before it the rock is not meshed; then the sides are those of the scene."""
    run(slipping(), tmp_path / "free")
    run(slipping(model="full"), tmp_path / "full")
    found = row(tmp_path / "free")
    assert found["verdict"] == "left out" and "until an event needs inertia" in found["saves"]
    before, after = (load_mesh(tmp_path / "free" / name) for name in ("mesh.h5", "event_mesh.h5"))
    assert is_unmeshed(before.cells) and np.abs(after.points).max() == 170.0
    events = [
        [each for each in read_events(tmp_path / name / "events.csv") if each["kind"] == "event"]
        for name in ("free", "full")
    ]
    (free,), (full,) = events
    for key, near in {"start": 1e-3, "slip": 0.02, "moment": 0.02, "dissipated": 0.03}.items():
        assert free[key] == pytest.approx(full[key], rel=near), key


KEPT = {
    "not asked": {"model": "full"},
    "inertia": {"stage": [{"kind": "dynamic", "time_step": 1.0, "steps": 2}]},
    "waves come in": {
        "stage": [{"kind": "auto", "time_step": 1.0, "end": 2.0}],
        "support": [],
        "absorbing": [{"on": "west", "wave": {"velocity": [[0, 0], [1, 1e-3]]}}],
    },
    "volume": {"body_force": {"y": -1.0}},
    "loads": {"load": [{"on": "west", "traction": "initial-stress"}]},
    "moves": {"support": [{"on": SIDES, "displacement": {"x": 1e-3, "y": 0.0}}]},
    "side north is not held": {"support": [{"on": SIDES[:3]}, {"on": "north", "components": ["y"]}]},
    "probe p measures displacement": {"probe": [{"name": "p", "at": [0, 50]}]},
    "probe p measures stress": {"probe": [{"name": "p", "at": [0, 50], "quantities": ["stress"]}]},
    "fields": {"output": {"fields_every": 1}},
    "solver": {"method": {"coupling": "monolithic"}},
    "well is on a side": {"well": [{"name": "w", "on": "east", "pressure": "initial"}]},
}


@pytest.mark.parametrize("why", KEPT)
def test_reasons_to_keep_sides(why):
    changes = {"rock": {"rock": {"youngs_modulus": 4e10, "poissons_ratio": 0.25, "density": 2600.0}}, **KEPT[why]}
    found = far_sides.assessed(scene_of(**changes))
    assert found is None if why == "not asked" else why in found.why


def test_one_obstacle_is_named(dear_meshes):
    """Two are not: to mend one would change nothing."""
    (line,) = far_sides.one_obstacle(scene_of(output={"fields_every": 1}))
    assert line.startswith("note: one thing keeps the mesh") and "output.fields_every" in line
    two = {"output": {"fields_every": 1}, "method": {"coupling": "monolithic"}}
    for changes in ({}, two, {"output": {"fields_every": 1}, "model": "full"}):
        assert far_sides.one_obstacle(scene_of(**changes)) == []
    assert far_sides.one_obstacle(scene_of(60.0, output={"fields_every": 1})) == []


@pytest.mark.parametrize("fewest", [0, 10**9], ids=["in slices", "whole"])
def test_sides_that_are_near_are_told(shared_tmp, monkeypatch, fewest):
    """Half lengths are 19.2 and 20.5, in a file as in the scene; a trace that ends at a side has no line.

    Nor have sides that absorb all waves of a scene without stages that come to rest.
    """
    monkeypatch.setattr("fracflow.mesh.slices.reading.FEWEST", fewest)
    near, far, ending = (scene_of(30.0), scene_of(80.0), scene_of(geometry=THROUGH, probe=[], well=[]))
    kept = in_file(near, shared_tmp / "near.h5")
    for scene, free in ((near, "geometry.domain ="), (kept, "[geometry] with domain ="), (refined(kept), "[mesh]")):
        (line,) = on_sides(scene)
        assert "sides: a, 38.5 m long, comes within 10 m of a side (so near for their lengths: 1 more)" in line
        assert "off by up to 6" in line and free in line
    for scene in (far, ending, in_file(far, shared_tmp / "far.h5"), in_file(ending, shared_tmp / "ending.h5")):
        assert on_sides(scene) == []
    rock = {"rock": {"youngs_modulus": 4e10, "poissons_ratio": 0.25, "density": 2600.0}}
    for side, count in (("support", 1), ("absorbing", 0)):
        waves = scene_of(30.0, **KEPT["inertia"], rock=rock, **{"support": [], side: [{"on": SIDES}]})
        assert len(on_sides(waves)) == count


@pytest.mark.parametrize("degrees", [37.0, 90.0])
def test_sides_that_are_near_are_told_of_a_domain_that_is_turned(degrees, shared_tmp):
    """At 37 degrees the box around it is 21 m away."""
    near, angle = scene_of(30.0), np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    kept = in_file(near, shared_tmp / "near.h5", turn)
    stress = near.initial_stress
    turned = turn @ np.array([[stress.xx, stress.xy], [stress.xy, stress.yy]]) @ turn.T
    parts = {"xx": float(turned[0, 0]), "yy": float(turned[1, 1]), "xy": float(turned[0, 1])}
    (line,) = on_sides(kept.model_copy(update={"initial_stress": stress.model_copy(update=parts)}))
    assert "sides: a, 38.5 m long, comes within 10 m of a side (so near for their lengths: 1 more)" in line


THROUGH = {"domain": [-20, -20, 20, 20], "size": 4, "fracture": [{"name": "a", "points": [[-20, 0], [20, 1]]}]}


def on_sides(scene):
    """Lines on sides of a scene that is made ready on all ranks."""
    return [note for note in prepare(scene, MPI.COMM_WORLD).placed.notes if note.startswith("sides:")]


def in_file(scene, path, turn=None):
    """The same scene with its mesh in a file, turned by a matrix (2, 2)."""
    if MPI.COMM_WORLD.rank == 0:
        mesh = read_split(scene)
        save_mesh(mesh if turn is None else replace(mesh, points=mesh.points @ turn.T), path)
    MPI.COMM_WORLD.barrier()
    return scene.model_copy(update={"geometry": None, "mesh": Mesh(file=str(path))})


def refined(scene):
    """The same with its cells cut in four on their ranks."""
    return scene.model_copy(update={"mesh": scene.mesh.model_copy(update={"refine": 1})})


def test_estimate_falls_with_the_square_of_the_distance():
    near, far = (far_sides.estimated(scene_of(wide)) for wide in (2e3, 4e3))
    assert near / far == pytest.approx(4.0, rel=0.02)
    assert far_sides.assessed(scene_of()).why.startswith("an iteration takes some")
    assert not far_sides.assessed(
        scene_of(geometry=scene_of().geometry.model_dump(exclude_none=True) | {"size": 4.0})
    ).why
