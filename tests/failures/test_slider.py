"""F5: the slip of a slider whose strength drops by d is d/k without inertia, and 2 d/k with it."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

DROP, SPRING, MASS = 0.4, 1.0, 1.0


def _ran(folder, *overrides):
    run(load("meshes/failures/slider/scene.toml", ["output.pictures=false", *overrides]), folder, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    return read_history(folder / "history.h5"), read_events(folder / "events.csv")


def test_slips_twice_as_far_as_at_rest_and_stops_where_its_speed_is_nil(shared_tmp):
    history, events = _ran(shared_tmp)
    (start,), (end,) = {event["start"] for event in events}, {event["end"] for event in events}
    time, moved, speed = (history[name] for name in ("time", "probe/block/displacement", "probe/block/velocity"))
    at = [np.flatnonzero(time == instant)[-1] for instant in (start, end)]
    assert moved[at[1], 0] - moved[at[0], 0] == pytest.approx(2 * DROP / SPRING, rel=1e-3)
    assert abs(speed[at[1], 0]) < 1e-3 * np.abs(speed[:, 0]).max()
    assert end - start == pytest.approx(np.pi * np.sqrt(MASS / SPRING), rel=0.01)  # half a swing, omega dt = 0.3
    largest = max(np.abs(history[f"energy/{name}"]).max() for name in ("kinetic", "friction", "work_boundaries"))
    assert np.abs(history["energy/residual"]).max() <= 1e-10 * largest


def test_slips_less_where_re_stick_waits_for_the_end_of_a_step(shared_tmp):
    """The gain by location: from the end of one step to that of another, some slip is missed."""
    history, _ = _ran(shared_tmp / "late", "method.events=at-step-ends")
    moved = history["probe/block/displacement"][:, 0]
    assert abs(np.ptp(moved[moved > 0.19]) - 2 * DROP / SPRING) > 1e-3 * 2 * DROP / SPRING


def test_without_inertia_it_goes_half_as_far(shared_tmp):
    history, _ = _ran(shared_tmp / "rest", "stage.slip.kind=quasi-static")
    moved, strength = history["probe/block/displacement"][:, 0], 2.0
    assert moved[-1] - strength / 10.0 == pytest.approx(DROP / SPRING, rel=1e-3)


@pytest.mark.parametrize("events", ["located", "at-step-ends"])
@pytest.mark.parametrize("share", [1.0 - 4e-16, 1.0 + 4e-16, 1.0 - 1e-9])
def test_a_block_at_rest_at_its_strength_fails_whichever_way_round_off_has_it(shared_tmp, events, share):
    """(2.12) |f_s| >= f_sy; with a share of 1e-9 less it stays."""
    shear = 2.0 * np.tan(np.radians(45.0)) * share
    tractions = (f"fracture.{name}.initial_shear_traction={shear}" for name in ("lower", "upper"))
    carried = ("initial_stress.unbalanced=carried", "initial_stress.xx=0", "initial_stress.yy=0")
    _, found = _ran(shared_tmp, f"method.events={events}", *tractions, *carried)
    if share < 1.0 - 1e-10:
        assert found == []
        return
    assert {event["start"] for event in found} == {0.0}
    largest = 2 * DROP / SPRING + DROP / 10.0  # with what the joint itself unloads by
    assert [event["slip"] for event in found] == pytest.approx([largest, largest], rel=1e-2)
