"""The memory that a run holds while it runs."""

import gc
import tracemalloc
from pathlib import Path

import pytest

from fracflow._petsc import MPI, PETSc
from fracflow.advance import discontinuities as instants
from fracflow.advance.step import Stepping
from fracflow.diagnostics import pre_run_checks
from fracflow.errors import SolveError
from fracflow.mesh.distribute import distribute
from fracflow.model.setup import read_sized
from fracflow.output.sampling import StateSampler
from fracflow.scene.scene import Scene, load
from fracflow.simulation.recorder import Recorder
from fracflow.simulation.run import run

SHORT = {name: ["stage.1.steps=3"] for name in ("crossings", "report_5_3")}
MESHES = Path(__file__).parents[1] / "meshes"


@pytest.fixture(autouse=True)
def nothing_left_before():
    """No object of an earlier test may be collected in one of these."""
    gc.collect()
    PETSc.garbage_cleanup()


@pytest.mark.parametrize(
    "name, overrides",
    [
        ("crossings", []),
        ("report_5_3", ["method.coupling=fixed-point", "fracture.fault.aperture=0.2 ft", "stage.failure.steps=3"]),
        ("report_5_3", ["method.coupling=condensed", "stage.failure.steps=20"]),
        ("crossings", ["initial.velocity=[1e-6, 0]", "stage.0={kind = 'equilibrate', steps = 2}"]),
        ("failures/closing_joint", ["accuracy.max_iterations=6"]),
        ("failures/no_outlet", ["stage.0={kind = 'dynamic', time_step = 1e-6, steps = 5}"]),
    ],
    ids=["default", "fixed-point", "condensed", "equilibrate", "halved", "enclosed"],
)
def test_nothing_is_left_to_a_collection(name, overrides, shared_tmp, capfd):
    """petsc4py keeps every object that was not destroyed until the next run begins: a few a step fill the memory."""
    left = []

    def count(*_):
        PETSc.garbage_view()
        left.append(capfd.readouterr().out)

    scene = load(MESHES / name / "scene.toml", ["output.pictures=false", *SHORT.get(name, ()), *overrides])
    run(scene, shared_tmp / "out", progress=count)
    assert len(left) > 3
    assert left[0] or MPI.COMM_WORLD.rank
    assert all("Total entries: 0" in text or not text for text in left), left[-1]


@pytest.mark.parametrize("instant", [1, 2], ids=["a stage begins", "a joint slips"])
def test_nothing_is_left_by_an_instant_that_is_not_found(instant, shared_tmp, capfd, monkeypatch):
    """First accelerations fail as the stage of 5.2 begins, or at its first event: what was made until then is freed."""
    found, made_up = instants.initial_acceleration, "made up"

    def fail_at_last(*args):
        calls.append(args[-1])
        if len(calls) == instant:
            raise SolveError(made_up)
        found(*args)

    calls = []
    monkeypatch.setattr(instants, "initial_acceleration", fail_at_last)
    PETSc.garbage_cleanup()
    with pytest.raises(SolveError, match=made_up) as caught:
        run(load(MESHES / "report_5_2" / "scene.toml", ["output.pictures=false"]), shared_tmp / "out")
    assert len(calls) == instant
    calls.clear()
    caught.value.__cause__ = caught.value.__context__ = None  # frames of what failed; those of the run keep its model
    gc.collect()
    capfd.readouterr()
    PETSc.garbage_view()
    text = capfd.readouterr().out
    assert "Total entries: 0" in text if MPI.COMM_WORLD.rank == 0 else not text or "Total entries: 0" in text


def test_solvers_are_freed_before_the_last_fields_are_written(shared_tmp, monkeypatch):
    """The fields of the rock take a tenth of the memory of the solvers: both at once would be the peak of a run."""
    order = []
    for kind, name in ((Stepping, "destroy"), (Recorder, "last")):
        work = getattr(kind, name)

        def noted(*given, name=name, work=work):
            order.append(name)
            return work(*given)

        monkeypatch.setattr(kind, name, noted)
    run(load(MESHES / "report_5_3" / "scene.toml", ["output.pictures=false", *SHORT["report_5_3"]]), shared_tmp / "out")
    assert order == ["destroy", "last"]


@pytest.mark.serial
def test_one_rank_holds_arrays_of_the_mesh_once():
    mesh = read_sized(load(MESHES / "report_5_3" / "scene.toml"))
    block = distribute(mesh, MPI.COMM_SELF).solid
    shared = ("cells", "points", "origin", "cell_rock")
    assert all(getattr(block, name) is getattr(mesh, name) for name in shared)
    assert block.node_global.base is None  # a view would keep other numbers alive


@pytest.mark.serial
def test_pre_run_checks_need_little_memory_a_joint():
    """Of 20 fractures of 500 joints, whose flow is checked too: 605 bytes a joint, 948 with values of all cells."""
    fractures = [{"name": f"f{row}", "points": [[0, row], [10, row]]} for row in range(20)]
    law = {"normal_stiffness": 2e12, "shear_stiffness": 2e12, "aperture": 1e-3, "friction_coefficient": 0.6}
    scene = Scene.from_data({
        "geometry": {"domain": "unbounded", "size": 0.02, "fracture": fractures},
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500}},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -5e6}, "fluid": {"viscosity": 1e-3},
        "fracture": {"default": law}, "stage": [{"kind": "quasi-static", "time_step": 1, "steps": 3}],
    })  # fmt: skip
    mesh = read_sized(scene)
    pre_run_checks(scene, mesh, {})  # imports, and what is kept for ever
    tracemalloc.start()
    pre_run_checks(scene, mesh, {})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(mesh.joint_flow) == 10_000 and peak < 700 * len(mesh.joint_flow)


@pytest.mark.parametrize(
    ("stage", "most"),
    [
        ("{kind = 'dynamic', time_step = 1e-6, steps = 2}", 48),
        ("{kind = 'auto', time_step = 1e-6, dynamic_time_step = 1e-6, end = 2e-6}", 64),
    ],
    ids=["dynamic", "auto"],
)
def test_joint_ends_on_record_are_few_numbers_a_joint(stage, most, shared_tmp, monkeypatch):
    """Flags in one number, slip and its rate, for a catalogue the traction, at both ends: 96 bytes of any stage before."""
    found, snapshot = [], StateSampler.snapshot

    def noted(self):
        found.append(snapshot(self))
        return found[-1]

    monkeypatch.setattr(StateSampler, "snapshot", noted)
    scene = load(MESHES / "failures" / "no_outlet" / "scene.toml", ["output.pictures=false", f"stage=[{stage}]"])
    run(scene, shared_tmp / "out")
    assert len(found) > 2
    if MPI.COMM_WORLD.rank == 0:
        assert found[-1].ends.nbytes == most * len(found[-1].ends) > 0
