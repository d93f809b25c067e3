"""Fractures that can neither slip, open nor conduct are tied, and come back where they might; parts that nothing loads stay."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from fracflow.errors import Interrupted
from fracflow.mesh.data import RawMesh
from fracflow.mesh.split import groups, merged_faces, split
from fracflow.output import read_history
from fracflow.reduction import ReductionInput
from fracflow.reduction import locked_fractures as tied
from fracflow.reduction.locked_fractures import PART, Fractures, choose, compliance, shed
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import resume, run

SHEAR = 4e9  # G of the rock below
HORIZONTAL = [[20, 15], [50, 15], [80, 15], [20, 85], [50, 85], [80, 85]]


def scene_of(amount, fault=True, model="default", **more):
    """A square under 10 MPa that is sheared to ``amount``; six stiff fractures of friction 0.6, and a fault of 0.03."""
    traces = [{"name": f"seam{n}", "points": [[x - 8, y], [x + 8, y]]} for n, (x, y) in enumerate(HORIZONTAL)]
    stiff = {"normal_stiffness": 2e12, "shear_stiffness": 2e12, "aperture": 1e-3, "friction_coefficient": 0.6}
    soft = {"normal_stiffness": 5e10, "shear_stiffness": 2e10, "aperture": 1e-3, "friction_coefficient": 0.03}
    probes = [{"name": "rock", "at": [50, 65]}, {"name": "near", "at": [50, 20]}]
    probes += [{"name": "fault", "at": [50, 50], "on": "fault"}] if fault else []
    return {
        "model": model, "output": {"pictures": False, "checkpoint_every": 1},
        "geometry": {
            "domain": [[0, 0], [100, 0], [100, 100], [0, 100]], "size": 15, "size_at_fractures": 8,
            "fracture": traces + [{"name": "fault", "points": [[40, 50], [60, 50]]}] * fault,
        },
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500}},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -5e6},
        "fracture": {"default": stiff} | ({"fault": soft} if fault else {}),
        "support": [{
            "on": ["south", "north", "west", "east"],
            "displacement_gradient": [[0, {"time": [0, 5], "value": [0, amount]}], [0, 0]],
        }],
        "probe": probes,
        "stage": [{"kind": "quasi-static", "time_step": 1, "steps": 5}],
    } | more  # fmt: skip


class Done:
    """History, plan and log of a run, on every rank."""

    def __init__(self, folder, comm):
        found = None
        if comm.rank == 0:
            plan = {each["part"]: each for each in json.loads((folder / "plan.json").read_text())["decisions"]}
            found = read_history(folder / "history.h5"), plan, (folder / "log.txt").read_text()
        self.history, self.plan, self.log = comm.bcast(found)

    @property
    def probes(self):
        return {name: values for name, values in self.history.items() if name.startswith("probe/")}


@pytest.fixture
def done(shared_tmp, comm, monkeypatch):
    """Function (tables, progress) -> a run of them, however small. Collective."""
    monkeypatch.setattr(tied, "LEAST", 0)
    counter = [0]

    def once(data, progress=None):
        counter[0] += 1
        folder = shared_tmp / f"run{counter[0]}"
        try:
            run(Scene.from_data(data), folder, comm, progress)
        except Interrupted:
            comm.barrier()
            resume(folder, comm)
        return Done(folder, comm)

    return once


def largest_gap(found, sought):
    """Over all probes, as a share of the largest change of each."""
    assert found.probes.keys() == sought.probes.keys()
    gaps = []
    for name, values in sought.probes.items():
        change = np.nanmax(np.abs(values - values[0]), initial=0.0)
        gap = np.nanmax(np.abs(found.probes[name] - values), initial=0.0)
        gaps.append(gap / change if change > 0.0 else gap)
    return max(gaps)


FLUID = {"viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": 1e6, "compressibility": 4.5e-10}
PUMPED = {"name": "in", "at": {"fracture": "fault", "end": "start"}, "pressure": [[0, 1e6], [5, 2.5e6]]}
WAVES = {
    # a strain is a mean of cells around: within reach of a seam's walls the plan would keep that seam
    "probe": [
        {"name": "rock", "at": [50, 65]},
        {"name": "near", "at": [50, 26]},
        {"name": "fault", "at": [50, 50], "on": "fault"},
    ],
    "stage": [{"kind": "dynamic", "time_step": 0.004, "steps": 25}],
    "method": {"contact": "lumped", "events": "at-step-ends"},
    "support": [
        {"on": ["south", "north", "west", "east"], "displacement_gradient": [[0, [[0, 0], [0.08, 8e-5]]], [0, 0]]}
    ],
}


@pytest.mark.parametrize(
    ("amount", "more", "slips"),
    [(1e-4, {}, True), (2e-5, {"fluid": FLUID, "well": [PUMPED]}, False), (0, WAVES, True)],
    ids=["sheared", "pumped", "waves"],
)
def test_tied_fractures_are_within_the_tolerance_of_the_full_run(done, amount, more, slips):
    reduced, full = done(scene_of(amount, **more)), done(scene_of(amount, model="full", **more))
    assert reduced.plan[PART]["left_out"] and not full.plan[PART]["left_out"]
    assert (full.history["step/slipping"].max() > 0) == slips
    assert 0.0 < largest_gap(reduced, full) < 1e-2


def test_what_a_probe_of_the_rock_stands_on_is_not_tied(done):
    """On the wall of seam1: the rock of one side of it is not that of both."""
    data = scene_of(1e-4, stage=[{"kind": "steady", "time_step": 1, "steps": 1}])
    data["probe"] = [*data["probe"], {"name": "wall", "at": [50, 15], "on": "rock"}]
    said = done(data).plan[PART]
    assert said["left_out"] and "seam0, seam2, seam3, seam4, seam5:" in said["criterion"]


def test_walls_that_a_strain_in_the_rock_beside_is_made_of_are_not_tied(done):
    """5 m above seam1 the cell of a probe has its nodes, where a mean over both walls is another one than over one."""
    data = scene_of(1e-4, stage=[{"kind": "steady", "time_step": 1, "steps": 1}])
    data["probe"] = [*data["probe"], {"name": "beside", "at": [50, 17], "quantities": ["strain"]}]
    said = done(data).plan[PART]
    assert said["left_out"] and "seam0, seam2, seam3, seam4, seam5:" in said["criterion"]


def test_walls_whose_mass_is_moved_are_not_tied(done):
    """Their rock has another mass matrix: results differ by more than the compliance of stiff joints does."""
    data = scene_of(0, **WAVES | {"method": {}, "stage": [{"kind": "dynamic", "time_step": 0.004, "steps": 1}]})
    assert "redistributed" in done(data).plan[PART]["value"]


def test_violated_tie_is_undone_and_the_run_is_the_full_one(done, monkeypatch):
    """Told that loads add nothing, the plan ties all; in uniform shear G gamma the fifth step uses G gamma/(0.6 p) = 0.95."""
    monkeypatch.setattr(tied, "NEARBY", 0.0)
    amount = 0.95 * 0.6 * 1e7 / SHEAR
    full, times = done(scene_of(amount, fault=False, model="full")), []
    again = done(scene_of(amount, fault=False), lambda step: times.append(step.state.time))
    assert times == [1, 2, 3, 4, 1, 2, 3, 4, 5]

    def stopped(after):
        seen = []

        def stop(step):
            seen.append(step.state.time)
            if len(seen) == after:
                raise Interrupted("enough")

        return done(scene_of(amount, fault=False), stop)

    for each in (again, stopped(after=2), stopped(after=6)):  # in the first try, in the second
        said = each.plan[PART]
        assert not said["left_out"]
        assert said["undone"].startswith("time 5: 0.95 of the strength of seam") and "begun anew" in each.log
        np.testing.assert_array_equal(each.history["time"], full.history["time"])
        assert largest_gap(each, full) < 1e-9


def test_fluid_that_cannot_leave_takes_up_what_presses(done, monkeypatch):
    """Pressed by 2 MPa the seams are no stronger than before, 0.6 (10 - 1) MPa, where they are wet."""
    monkeypatch.setattr(tied, "NEARBY", 0.0)
    pressed, sheared = 2e6 * (1 - 0.25 - 2 * 0.25**2) / 1e10, 0.95 * 0.6 * 9e6 / SHEAR
    move = [[[0, 0], [5, -pressed]], [[0, 0], [5, sheared]]], [0, [[0, 0], [5, -pressed]]]
    support = [{"on": ["south", "north", "west", "east"], "displacement_gradient": move}]
    data = scene_of(0, fluid=FLUID, support=support)
    data["fracture"]["fault"] = data["fracture"]["default"]
    said = done(data).plan[PART]["undone"]
    assert said.startswith("time 5: ")
    assert float(said.split()[2]) == pytest.approx(0.95, rel=5e-3)


def test_resumed_run_ties_the_same(done):
    whole, seen = done(scene_of(1e-4)), []

    def stop(step):
        seen.append(step)
        if len(seen) == 3:
            raise Interrupted("enough")

    again = done(scene_of(1e-4), stop)
    assert again.plan[PART] == whole.plan[PART] and whole.plan[PART]["left_out"]
    np.testing.assert_array_equal(again.history["time"], whole.history["time"])
    assert largest_gap(again, whole) < 1e-9


def why_none(data, unknowns=tied.LEAST):
    return tied.why_none(ReductionInput(Scene.from_data(data), unknowns=unknowns))


@pytest.mark.serial
@pytest.mark.parametrize("change", [{"model": "full"}, {"model": "report"}, {"output": {"fields_every": 1}}])
def test_nothing_is_tied_where_all_is_asked_for(change):
    assert why_none(scene_of(1e-4, **change))
    assert not why_none(scene_of(1e-4))
    assert "displacements" in why_none(scene_of(1e-4), tied.LEAST - 1)


@pytest.mark.serial
def test_flow_rate_needs_a_bound_of_its_pressure():
    fluid = {"viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": 1e6}
    well = {"name": "in", "at": {"fracture": "fault", "end": "start"}, "flow_rate": 1e-6}
    assert "well.in" in why_none(scene_of(1e-4, fluid=fluid, well=[well]))
    data = scene_of(1e-4, fluid=fluid, well=[well | {"maximum_pressure": 3e6}])
    assert not why_none(data)
    assert tied.pressure_of_wells(Scene.from_data(data), {"in": 1e6}) == 2e6


@pytest.mark.serial
def test_crack_sheds_its_stress_along_its_line():
    """(Westergaard) At twice the half length from the middle 2/sqrt(3) - 1; as a^2/(2 x^2) far away."""
    near, far = shed(np.array([1.0, 99.0]), np.array([1.0, 1.0]))
    assert near == pytest.approx(2.0 / np.sqrt(3.0) - 1.0)
    assert far == pytest.approx(0.5e-4, rel=1e-3)
    assert shed(np.zeros(1), np.ones(1)) == np.inf


def rock(count=4, **more):
    """So many fractures of 10 m, 100 m apart, in 100 m by 100 m of rock of E' = 10 GPa; none is pumped into."""
    known = dict(
        names=tuple("abcdefgh"[:count]), group=np.arange(count), jumps=np.full(count, 40.0),
        length=np.full(count, 10.0), facet=np.ones(count), stiffness=np.full(count, 1e12), shear=np.zeros(count),
        barred=np.zeros(count, dtype=bool), apart=np.where(np.eye(count), 0.0, 100.0), reach=np.full(count, 5.0),
        held=np.full(count, np.inf), probed=np.zeros((0, count)), area=1e4, size=100.0, modulus=1e10, impedance=0.0,
    )  # fmt: skip
    return Fractures(**(known | more))


