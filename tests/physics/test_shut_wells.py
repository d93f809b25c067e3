"""Wells with limits are valves: where the pressure around is beyond a limit they are shut, and fluid never flows back."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from fracflow.advance.wells import one_changed
from fracflow.api import open as opened
from fracflow.model.loads import Limit
from fracflow.output.checkpoint import read_notes
from fracflow.output.history import shut_line, shut_times
from fracflow.run_report.page import write_report
from fracflow.scene.advice import advice
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

from .test_along_fractures import RIGID

WIDE = RIGID.replace('{along = [0, 3], value = ["1 mm", "0.25 mm"]}', '"10 mm"').replace("steady", "quasi-static")
CLOSED = (
    WIDE.replace("viscosity = 1e-3", "viscosity = 1e-5\ncompressibility = 1e-6").replace("steps = 2", "steps = 20")
    + """
[[well]]
name = "relief"
at = {fracture = "slot", end = "start"}
flow_rate = 1e-3
maximum_pressure = 1e5
[[well]]
name = "other"
at = {fracture = "slot", end = "end"}
flow_rate = {time = [0, 6, 16], value = [5e-4, -6e-4, -2e-3], interpolation = "step"}
"""
)
ROOM, SOFT, LIMIT = 0.03, 1e-6, 1e5  # volume of the slot per depth [m^2], compressibility [1/Pa], of the relief [Pa]
ASKED = np.repeat([5e-4, -6e-4, -2e-3], [6, 10, 4])  # of the other well in each step


def limited(asked, sign=1.0):
    """Volumes (21,) in the closed slot and rates (20,) of its relief well, step by step: what there is room for, or nothing."""
    full, volumes, rates = ROOM * np.expm1(sign * SOFT * LIMIT), [0.0], []
    for other in asked:
        rates.append(sign * np.clip(sign * (full - volumes[-1] - other), 0.0, 1e-3))
        volumes.append(volumes[-1] + rates[-1] + other)
    return np.array(volumes), np.array(rates)


@pytest.mark.parametrize("rule", ["backward-euler", "bdf2"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_closed_fracture_with_two_wells(run_scene, rule, sign):
    """d_0 L (exp(c p) - 1) = integral of q_1 + q_2: full to the limit, beyond it by the other well alone, down, and on."""
    given = ["well.relief.minimum_pressure=-1e5", "well.relief.maximum_pressure=9e9", "well.relief.flow_rate=-1e-3"]
    given += [f"well.other.flow_rate={{time = [0, 6, 16], value = {[-5e-4, 6e-4, 2e-3]}, interpolation = 'step'}}"]
    given = [f"method.flow_integrator={rule}", *(given if sign < 0 else [])]
    found = run_scene(CLOSED, *given)
    of = found.history
    volumes, rates = limited(sign * ASKED, sign)
    assert of["well/relief/rate"][1:] == pytest.approx(rates, rel=1e-4, abs=1e-15)
    assert of["well/relief/pressure"] == pytest.approx(np.log1p(volumes / ROOM) / SOFT, abs=1e-5 * LIMIT)
    assert np.all(of["well/relief/rate"][of["well/relief/limit"] == 2] == 0.0)
    assert {*of["well/relief/limit"][1:].tolist()} == {0, 1, 2} and "well/other/limit" not in of
    assert np.abs(of["volume/unaccounted"]).max() <= 1e-9 * of["volume/injected"][-1] and found.closes()
    assert shut_times(of, "relief") == [(2.0, 9.0)]


IN_LINE = (
    RIGID.replace('{along = [0, 3], value = ["1 mm", "0.25 mm"]}', '"1 mm"').replace("steps = 2", "steps = 8")
    + """
