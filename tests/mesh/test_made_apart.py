"""A large mesh by a process of its own: the same mesh, the same errors, and a line where that process ends."""

import os
import signal
import tempfile

import numpy as np
import pytest
from pages import ROOT

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.read import MeshFile
from fracflow.mesh.slices import reading
from fracflow.mesh.slices.making import made
from fracflow.mesh.split import split
from fracflow.mesh.store import ARRAYS, load_split
from fracflow.model.setup import source_of
from fracflow.reduction.sliced import taken
from fracflow.scene.scene import load


@pytest.mark.serial
def test_it_is_the_mesh_that_this_process_would_make(tmp_path):
    source = source_of(load(ROOT / "meshes/crossings/scene.toml"))
    apart, mesh = load_split(made(source, tmp_path)), split(source.raw())
    for name in ARRAYS:
        assert np.array_equal(getattr(apart, name), getattr(mesh, name)), name
    assert (apart.rocks, apart.fractures, apart.sides, apart.notes) == (
        mesh.rocks,
        mesh.fractures,
        mesh.sides,
        mesh.notes,
    )


@pytest.mark.serial
@pytest.mark.parametrize("scene", ["injection_cycle", "mapped_network"])
def test_cells_are_expected_at_a_guess(scene):
    source = source_of(load(ROOT / "meshes" / scene / "scene.toml"))
    assert 0.5 < source.expected / len(source.raw().cells) < 2.0


@pytest.mark.serial
def test_its_errors_are_those_of_this_process(tmp_path):
    (tmp_path / "bad.msh").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\nnonsense\n$EndNodes\n")
    source, said = MeshFile(tmp_path / "bad.msh", ("default",)), []
    for read in (source.raw, lambda: made(source, tmp_path)):
        with pytest.raises(InputError, match=r"bad\.msh: ") as error:
            read()
        said.append(str(error.value))
    assert said[0] == said[1]


class _Ends:
    """A source whose reading does something else."""

    expected = float(reading.FEWEST)

    def __init__(self, work, *given):
        self._does = work, given

    def __reduce__(self):
        return self._does

    def sized(self):
        return self


@pytest.mark.serial
@pytest.mark.parametrize(
    ("source", "says"),
    [
        (
            _Ends(signal.raise_signal, signal.SIGKILL),
            "mesh: the process that makes it was ended by signal 9; give it more",
        ),
        (_Ends(int, "no number"), "mesh: the process that makes it failed: ValueError: invalid literal"),
        (
            _Ends(os.listdir, "/none"),
            "mesh: cannot be written for ranks to read: .*: No such file .*; make room, or set TMPDIR",
        ),
        (_Ends(tempfile.mkdtemp), "mesh: the process that makes it failed: AttributeError"),
    ],
    ids=["killed", "failed", "no room", "with a folder of its own"],
)
def test_its_end_is_told_in_a_line(source, says, monkeypatch, tmp_path):
    """Nothing is left in the folder for temporary files."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr("fracflow.reduction.sliced.source_of", lambda _: source)
    with pytest.raises(InputError, match=says):
        taken(load(ROOT / "meshes/crossings/scene.toml"), MPI.COMM_SELF, None)
    assert not list(tmp_path.iterdir())


@pytest.mark.serial
def test_cells_of_a_file_whose_size_is_no_guide_are_counted(tmp_path):
    source = source_of(load(ROOT / "meshes/crossings/scene.toml"))
    opened = source.sized()
    assert source.expected < 50.0 and opened.expected == len(source.raw().cells) == 410
    apart, mesh = load_split(made(opened, tmp_path)), split(source.raw())
    assert all(np.array_equal(getattr(apart, name), getattr(mesh, name)) for name in ARRAYS)


def test_rank_0_splits_no_large_mesh_that_ranks_cut(monkeypatch):
    monkeypatch.setattr(reading, "FEWEST", 100)
    monkeypatch.setattr("fracflow.reduction.sliced.split", None)
    comm = MPI.COMM_WORLD
    mesh, _, blocks = taken(load(ROOT / "meshes/injection_cycle/scene.toml", ["geometry.refine=1"]), comm, None)
    assert blocks is None and (mesh is None) == (comm.rank > 0)


def test_no_folder_for_temporary_files_is_told_on_every_rank(monkeypatch, tmp_path):
    """And only where one is needed: rank 0 alone knew, and others waited."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    scene = load(ROOT / "meshes/crossings/scene.toml", [f"mesh.file={ROOT / 'tests/mesh/none.h5'}"])
    with pytest.raises(InputError, match=r"none\.h5"):
        taken(scene, MPI.COMM_WORLD, None)
    monkeypatch.setattr("fracflow.reduction.sliced.source_of", lambda _: _Ends(int))
    with pytest.raises(
        InputError, match=r"mesh: cannot be written for ranks to read: .*none.*; make room, or set TMPDIR"
    ):
        taken(load(ROOT / "meshes/crossings/scene.toml"), MPI.COMM_WORLD, None)
