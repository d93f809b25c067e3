"""``scripts/figures plan`` in small: what the plan leaves out is within the tolerance of what a run with all in it tells."""

from pathlib import Path

import numpy as np
import pytest
from figures_plan.__main__ import MESHES, Entry, read, write
from figures_plan.scenes import scene
from figures_plan.twins import Ran, gaps, limit, twins
from figures_plan.wide import wide

from fracflow.scene.scene import Scene, load

pytestmark = pytest.mark.serial
NEAR = 2e-6  # instants are the same within 1e-6 of a step


@pytest.mark.parametrize("seed", [2, 3, 12])
def test_random_scenes(seed):
    found = twins(Scene.from_data(scene(seed), Path("random.toml")))
    assert not found.full.failure
    assert len(found.full.history["time"]) >= 20
    assert found.ratio <= 1.0, found.worst


def test_a_scene_of_meshes():
    short = ["output.pictures=false", "stage.1.steps=10"]
    found = twins(load(MESHES / "crossings" / "scene.toml", short), "method.coupling=condensed")
    assert not found.full.failure
    assert found.ratio <= 1.0, found.worst


def test_a_random_scene_in_wide_rock():
    """Without sides and mesh, in less time, and nearer to the limit of two meshes than the scene's own mesh is."""
    found = twins(Scene.from_data(wide(29, joints=32), Path("wide.toml")))
    assert not found.full.failure and found.full.has_cells and not found.reduced.has_cells
    assert found.coarse is not None and found.tolerance < found.coarse
    assert max(gap.error for gap in found.gaps.values()) < found.coarse
    assert found.reduced.seconds < found.full.seconds


def made(times, values, starts=(), slip=1.0):
    """A run with one probe, whose pressure begins at 10, and slips of 1 s each."""
    history = {"time": np.array(times, dtype=float), "probe/a/pressure": 10.0 + np.array(values, dtype=float)}
    of_all = {"kind": "slip", "fracture": "f", "node": 1, "slip": slip, "peak_slip_rate": 2.0}
    return Ran(history, [{**of_all, "start": float(start), "end": start + 1.0} for start in starts], 0.0, "")


def gap(one, other, name="probes", is_auto=False):
    return gaps(one, other, 1e-2, is_auto)[name].error


def test_gaps_are_shares_of_the_largest_change():
    """0.1 of a change of 2, though the pressure is 12; at records that both have, to neither side in time."""
    full = made([0, 1, 2, 3], [0, 1, 2, 2])
    assert gap(full, full) == 0.0
    assert gap(full, made([0, 1, 2, 3], [0, 1.1, 2, 2])) == pytest.approx(0.05, abs=NEAR)
    assert gap(made([0, 1, 2, 3], [0, 1.1, 2, 2]), full) == pytest.approx(0.05, abs=NEAR)
    assert gap(full, made([0, 1, 2, 3], [0, 0, 1, 2])) == pytest.approx(0.5, abs=NEAR)


def test_records_of_other_instants():
    """On the same line there is no gap; 2.5 where 1.5 is a step off; of a stage auto 1 % early."""
    full = made([0, 1, 2, 3], [0, 1, 2, 3])
    assert gap(full, made([0, 0.5, 1, 2.5, 3], [0, 0.5, 1, 2.5, 3])) == pytest.approx(0.0, abs=1e-12)
    assert gap(full, made([0, 0.5, 1, 3], [0, 2.5, 1, 3])) == pytest.approx(1 / 3)
    fine, shifted = (made(np.arange(0, 100.1, 0.1), np.arange(1001) >= first) for first in (500, 507))
    assert gap(fine, shifted) == pytest.approx(1.0)
    assert gap(fine, shifted, is_auto=True) == 0.0


def test_gaps_of_events():
    """By what is nearest of the same place, in steps of 0.1 of 10 s: a start 0.3 s later, a slip missing that lasted 1 s."""
    times = np.arange(101) / 10
    full = made(times, times, [2, 5])
    assert gap(full, made(times, times, [2, 5.3]), "events") == pytest.approx(0.02)
    assert gap(full, made(times, times, [2, 5.1]), "events") == pytest.approx(0.0, abs=1e-12)  # known to a step
    assert gap(full, made(times, times, [2]), "events") == pytest.approx(0.3 - 0.01)  # beside the one 3 s earlier
    short = {**full.events[0], "start": 8.0, "end": 8.1, "slip": 1e-3, "peak_slip_rate": 0.0}
    assert gap(full, full._replace(events=[*full.events, short]), "events") == pytest.approx(1e-3)


def test_the_limit_of_two_meshes_has_no_error_of_first_order():
    """Values 2 + 0.4 and 2 + 0.2; runs with other instants have no common limit, and the finer one decides."""
    own, fine = made([0, 1, 2], [0, 1.4, 2.4]), made([0, 1, 2], [0, 1.2, 2.2])
    assert limit(own, fine).history["probe/a/pressure"] == pytest.approx([10.0, 11.0, 12.0])
    other = made([0, 1, 1.5], [0, 1.2, 2.2])
    assert limit(own, other) is other


def test_rows_of_a_figure_in_parts_are_read_as_they_were_written(tmp_path):
    """Also where a run has no events, or one alone has failed."""
    rows = [
        Entry("wide 3", 4.0, 0.5, (1e-3, np.nan, 2e-4), 0.01, 0.1, "probe/a at 1", "", "a remark, of a mesh"),
        Entry("random 1", 2.0, 1.5, (np.nan, np.nan, np.nan), 0.01, np.inf, "reduced run failed: why", "why", ""),
    ]
    write(rows, tmp_path / "plan.csv")
    found = read(tmp_path / "plan.csv")
    assert repr(found) == repr(rows) and not found[1].both_failed
