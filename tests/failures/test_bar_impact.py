"""F4: a bar hits a stiff joint: one closing, the energy stays, the force is 1; with mass on its face it chatters."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = "meshes/failures/bar_impact/scene.toml"
START = 0.5 / 40  # rho v^2/2 of the bar, 1 x 1/40


def _ran(folder, *overrides):
    comm = MPI.COMM_WORLD
    run(load(SCENE, ["output.pictures=false", *overrides]), folder, comm)
    found = None
    if comm.rank == 0:
        found = (
            read_history(folder / "history.h5"),
            read_events(folder / "events.csv"),
            (folder / "log.txt").read_text(),
        )
    return comm.bcast(found)


def _energy(history):
    """Kinetic and strain energy, that of the joint in closed form, over what the bar brought."""
    parts = ("kinetic", "rock_strain", "joint_normal_closed", "joint_shear")
    return sum(history[f"energy/{name}"] for name in parts) / START


def _force(history):
    held = (history["time"] > 0.2) & (history["time"] < 1.8)
    return -history["probe/face/normal_traction"][held]


def _closings(history):
    """How often the face comes to carry force."""
    carries = (history["probe/face/normal_traction"] < 0.0).astype(int)
    return int((np.diff(carries) > 0).sum())


@pytest.mark.parametrize("events", ["located", "at-step-ends"])
def test_one_closing_and_no_energy_made(shared_tmp, events):
    history, opened, log = _ran(shared_tmp, f"method.events={events}")
    assert _closings(history) == 1
    assert {event["end"] for event in opened} == {None} and "contact opened" not in log
    assert _energy(history).max() <= 1.001 and _energy(history)[-1] >= 0.999
    assert _force(history) == pytest.approx(1.0, abs=0.05)
    assert _force(history).std() < 0.01
    # the wave is back at the face when it has gone 2
    parted = min(event["start"] for event in opened)
    assert parted == pytest.approx(2.0, abs=0.04 if events == "located" else 0.04 + 0.025)
    largest = max(np.abs(v).max() for k, v in history.items() if k.startswith("energy/"))
    assert np.abs(history["energy/residual"]).max() <= 1e-10 * largest


@pytest.mark.serial
@pytest.mark.parametrize(("events", "energy"), [("located", 1.0), ("at-step-ends", 11.205)])
def test_with_its_mass_on_the_face_the_bar_chatters(shared_tmp, events, energy):
    """Energy from where-methods-fail 4; what locating events saves of it, it does not save of the force."""
    history, _, log = _ran(shared_tmp, "method.contact=lumped", f"method.events={events}")
    assert _closings(history) > 15 and _force(history).std() > 1.0
    assert _energy(history)[-1] == pytest.approx(energy, abs=2e-3)
    assert log.count("contact opened and closed") == 1 and "steps on face" in log


def test_the_block_flies_on_at_its_speed(shared_tmp):
    """Where nothing acts, nothing changes: walls follow the rock, and their accelerations do not grow from step to step."""
    probes = 'probe=[{name = "bar", at = [0.0125, 0.0125]}, {name = "face", at = [0, 0], on = "face"}]'
    flight = ("initial.rock.bar={velocity = [0.5, 0]}", "stage.impact.end=30", "stage.impact.time_step=0.25", probes)
    history, _, _ = _ran(shared_tmp, *flight)
    assert history["probe/bar/velocity"][:, 0] == pytest.approx(0.5, abs=1e-9)
    assert history["probe/face/opening"] == pytest.approx(0.5 * history["time"], abs=1e-9)
    assert np.abs(history["probe/bar/acceleration"]).max() < 1e-9
