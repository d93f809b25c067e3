"""Runs of a saved mesh that ranks take in slices: histories, checks and files as of one that rank 0 reads and sends."""

import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_same_on_ranks import KEPT, SCENES, _settled, assert_agree

from fracflow._petsc import MPI
from fracflow.cli.mesh import mesh_lines
from fracflow.errors import InputError, Interrupted
from fracflow.mesh.store import load_mesh, mesh_root, save_mesh
from fracflow.output import list_steps, read_events, read_history, read_step
from fracflow.reduction import locked_fractures
from fracflow.reduction.locked_fractures import PART
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import resume, run

CROSSINGS = "meshes/crossings/scene.toml"
MOVES = "[30.0, 30.0]", "[175.0, 40.0]"  # a probe in the rock, to cells that were not near
# events at the ends of steps: the times of located ones carry the round-off of another order of unknowns several times over
SHORT = ["method.events=at-step-ends", "stage.1.steps=12", "output.pictures=false", "output.checkpoint_every=1"]
SEAMS = {  # a square that is sheared; three stiff fractures of friction 0.6, which may be locked, and a fault of 0.03
    "output": {"pictures": False},
    "geometry": {
        "domain": [[0, 0], [100, 0], [100, 100], [0, 100]], "size": 15, "size_at_fractures": 8,
        "fracture": [
            {"name": f"seam{n}", "points": [[x - 8, y], [x + 8, y]]} for n, (x, y) in enumerate([(20, 15), (80, 15), (50, 85)])
        ] + [{"name": "fault", "points": [[40, 50], [60, 50]]}],
    },
    "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500}},
    "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -5e6},
    "fracture": {
        "default": {"normal_stiffness": 2e12, "shear_stiffness": 2e12, "aperture": 1e-3, "friction_coefficient": 0.6},
        "fault": {"normal_stiffness": 5e10, "shear_stiffness": 2e10, "aperture": 1e-3, "friction_coefficient": 0.03},
    },
    "support": [{
        "on": ["south", "north", "west", "east"],
        "displacement_gradient": [[0, {"time": [0, 3], "value": [0, 1e-4]}], [0, 0]],
    }],
    "probe": [{"name": "rock", "at": [50, 65]}, {"name": "fault", "at": [50, 50], "on": "fault"}],
    "stage": [{"kind": "quasi-static", "time_step": 1, "steps": 3}],
}  # fmt: skip


@pytest.fixture
def in_slices(monkeypatch):
    """Whether ranks take slices of a mesh, however small; function (bool)."""

    def switch(is_on):
        monkeypatch.setattr("fracflow.mesh.slices.reading.FEWEST", 0 if is_on else 10**9)

    return switch


def _kept(scene, path, comm):
    if comm.rank == 0:
        list(mesh_lines(scene, path))
    comm.barrier()
    return path


def _assert_same(folders, name):
    """Histories of two folders to round-off of natural sizes, up to what arithmetic settles."""
    one, other = (read_history(folder / "history.h5") for folder in folders)
    assert one.keys() == other.keys() and len(one["time"]) > 2
    rows = min(_settled(one), _settled(other))
    assert rows > 0.5 * len(one["time"])
    assert_agree(one, other, rows, *SCENES.get(name, (1e-4, 1e7)))


def _said(folder):
    """Lines of the log on mesh and places, and the pre-run checks."""
    lines = (folder / "log.txt").read_text(encoding="utf-8").splitlines()
    about = [line for line in lines if any(word in line for word in ("mesh: ", "probe.", "well.", "sits on"))]
    return about, json.loads((folder / "plan.json").read_text())["card"]


def test_a_run_by_slices_is_that_of_the_whole_mesh(shared_tmp, comm, in_slices):
    """Also where a process of its own reads the mesh, and rank 0 passes on rows: the mesh is to the bit that of a kept one."""
    path = _kept(load(CROSSINGS), shared_tmp / "kept.h5", comm)
    scene = load(CROSSINGS, [*SHORT, f"mesh.file={path}"])
    for name in ("whole", "sliced", "made"):
        in_slices(name != "whole")
        run(load(CROSSINGS, SHORT) if name == "made" else scene, shared_tmp / name, comm)
    if comm.rank == 0:
        _assert_same([shared_tmp / name for name in ("made", "sliced")], "crossings")
        assert mesh_root(shared_tmp / "made" / "mesh.h5") == mesh_root(shared_tmp / "sliced" / "mesh.h5")
        assert _said(shared_tmp / "made") == _said(shared_tmp / "sliced")
        _assert_same([shared_tmp / name for name in ("whole", "sliced")], "crossings")
        (lines, card), (same, other) = (_said(shared_tmp / name) for name in ("whole", "sliced"))
        assert lines == same and len(lines) > 2
        assert [each["name"] for each in card] == [each["name"] for each in other]
        for one, two in zip(card, other, strict=True):
            assert one["value"] == two["value"] or one["value"] == pytest.approx(two["value"], rel=1e-9), one["name"]
        meshes = [load_mesh(shared_tmp / name / "mesh.h5") for name in ("whole", "sliced")]
        assert len(meshes[0].cells) == len(meshes[1].cells) and meshes[0].near == -1
        assert 0 < meshes[1].near < len(meshes[1].cells)


