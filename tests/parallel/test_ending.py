"""A rank that meets an error which the others do not meet ends them all, with its line, and does not hang."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
from fracflow import endings
from fracflow._petsc import MPI
endings.PATIENCE = 0.5
if MPI.COMM_WORLD.rank == {rank}:
    endings.stop("no such file", 2)
MPI.COMM_WORLD.barrier()
"""


@pytest.mark.serial
@pytest.mark.starts_ranks
@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_alone_ends_all(rank):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMIX", "PMI_"))}
    environment = {**kept, "PYTHONPATH": str(Path(__file__).parents[2])}
    words = ["mpirun", "-n", "2", sys.executable, "-c", PROGRAM.format(rank=rank)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2, done.stderr
    assert f"fracflow: rank {rank} alone: no such file" in done.stderr