@pytest.mark.serial
def test_compliance_is_that_of_the_fracture_and_of_the_rock_with_all():
    """1e10/(1e12 * 10 m) of each; 1e10 * 10 m/(1e12 * 1e4 m^2) is less; with inertia 10 cells of 1 m over pi."""
    np.testing.assert_allclose(compliance(rock(), inertia=False), 1e-3)
    np.testing.assert_allclose(compliance(rock(), inertia=True), 1e-3 * np.pi)
    np.testing.assert_allclose(compliance(rock(area=50.0), inertia=False), 2e-3)


def chosen(known, use=lambda stress: stress / 1e7):
    return choose(ReductionInput(Scene.from_data(scene_of(1e-4)), unknowns=tied.LEAST), known, {}, use)


@pytest.mark.serial
def test_what_is_tied():
    """Loads add 1e10 * 1e-4 = 1 MPa, twice that as a bound, and what is kept sheds more: of 10 MPa 0.2 is used."""
    assert chosen(rock()).names == tuple("abcd") and chosen(rock()).use == pytest.approx(0.2)
    barred = chosen(rock(barred=np.array([True, False, False, False])))
    assert barred.names == tuple("bcd") and 0.2 < barred.use < 0.201
    assert barred.share == 0.75 and barred.jumps == 120
    assert chosen(rock(stiffness=np.array([1e12, 1e12, 1e12, 5e10]))).names == tuple("abc")  # E'/(k L) = 0.02
    assert chosen(rock(group=np.array([0, 0, 1, 2]), reach=np.full(3, 5.0), apart=np.full((3, 4), 100.0),
                       barred=np.array([True, False, False, False]))).names == tuple("cd")  # fmt: skip
    weak = chosen(rock(), lambda stress: stress / np.array([1e7, 1e7, 1e7, 2e6]))  # the last one uses all it has
    assert weak.names == tuple("abc")
    assert "of all jumps" in chosen(rock(jumps=np.array([10.0, 10, 10, 300]), barred=np.arange(4) == 3)).why
    assert not chosen(rock(apart=np.full((4, 4), 0.0), barred=np.arange(4) == 0)).names  # at the tip of what may slip


