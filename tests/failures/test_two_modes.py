"""F11, F12: a slip event with two modes is over when it has been quiet for one longest period; nothing of it is lost."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import run

SCENES = "meshes/failures/"
EARLY = ("stage.push.at_rest=0.1", "stage.push.end=430")
FOUND = []  # the run that two tests look at


def _ran(scene, folder, *overrides):
    run(load(f"{SCENES}{scene}/scene.toml", ["output.pictures=false", *overrides]), folder, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    return read_history(folder / "history.h5"), read_events(folder / "events.csv")


@pytest.fixture
def waited(shared_tmp):
    if not FOUND:
        FOUND.append(_ran("two_modes", shared_tmp / "waited", *EARLY))
    return FOUND[0]


@pytest.mark.serial
def test_is_the_event_that_inertia_all_along_makes(shared_tmp, waited):
    """Cut short by the energy of an instant it loses 11 %, in the catalogue's own model of it."""
    (event,) = [row for row in waited[1] if row["kind"] == "event"]
    history, _ = _ran("two_modes_dynamic", shared_tmp / "all")
    whole = np.ptp(history["probe/fault/plastic_slip"])
    assert event["slip"] == pytest.approx(whole, rel=1e-3)
    assert history["energy/dropped"][-1] == pytest.approx(0.0, abs=1e-6)
    assert event["dissipated"] == pytest.approx(history["energy/friction"][-1], rel=5e-3)
    damped = ("method.stepper=generalised-alpha", "method.rho_infinity=0.8")
    _, rows = _ran("two_modes", shared_tmp / "instant", *EARLY, *damped, "stage.push.rest_periods=0.02")
    (cut,) = [row for row in rows if row["kind"] == "event"]
    assert cut["slip"] < 0.9 * whole
    assert cut["unclosed"] <= 1e-10 and cut["dropped"] > 0.01 * cut["dissipated"]  # it says what was cut off


def test_drops_what_it_says_and_closes_its_books(waited):
    history, rows = waited
    (event,) = [row for row in rows if row["kind"] == "event"]
    assert event["unclosed"] <= 1e-6
    dropped, kinetic = history["energy/dropped"], history["energy/kinetic"]
    assert 0.0 < dropped[-1] <= 0.1 * kinetic.max()
    assert event["dropped"] == pytest.approx(dropped[-1], rel=1e-6)
    kinds = history["step/kind"]
    assert list(kinds[np.flatnonzero(np.diff(kinds, prepend=-1))]) == [1, 2, 1]  # without, with, without inertia


def test_an_event_goes_on_in_the_next_stage(shared_tmp, waited):
    """As if there were no other stage: it begins at 398.4, and the second stage at 403."""
    early = ["output.pictures=false", *EARLY]
    data = load(f"{SCENES}two_modes/scene.toml", early).model_dump(exclude_none=True)
    (push,) = [stage for stage in data["stage"] if stage.get("name") == "push"]
    later = [{**push, "name": "later"}] if push is data["stage"][-1] else []
    push["end"] = 403.0
    data["stage"] = [*data["stage"], *later]
    run(Scene.from_data(data, Path(f"{SCENES}two_modes/scene.toml")), shared_tmp / "split", MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    history, rows = read_history(shared_tmp / "split" / "history.h5"), read_events(shared_tmp / "split" / "events.csv")
    events = [[row for row in table if row["kind"] == "event"] for table in (rows, waited[1])]
    assert len(events[0]) == len(events[1]) == 1
    for key in ("start", "end", "slip", "dissipated"):
        assert events[0][0][key] == pytest.approx(events[1][0][key], rel=1e-3)
    assert history["energy/dropped"][-1] == pytest.approx(waited[0]["energy/dropped"][-1], rel=0.05)
