"""Wells with limits of their pressure: they give or take what they can, and no more."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.scene.scene import load
from fracflow.simulation.run import run

from .test_along_fractures import RIGID
from .test_books import CRACK, QUASI

PUMPED = (
    RIGID.replace('{along = [0, 3], value = ["1 mm", "0.25 mm"]}', '"1 mm"').replace(
        "time_step = 1\nsteps = 2", "time_step = 1\nsteps = 6"
    )
    + """
[[well]]
name = "in"
at = {fracture = "slot", end = "start"}
flow_rate = [[0, 0], [3, 3e-3], [6, 0]]
maximum_pressure = 5e4
[[well]]
name = "out"
at = {fracture = "slot", end = "end"}
pressure = 0
"""
)
RESISTANCE = 12 * 1e-3 * 3 / 1e-9  # 12 mu L / d^3


@pytest.mark.parametrize("depth", [1, 7])
def test_a_well_takes_what_its_highest_pressure_lets_in(run_scene, depth):
    """q = min(asked, p_max / R), R = 12 mu L/d^3 over the depth: up to the limit, along it, and down again."""
    found = run_scene(PUMPED, f"fluid.flow_depth={depth}", f"well.in.flow_rate=[[0, 0], [3, {3e-3 * depth}], [6, 0]]")
    time = found.history["time"]
    asked = np.interp(time, [0, 3, 6], [0, 3e-3, 0])
    expected = np.minimum(asked, 5e4 / RESISTANCE)
    assert 5e4 / RESISTANCE < 2e-3  # some steps are at the limit, some are not
    assert np.sum(asked > expected) >= 2 and np.sum((asked > 0) & (asked <= expected)) >= 2
    assert found.probe("quarter", "flow_rate") == pytest.approx(depth * expected, rel=1e-9, abs=1e-17)
    assert found.closes()


@pytest.mark.parametrize("model", ["default", "report"])
def test_a_well_that_is_shut_in_leaves_the_network_at_rest(run_scene, model):
    """No flow, step after step: nothing but round-off is left to balance, and that is no reason to fail."""
    found = run_scene(
        PUMPED, "well.in.flow_rate=[[0, 0], [1, 3e-4], [2, 0], [12, 0]]", "stage.0.steps=12", f"model={model}"
    )
    flow = found.probe("quarter", "flow_rate")
    assert flow[1] == pytest.approx(3e-4, rel=1e-9)
    assert np.abs(flow[2:]).max() <= 1e-11 * flow[1]


def test_a_well_draws_no_lower_than_its_lowest_pressure(run_scene):
    """The mirror image: drawn down to -5e4 and held there."""
    found = run_scene(
        PUMPED,
        "well.in.flow_rate=[[0, 0], [3, -3e-3], [6, 0]]",
        "well.in.maximum_pressure=9e9",
        "well.in.minimum_pressure=-5e4",
    )
    asked = -np.interp(found.history["time"], [0, 3, 6], [0, 3e-3, 0])
    assert found.probe("quarter", "flow_rate") == pytest.approx(
        np.maximum(asked, -5e4 / RESISTANCE), rel=1e-9, abs=1e-18
    )


def test_limits_the_wrong_way_round_are_refused(run_scene):
    with pytest.raises(InputError, match=r"well.in.maximum_pressure = .* must be above minimum_pressure"):
        run_scene(PUMPED, "well.in.minimum_pressure=6e4")


@pytest.mark.parametrize(
    ("aperture", "rate", "key"), [("1e-9", "1e-9", "maximum"), ("1e-9", "-1e-9", "minimum"), ("1e-3", "1e-9", "")]
)
def test_a_rate_that_takes_more_pressure_than_rock_is_stiff_is_told(shared_tmp, aperture, rate, key):
    """1e-9 m^2/s through 1e-9 m: 12 mu q h / d^3 is 1e16 Pa over a metre."""
    file, folder = shared_tmp / "scene.toml", shared_tmp / "run"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(CRACK.replace("pressure = 2e6", f"flow_rate = {rate}") + QUASI, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    run(load(file, [f"fracture.default.aperture={aperture}", "stage.0.time_step=1e-6"]), folder)
    told = MPI.COMM_WORLD.bcast((folder / "log.txt").read_text() if MPI.COMM_WORLD.rank == 0 else "")
    assert told.count("later results are meaningless") == bool(key)
    assert told.count(f"later results are meaningless; give a {key}_pressure to well.in,") == bool(key)