@pytest.mark.serial
def test_glued_mesh_is_the_one_split_without_those_fractures():
    """Two fractures that cross, and one apart, in 8 by 8 squares: each group taken out in turn."""
    side = 9
    corner = np.arange(side * side).reshape(side, side)  # row, column
    cells = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], axis=-1).reshape(-1, 4)
    lines = [corner[3, 1:6], corner[1:6, 3], corner[7, 2:8]]
    facets = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
    bottom = np.stack([corner[0, :-1], corner[0, 1:]], axis=1)
    raw = RawMesh(
        np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1).reshape(-1, 2), cells, np.zeros(64, dtype=int),
        ("rock",), np.concatenate(facets), np.repeat([0, 1, 2], [4, 4, 5]), ("a", "b", "c"), bottom, np.zeros(8, dtype=int),
        ("south",), {"here": 3},
    )  # fmt: skip
    whole = split(raw)
    assert groups(whole)[0] == groups(whole)[1] != groups(whole)[2]
    for out in ((True, True, False), (False, False, True)):
        kept = np.flatnonzero(~np.array(out))
        stays = np.isin(raw.fracture_of, kept)
        fewer = replace(
            raw, fracture_facets=raw.fracture_facets[stays], fractures=tuple(raw.fractures[k] for k in kept),
            fracture_of=np.searchsorted(kept, raw.fracture_of[stays]),
        )  # fmt: skip
        sought, found = split(fewer), merged_faces(whole, np.array(out))
        for field in fields(sought):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(sought, field.name), field.name)