def test_a_run_by_slices_goes_on_by_slices(shared_tmp, comm, in_slices):
    """On one rank, too; it takes the mesh whole where a probe has moved to other cells."""
    path = _kept(load(CROSSINGS), shared_tmp / "kept.h5", comm)
    scene, made = load(CROSSINGS, [*SHORT, f"mesh.file={path}"]), [0]

    def stop(_):
        made[0] += 1
        if made[0] == 6:
            os.kill(os.getpid(), signal.SIGTERM)

    in_slices(True)
    run(scene, shared_tmp / "whole", comm)
    with pytest.raises(Interrupted):
        run(scene, shared_tmp / "stopped", comm, progress=stop)
    comm.barrier()
    if comm.rank == 0:
        shutil.copytree(shared_tmp / "stopped", shared_tmp / "alone")
        shutil.copytree(shared_tmp / "stopped", shared_tmp / "moved")
        text = (shared_tmp / "moved" / "scene.toml").read_text()
        assert text.count(MOVES[0]) == 1
        (shared_tmp / "moved" / "scene.toml").write_text(text.replace(*MOVES))
        resume(shared_tmp / "alone", MPI.COMM_SELF)
    comm.barrier()
    resume(shared_tmp / "stopped", comm)
    resume(shared_tmp / "moved", comm)
    if comm.rank == 0:
        _assert_same([shared_tmp / name for name in ("whole", "alone")], "crossings")
        moved = read_history(shared_tmp / "moved" / "history.h5")
        assert len(moved["time"]) == len(read_history(shared_tmp / "whole" / "history.h5")["time"])
        _assert_same([shared_tmp / name for name in ("whole", "stopped")], "crossings")


@pytest.mark.parametrize("use", [1.0, 0.0], ids=["locked", "undone"])
def test_locked_fractures_of_a_mesh_in_slices(use, shared_tmp, comm, in_slices, monkeypatch):
    """The mesh without them is that of all; where they come back, the run begins anew with slices of its own mesh."""
    path = _kept(Scene.from_data(SEAMS), shared_tmp / "kept.h5", comm)
    data = {key: value for key, value in SEAMS.items() if key != "geometry"} | {"mesh": {"file": str(path)}}
    monkeypatch.setattr(locked_fractures, "LEAST", 0)
    monkeypatch.setattr("fracflow.reduction.locked_mesh.USE", use if use == 0.0 else locked_fractures.USE)
    for name in ("whole", "sliced"):
        in_slices(name == "sliced")
        run(Scene.from_data(data), shared_tmp / name, comm)
    if comm.rank == 0:
        _assert_same([shared_tmp / name for name in ("whole", "sliced")], "seams")
        for name in ("whole", "sliced"):
            plan = json.loads((shared_tmp / name / "plan.json").read_text())["decisions"]
            (said,) = (each for each in plan if each["part"] == PART)
            assert said["left_out"] == (use > 0.0) and bool(said.get("undone")) == (use == 0.0)


def test_outer_curves_without_a_name_are_found_on_pieces(shared_tmp, comm, in_slices):
    """The east side of the square carries initial stress, and no facet of it has a name."""
    path = _kept(Scene.from_data(SEAMS), shared_tmp / "kept.h5", comm)
    if comm.rank == 0:
        mesh = load_mesh(path)
        stays = mesh.side_of != mesh.sides.index("east")
        sides = {name: getattr(mesh, name)[stays] for name in ("side_facets", "side_cell", "side_of")}
        save_mesh(replace(mesh, **sides), path)
    comm.barrier()
    data = {key: value for key, value in SEAMS.items() if key != "geometry"} | {"mesh": {"file": str(path)}}
    for is_on in (False, True):
        in_slices(is_on)
        with pytest.raises(InputError, match=r"outer curves without a name, as at \(100, [0-9.]+\):"):
            run(Scene.from_data(data), shared_tmp / "refused", comm)


PROGRAM = """
import sys
from fracflow.mesh.slices import reading
from fracflow.scene.scene import load
from fracflow.simulation.run import run
reading.FEWEST = int(sys.argv[1])
run(load({scene!r}, {settings!r}), sys.argv[2])
"""


@pytest.mark.serial
@pytest.mark.starts_ranks
@pytest.mark.parametrize(
    ("scene", "settings"), [(CROSSINGS, []), ("meshes/report_5_5/scene.toml", ["stage.failure.steps=150"])]
)
def test_slices_on_1_2_and_3_ranks(scene, settings, tmp_path):
    """The same histories and events in slices as on one rank, and as from rank 0."""
    list(mesh_lines(load(scene), tmp_path / "kept.h5"))
    settings = [*settings, "output.pictures=false", f"mesh={{file = '{tmp_path / 'kept.h5'}'}}"]
    run(load(scene, settings), tmp_path / "1")
    events = read_events(tmp_path / "1" / "events.csv")
    assert events
    clean = {k: v for k, v in os.environ.items() if k in KEPT}
    for ranks in (2, 3):
        for fewest in (0, 10**9):
            out = tmp_path / f"{ranks}-{fewest}"
            words = [sys.executable, "-c", PROGRAM.format(scene=scene, settings=settings), str(fewest), str(out)]
            subprocess.run(
                ["mpirun", "--oversubscribe", "-n", str(ranks), *words], check=True, env=clean, timeout=300,
                stdin=subprocess.DEVNULL,
            )  # fmt: skip
            _assert_same([tmp_path / "1", out], Path(scene).parent.name)
            same = read_events(out / "events.csv")
            assert [(e["kind"], e["fracture"]) for e in same] == [(e["kind"], e["fracture"]) for e in events]
            assert [e["start"] for e in same] == pytest.approx([e["start"] for e in events], rel=1e-9)
            first, mine = (read_step(list_steps(folder, "fractures")[0][1])[1:] for folder in (tmp_path / "1", out))
            assert first[0].keys() == mine[0].keys() and np.array_equal(first[1]["fracture"], mine[1]["fracture"])
            for name, values in first[0].items():
                size = np.abs(values).max(initial=0.0, where=np.isfinite(values))
                assert np.allclose(values, mine[0][name], rtol=1e-9, atol=1e-9 * size, equal_nan=True), name