[[well]]
name = "far"
at = {fracture = "slot", end = "start"}
flow_rate = {time = [0, 1, 2, 3, 4, 5, 6, 7], value = [1e-3, 1e-3, 2e-3, 2e-3, 2e-3, 1e-3, -1e-3, 2e-3], interpolation = "step"}
maximum_pressure = 4e4
[[well]]
name = "near"
at = [1.5, 1]
flow_rate = {time = [0, 1, 2, 3, 4, 5, 6, 7], value = [0, 5e-4, 1e-3, 3e-3, 4e-3, 9e-3, 9e-3, -2e-3], interpolation = "step"}
maximum_pressure = 6e4
[[well]]
name = "out"
at = {fracture = "slot", end = "end"}
pressure = 0
"""
)
HALF = 12 * 1e-3 * 1.5 / 1e-9  # 12 mu L / d^3 of either half


def by_hand(asked, limits):
    """Rates (2,) of two wells in line by trying each pair of states: its own rate, at its limit, or shut."""
    resists, found = HALF * np.array([[2.0, 1.0], [1.0, 1.0]]), []
    for states in product((0, 1, 2), repeat=2):
        kept = np.array(states) == 1
        rates = np.where(np.array(states) == 2, np.minimum(asked, 0.0), asked)
        rates[kept] = np.linalg.lstsq(
            resists[np.ix_(kept, kept)], limits[kept] - resists[np.ix_(kept, ~kept)] @ rates[~kept], rcond=None
        )[0]
        pressure, close = resists @ rates, 1e-9 * limits
        low, high = np.minimum(asked, 0.0) - 1e-15, asked + 1e-15
        below, between = (pressure <= limits + close) | (asked <= 0.0), (low <= rates) & (rates <= high)
        fits = (below, between, pressure >= limits)
        if all(fits[state][well] for well, state in enumerate(states)):
            found.append(rates)
    assert found and np.ptp(found, axis=0).max() <= 1e-15  # one solution
    return found[0]


def test_two_wells_with_limits_that_feed_each_other(run_scene):
    """Steady: what one pumps shuts the other, whichever comes first; one that draws knows no highest pressure."""
    found = run_scene(IN_LINE)
    far = [1e-3, 1e-3, 2e-3, 2e-3, 2e-3, 1e-3, -1e-3, 2e-3]
    near = [0, 5e-4, 1e-3, 3e-3, 4e-3, 9e-3, 9e-3, -2e-3]
    expected = np.array([by_hand(np.array(each), np.array([4e4, 6e4])) for each in zip(far, near, strict=True)])
    for name, rates in zip(("far", "near"), expected.T, strict=True):
        assert found.history[f"well/{name}/rate"][1:] == pytest.approx(rates, rel=1e-9, abs=1e-17)
    seen = np.stack([found.history[f"well/{name}/limit"][1:] for name in ("far", "near")], axis=1)
    assert len({*map(tuple, seen.tolist())}) >= 5 and found.closes()


def test_a_limit_moves_no_pressure_that_is_given_there(run_scene):
    """A well beside one with a prescribed pressure is shut while it would pump against a pressure beyond its limit."""
    kept = "{time = [0, 5, 7], value = [8e4, 3e4, 8e4], interpolation = 'step'}"
    found = run_scene(IN_LINE + f'[[well]]\nname = "kept"\nat = [1.5, 1]\npressure = {kept}\n').history
    asked = np.array([0, 5e-4, 1e-3, 3e-3, 4e-3, 9e-3, 9e-3, -2e-3])
    pressure = np.array([8e4, 8e4, 8e4, 8e4, 8e4, 3e4, 3e4, 8e4])
    is_shut = (asked > 0.0) & (pressure > 6e4)
    assert found["well/near/pressure"][1:] == pytest.approx(pressure)
    assert found["well/near/limit"][1:].tolist() == np.where(is_shut, 2, 0).tolist()
    assert found["well/near/rate"][1:] == pytest.approx(np.where(is_shut, 0.0, asked))


@pytest.mark.parametrize("compressible", [False, True])
def test_with_inertia_it_is_shut_from_the_first_instant(run_scene, compressible):
    """Its full rate at the first instant would count half in the first step of a trapezoid."""
    stage, far = "stage=[{kind='dynamic', time_step=1, steps=3}]", ["near", "far"]
    if compressible:
        found, far = run_scene(CLOSED, stage, "fluid.initial_pressure=2e5"), ["other", "relief"]
    else:
        found = run_scene(IN_LINE, stage, "well.far.flow_rate=1e-3", "well.near.flow_rate=9e-3")
        assert found.history["well/near/rate"][1:] == pytest.approx(6e4 / HALF, rel=1e-9)
        assert found.history["well/near/limit"][1:].tolist() == [1, 1, 1]
    assert not found.history[f"well/{far[1]}/rate"].any()
    assert found.history[f"well/{far[1]}/limit"][1:].tolist() == [2, 2, 2] and found.closes()


def test_a_shut_well_is_told_kept_and_taken_up_again(shared_tmp, comm):
    """In log, page and terminal; a run cut while it is shut goes on to the last bit."""
    scene = shared_tmp / "scene.toml"
    if comm.rank == 0:
        scene.write_text(CLOSED, encoding="utf-8")
    comm.barrier()
    given = load(scene, ["method.flow_integrator=bdf2", "output.checkpoint_every=1"])
    done = run(given, shared_tmp / "whole", comm)
    said = "time 3 s: well.relief is shut, since the pressure around it is above its maximum_pressure = 100 kPa"
    assert sum(line.startswith(said) for line in done.doubts) == 1

    def stop(step):
        if step.state.time > 5.5:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(given, shared_tmp / "cut", comm, progress=stop)
    comm.barrier()
    assert read_notes(shared_tmp / "cut" / "checkpoint.h5")["shut"] == ["relief"]
    comm.barrier()
    resume(shared_tmp / "cut", comm)
    comm.barrier()
    one, other = (opened(shared_tmp / name).history for name in ("whole", "cut"))
    assert all(np.array_equal(one[key], other[key], equal_nan=True) for key in one if not key.startswith("step/"))
    line = "well.relief was shut by a limit of its pressure from 2 to 9"
    assert shut_line(one, "relief", "{:g}".format) == line
    if comm.rank == 0:
        page, _ = write_report(shared_tmp / "whole")
        assert "well.relief was shut by a limit of its pressure from 2 s to 9 s" in page.read_text(encoding="utf-8")


def test_of_states_that_cycle_one_changes_at_a_time():
    """The first by its name, whichever way: from given to the limit, from there to shut, and back."""
    first, last = (Limit(name, 1.0, 1e5, node, np.zeros(0, dtype=int)) for node, name in enumerate(("a", "b")))
    none, shut = frozenset[Limit](), replace(first, is_shut=True)
    assert one_changed(none, frozenset([last, first])) == {first}
    assert one_changed(frozenset([first]), frozenset([last, shut])) == {shut}
    assert one_changed(frozenset([shut, last]), none) == {last} and one_changed(frozenset([last]), none) == none


def test_a_limit_below_the_pressure_at_the_start_is_told_before_a_run(shared_tmp, comm):
    scene = shared_tmp / "scene.toml"
    if comm.rank == 0:
        scene.write_text(CLOSED, encoding="utf-8")
    comm.barrier()
    for start, is_told in (("2e5", True), ("1e5", False)):
        lines = list(advice(load(scene, [f"fluid.initial_pressure={start}"])))
        said = [line for line in lines if "well.relief.maximum_pressure = 100000" in line]
        assert len(said) == is_told and all("is shut until the pressure around it falls" in line for line in said)
