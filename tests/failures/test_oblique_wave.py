"""F10: a P pulse at 60 degrees on a side with dashpots: what comes back is that of the closed form, 13 %, and is stated."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.elements.dashpot import reflection
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.scene.toml import write_value
from fracflow.simulation.run import run

SCENE = Path(__file__).parents[2] / "meshes/failures/oblique_wave/scene.toml"
ANGLE, POISSON = np.radians(60.0), 0.25


def motion(folder, *overrides):
    comm = MPI.COMM_WORLD
    run(load(SCENE, ["output.pictures=false", *overrides]), folder, comm)
    found = (read_history(folder / "history.h5"), (folder / "log.txt").read_text()) if comm.rank == 0 else None
    return comm.bcast(found)


def everywhere():
    """The wave given on all four sides: the rock as if it went on."""
    wave = load(SCENE).model_dump(exclude_none=True)["absorbing"][0]["wave"]
    return f"absorbing={write_value([{'on': ['west', 'south', 'north', 'east'], 'wave': wave}])}"


def test_reflection_at_60_degrees(shared_tmp):
    """With the wave given on all sides none reflects; what the bare side adds is its P and S wave, told apart by direction."""
    history, log = motion(shared_tmp / "bare")
    alone, _ = motion(shared_tmp / "alone", everywhere())
    assert (
        "absorbing east: of a P wave 2.4% of the energy comes back over all directions, at most 3.6% up to 60 degrees"
        in log
    )
    assert (
        "of its amplitude 0.000 at 0, 0.014 at 45, 0.134 at 60, 0.413 at 75 degrees as P, 0.000, 0.071, 0.134, 0.132 as S"
        in log
    )
    assert "of its amplitude 0.000 at 0, 0.134 at 30, 0.169 at 45, 0.337 at 60, 0.592 at 75 degrees as S" in log
    incident, back = alone["probe/side/velocity"], history["probe/side/velocity"] - alone["probe/side/velocity"]
    to_s = np.arcsin(np.sin(ANGLE) / np.sqrt(3.0))
    ways = np.array([[-np.cos(ANGLE), np.sin(ANGLE)], [-np.sin(to_s), -np.cos(to_s)]])
    amplitude = np.linalg.solve(ways.T, back.T)[0]
    came = incident @ np.array([np.cos(ANGLE), np.sin(ANGLE)])
    assert came.max() == pytest.approx(0.01, rel=0.03)  # the pulse arrives as it was sent
    share = abs(amplitude @ came) / (came @ came)
    assert share == pytest.approx(reflection(POISSON, 60.0), abs=2e-3)
    assert reflection(POISSON, 60.0) == pytest.approx(0.134, abs=5e-4)
    for found in (history, alone):
        largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
        assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
