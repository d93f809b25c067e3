"""A rank that meets an error which the others do not meet ends them all, with its line, and does not hang."""

import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.store import is_saved_mesh
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load

PROGRAM = """
from fracflow.cli import exit as endings
from fracflow._petsc import MPI
endings.PATIENCE = 0.5
if MPI.COMM_WORLD.rank == {rank}:
    endings.stop("no such file", 2)
MPI.COMM_WORLD.barrier()
"""


def started(program):
    kept = without_ranks()
    environment = {**kept, "PYTHONPATH": str(Path(__file__).parents[2])}
    words = ["mpirun", "-n", "2", sys.executable, "-c", program]
    return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60)


@pytest.mark.serial
@pytest.mark.starts_ranks
@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_alone_ends_all(rank):
    done = started(PROGRAM.format(rank=rank))
    assert done.returncode == 2, done.stderr
    assert f"fracflow: rank {rank} alone: no such file" in done.stderr
    assert done.stderr.count("fracflow: ") == 1


INTERRUPTED = """
import sys
from fracflow.cli import app as cli
from fracflow.cli import exit as endings
from fracflow.scene import scene
from fracflow._petsc import MPI
endings.PATIENCE = 0.5
def load(*given):
    if MPI.COMM_WORLD.rank == 0:
        raise KeyboardInterrupt
    MPI.COMM_WORLD.barrier()
scene.load = load
sys.argv = ["fracflow", "run", "scene.toml"]
cli.main()
"""


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_an_interrupt_of_one_rank_before_the_first_step_ends_all():
    done = started(INTERRUPTED)
    assert done.returncode == 130, done.stderr
    assert "fracflow: rank 0 alone: interrupted before the first step" in done.stderr


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_one_rank_keeps_a_mesh_and_tells_of_it(tmp_path):
    scene = Path(__file__).parents[2] / "meshes/failures/closing_joint/scene.toml"
    words = ["fracflow", "mesh", str(scene), "-o", str(tmp_path / "kept.h5")]
    done = started(f"import sys; from fracflow.cli.app import main; sys.argv = {words!r}; main()")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("cells: ") == 1 and is_saved_mesh(tmp_path / "kept.h5")


@pytest.mark.parametrize("name", ["unresolved", "unconnected_wells"])
def test_an_error_in_what_one_rank_looks_at_alone_is_raised_on_all(name, monkeypatch):
    """Sizes of cells and wells apart are looked at where the mesh is; the others must not go on without it."""

    def refuse(*given):
        raise InputError("no such thing")

    monkeypatch.setattr(f"fracflow.reduction.prepare.{name}", refuse)
    scene = load(Path(__file__).parents[2] / "meshes/report_5_2/scene.toml")
    with pytest.raises(InputError, match="no such thing"):
        prepare(scene, MPI.COMM_WORLD)