TWO = """
Point(1) = {0, 0, 0, 2}; Point(2) = {4, 0, 0, 2}; Point(3) = {4, 4, 0, 2}; Point(4) = {0, 4, 0, 2};
Point(5) = {9, 0, 0, 2}; Point(6) = {13, 0, 0, 2}; Point(7) = {13, 4, 0, 2}; Point(8) = {9, 4, 0, 2};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Line(5) = {5, 6}; Line(6) = {6, 7}; Line(7) = {7, 8}; Line(8) = {8, 5};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1}; Curve Loop(2) = {5, 6, 7, 8}; Plane Surface(2) = {2};
Physical Surface("rock") = {1, 2}; Physical Curve("foot") = {1}; Physical Curve("top") = {3};
Physical Curve("other foot") = {5}; Physical Curve("other top") = {7};
"""
PAIR = """
[output]
pictures = false
[mesh]
file = "two.geo"
[rock.rock]
youngs_modulus = 1e10
poissons_ratio = 0.25
density = 2500
[[support]]
on = FEET
[[load]]
on = "top"
traction = [0, {time = [0, 1], value = [0, 1e6]}]
[[probe]]
name = "loaded"
at = [4, 4]
[[probe]]
name = "other"
at = [9, 4]
[[stage]]
kind = "quasi-static"
time_step = 0.5
steps = 2
"""


def test_part_that_nothing_loads_is_held_and_changes_nothing(shared_tmp, comm):
    def once(name, feet, *settings):
        if comm.rank == 0:
            (shared_tmp / "two.geo").write_text(TWO)
            (shared_tmp / f"{name}.toml").write_text(PAIR.replace("FEET", feet))
        comm.barrier()
        run(load(shared_tmp / f"{name}.toml", list(settings)), shared_tmp / name, comm)
        return Done(shared_tmp / name, comm)

    part = "parts of the rock that nothing loads"
    full = once("full", '["foot", "other foot"]', 'model="full"')
    for found in (once("held", '["foot", "other foot"]'), once("loose", '["foot"]')):
        assert found.plan[part]["left_out"] and found.plan[part]["value"] == "1 of 2"
        assert not np.any(found.history["probe/other/displacement"])
        assert largest_gap(found, full) < 1e-12
    assert not full.plan[part]["left_out"]
    pushed = once("pushed", '["foot", "other foot"]', "load.0.on=['top', 'other top']")
    assert not pushed.plan[part]["left_out"]
