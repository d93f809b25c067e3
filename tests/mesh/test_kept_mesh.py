"""`fracflow mesh -o NAME.h5` keeps a split mesh: a scene that reads it has the same run, without Gmsh."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from pages import ROOT

from fracflow.cli.mesh import mesh_lines
from fracflow.errors import InputError
from fracflow.mesh.store import load_split, save_mesh
from fracflow.output.history import read_history
from fracflow.reduction.prepare import read_uncut
from fracflow.scene.scene import load
from fracflow.simulation.run import run

CROSSINGS = ROOT / "meshes/crossings/scene.toml"
SHORT = ["stage.1.steps=2", "output.pictures=false"]


@pytest.mark.serial
@pytest.mark.parametrize("refine", [0, 1])
def test_a_scene_with_a_kept_mesh_is_the_same_run(refine, tmp_path):
    given = [*SHORT, f"mesh.refine={refine}"]
    lines = list(mesh_lines(load(CROSSINGS, given), tmp_path / "kept.h5"))
    assert lines[-1].endswith('by [mesh] file = "kept.h5"' + (f", with refine = {refine} as here" if refine else ""))
    run(load(CROSSINGS, given), tmp_path / "one")
    run(load(CROSSINGS, [*given, f"mesh.file={tmp_path / 'kept.h5'}"]), tmp_path / "other")
    one, other = (read_history(tmp_path / name / "history.h5") for name in ("one", "other"))
    assert one.keys() == other.keys() and len(one["time"]) > 2
    assert all(np.array_equal(one[key], other[key], equal_nan=True) for key in one if not key.startswith("step/"))


@pytest.mark.serial
def test_a_mesh_that_is_kept_takes_the_place_of_its_like_alone(tmp_path):
    scene, path = load(CROSSINGS), tmp_path / "kept.h5"
    for _ in range(2):
        list(mesh_lines(scene, path))
    with h5py.File(tmp_path / "data.h5", "w") as file:
        file["data"] = np.arange(3)
    for name, says in (("data.h5", "would be lost; name another"), ("mesh.msh", "name one with -o NAME.h5")):
        with pytest.raises(InputError, match=says):
            list(mesh_lines(scene, tmp_path / name))
    with h5py.File(tmp_path / "data.h5") as file:
        assert file["data"].shape == (3,)
    unbounded = load(ROOT / "meshes/mapped_network/pressed.toml", ["geometry.domain=unbounded"])
    with pytest.raises(InputError, match="there is no mesh to write; leave -o out"):
        list(mesh_lines(unbounded, path))


@pytest.mark.serial
def test_other_files_are_refused_in_a_line(tmp_path):
    """HDF5 of others, a mesh that was changed, one in which a well joined ends of fractures, and none."""
    path, scene = tmp_path / "kept.h5", load(CROSSINGS)
    list(mesh_lines(scene, path))
    with h5py.File(tmp_path / "data.h5", "w") as file:
        file["data"] = np.arange(3)
    changed = tmp_path / "changed.h5"
    changed.write_bytes(path.read_bytes())
    with h5py.File(changed, "r+") as file:
        file["points"][0, 0] += 1.0
    (tmp_path / "short.h5").write_bytes(path.read_bytes()[:-1])
    (tmp_path / "text.h5").write_text("no mesh", encoding="utf-8")
    joined = read_uncut(scene)[1]
    kept = np.arange(len(joined.flow_origin) - 1)
    fewer = joined.joint_flow.clip(max=kept[-1])
    save_mesh(
        type(joined)(**{**vars(joined), "joint_flow": fewer, "flow_origin": joined.flow_origin[kept]}),
        tmp_path / "j.h5",
    )
    for name, says in (
        ("data", "is no saved mesh"), ("changed", "points"), ("j", "joined ends"), ("none", "none.h5"),
        ("short", r"is no saved mesh \(the file is cut short\);"), ("text", r"is no saved mesh \(no HDF5 file\);"),
    ):  # fmt: skip
        file = "j.h5" if name == "j" else f"{name}.h5"
        with pytest.raises(InputError, match=says) as refused:
            run(load(CROSSINGS, [*SHORT, f"mesh.file={tmp_path / file}"]), tmp_path / "run")
        assert "\n" not in str(refused.value) and "scene.toml" in str(refused.value)
    assert not (tmp_path / "run").exists()
    assert len(load_split(path).cells) == len(joined.cells)


def test_ranks_read_a_kept_mesh(shared_tmp, comm):
    path = shared_tmp / "kept.h5"
    if comm.rank == 0:
        list(mesh_lines(load(CROSSINGS), path))
    comm.barrier()
    run(load(CROSSINGS, [*SHORT, f"mesh.file={path}"]), shared_tmp / "run", comm)
    if comm.rank == 0:
        assert len(read_history(shared_tmp / "run" / "history.h5")["time"]) > 2
