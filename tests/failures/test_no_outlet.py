"""F2b: two fractures, one without an outlet: named where more flows in than out, else its walls keep their volume."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError, SolveError
from fracflow.output import list_steps, read_history, read_step
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "no_outlet" / "scene.toml"
QUIET = "output.pictures=false"


def history(folder, *overrides):
    run(load(SCENE, [QUIET, *overrides]), folder)
    MPI.COMM_WORLD.barrier()
    return read_history(folder / "history.h5")


def volumes(folder):
    """Volume between the walls of the sealed fracture, at the start and at the end: sum of L (d_1 + d_2)/2."""
    found = []
    for _, path in (list_steps(folder, "fractures")[i] for i in (0, -1)):
        _, point, cell = read_step(path)
        sealed = cell["fracture"] == 1
        found.append(point["aperture"].reshape(-1, 2)[sealed].mean(axis=1))
    length = np.hypot(6, 3) / len(found[0])
    return found[0].sum() * length, found[1].sum() * length


def test_what_flows_in_flows_out_and_the_volume_stays(shared_tmp):
    """q = d^3 dp / (12 mu L) for openings far smaller than d; the level is settled by the volume of the walls."""
    found = history(shared_tmp / "run")
    drop = found["probe/in/pressure"][-1] - found["probe/out/pressure"][-1]
    assert drop == pytest.approx(12e-3 * np.hypot(6, 3) * 2e-5 / 1e-9, rel=2e-4)
    before, after = volumes(shared_tmp / "run")
    assert after == pytest.approx(before, rel=1e-13)
    mean = 0.5 * (found["probe/in/pressure"] + found["probe/out/pressure"])[-1]
    assert abs(mean - 1e6) < 0.01 * drop and mean != 1e6  # the volume, not the mean pressure, is kept
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest


def test_the_level_is_that_of_slow_storage(shared_tmp):
    """The end of quasi-static steps: after 3 s, of a thousand times 12 mu / (d^3 k_n kappa^2), nothing is left to settle."""
    steady = history(shared_tmp / "steady")
    slow = history(shared_tmp / "slow", "stage.0={kind='quasi-static', time_step=0.1, steps=30}")
    for key in ("probe/in/pressure", "probe/out/pressure"):
        assert steady[key][-1] == pytest.approx(slow[key][-1], rel=1e-11)


def test_it_does_not_matter_which_node_gives_way(shared_tmp, monkeypatch):
    from fracflow.advance import network

    first = history(shared_tmp / "first")
    whole = network.close

    def turned(operators, parts, part, *given):
        found, comm = whole(operators, parts, part, *given), operators.layout.comm
        last = comm.allreduce(int(part.nodes.max(initial=-1)), op=MPI.MAX)
        assert last != found.number
        return replace(
            found, number=last, row=(part.nodes - operators.layout.flow_starts[comm.rank])[part.nodes == last]
        )

    monkeypatch.setattr(network, "close", turned)
    last = history(shared_tmp / "last")
    for key in ("probe/in/pressure", "probe/out/pressure"):
        assert last[key] == pytest.approx(first[key], rel=1e-12)


def test_inflow_that_cannot_go_anywhere_is_named(shared_tmp):
    with pytest.raises(SolveError, match=r"flow rates of in, out add up to 5e-06 m\^3/s in sealed \(.* nodes around"):
        history(shared_tmp / "run", "well.in.flow_rate=2.5e-5")
    with pytest.raises(InputError, match=r"well.in: a steady stage pumps into sealed, which no .* drains"):
        history(shared_tmp / "run", "well.out.at=[2, 3]")


def test_rates_that_jump_as_a_step_ends_balance_as_they_are_before(shared_tmp):
    """The mean of both sides of the jump is 3e-5 where they balance, and 2e-5, which balances, where they do not."""
    stage = "stage.0={kind = 'steady', time_step = 1, steps = 1}"
    rate = "well.in.flow_rate={time = [0, 1], value = [VALUES], interpolation = 'step'}"
    constant = history(shared_tmp / "constant", stage)
    found = history(shared_tmp / "run", stage, rate.replace("VALUES", "2e-5, 4e-5"))
    assert found["probe/in/pressure"] == pytest.approx(constant["probe/in/pressure"], rel=1e-12)
    with pytest.raises(SolveError, match=r"flow rates of in, out add up to 1e-05 m\^3/s in sealed"):
        history(shared_tmp / "refused", stage, rate.replace("VALUES", "3e-5, 1e-5"))


@pytest.mark.parametrize("model", ["default", "report"])
def test_a_sealed_fracture_without_wells_keeps_its_volume(shared_tmp, model):
    """Squeezed from outside, its pressure answers as that of a sealed one must."""
    wells = ["well.in.at={fracture='drained', end='start'}", "well.out.at={fracture='drained', end='start'}"]
    lowered = "support.0.displacement_gradient=[[0, 0], [0, -1e-5]]"
    found = history(shared_tmp / "run", *wells, f"model={model}", lowered)
    before, after = volumes(shared_tmp / "run")
    assert after == pytest.approx(before, rel=1e-12)
    assert found["probe/in/pressure"][-1] == pytest.approx(found["probe/out/pressure"][-1], rel=1e-9)
    assert found["probe/in/pressure"][-1] > 1.05e6


def test_a_well_with_a_limit_takes_what_goes_in(shared_tmp):
    """Nothing, once the pressure is everywhere its highest; a lone one is no reason to refuse the scene either."""
    limit = "well.in.maximum_pressure='6 MPa'"
    for overrides in (["well.out.flow_rate=0"], ["well.out.at=[2, 3]"]):
        found = history(shared_tmp / overrides[0][9:11], limit, *overrides)
        assert found["probe/in/pressure"][-1] == pytest.approx(6e6, rel=1e-12)
        assert found["probe/out/pressure"][-1] == pytest.approx(6e6, rel=1e-9)
    with pytest.raises(SolveError, match=r"flow rates of in, out add up to -2e-05"):
        history(shared_tmp / "drawn", limit, "well.in.flow_rate=0")


def test_the_fixed_point_names_it_or_adds_storage(shared_tmp):
    """Plain cycles have no level for the sealed part; with added storage they find the monolithic solver's."""
    fixed = "method.coupling=fixed-point"
    with pytest.raises(SolveError, match=r"no pressure is prescribed in sealed \("):
        history(shared_tmp / "plain", fixed)
    one = history(shared_tmp / "one")
    other = history(shared_tmp / "other", fixed, "method.fixed_point=added-storage")
    for name in ("probe/in/pressure", "probe/out/pressure"):
        assert other[name] == pytest.approx(one[name], rel=1e-10)


def test_a_stage_with_inertia_begins_at_the_level_that_its_walls_settle(shared_tmp):
    """Neither arbitrary nor kept, which would ring from step to step: walls that start as the wells pump, w a = 0."""
    stage = "stage.0={kind = 'dynamic', time_step = 1e-9, steps = 5}"
    found = history(shared_tmp / "run", stage)
    inlet, outlet = (found[f"probe/{name}/pressure"][1:] for name in ("in", "out"))
    drop = 12e-3 * np.hypot(6, 3) * 2e-5 / 1e-9
    assert inlet - outlet == pytest.approx(np.full(5, drop), rel=1e-3)
    level = 0.5 * (inlet + outlet)
    assert np.ptp(level) <= 1e-5 * drop and abs(level[0] - 1e6) <= 0.05 * drop
    log = (shared_tmp / "run" / "log.txt").read_text()
    assert "no pressure is prescribed in" in log and "settled by its walls" in log
    with pytest.raises(SolveError, match=r"in, out add up to 2e-05 .*from the first instant in sealed"):
        history(shared_tmp / "refused", stage, "well.out.flow_rate=0")
    # nor is it taken up because something moves
    moving = "initial.velocity=[1e-3, 0]"
    with pytest.raises(
        SolveError, match=r"in, out add up to 2e-05 .*in sealed.*, and its walls, as they move, take up"
    ):
        history(shared_tmp / "moving", stage, "well.out.flow_rate=0", moving)


def test_what_begins_to_flow_in_sets_the_first_level(shared_tmp):
    """A well whose rate grows from nothing pushes walls that have mass: w a = Q', without ringing."""
    stage = "stage.0={kind = 'dynamic', time_step = 1e-7, steps = 6}"
    wells = ["well.in.flow_rate=[[0, 0], [1, 2]]", "well.out.flow_rate=0"]
    found = history(shared_tmp / "run", stage, *wells)
    level = 0.5 * (found["probe/in/pressure"] + found["probe/out/pressure"])[1:] - 1e6
    assert level[0] > 100.0 and np.abs(np.diff(level, 2)).max() <= 1e-4 * level[0]  # it goes up evenly


BENT = "well.in.flow_rate=[[0, 0], [{bend}e-7, 8e-7], [1, 8e-7]]"
UNDAMPED = {
    "newmark": ["method.stepper=newmark"],
    "generalised-alpha": ["method.stepper=generalised-alpha", "method.rho_infinity=1"],
}


@pytest.mark.parametrize(("stepper", "bend"), [("newmark", 4), ("generalised-alpha", 3.7)])
def test_the_level_follows_what_flows_in_where_its_rate_bends(shared_tmp, stepper, bend):
    """w a = Q' falls to nothing at once: the level does, and rests. That a stage ends there has no part in it."""
    given = [BENT.format(bend=bend), "well.out.flow_rate=0", *UNDAMPED[stepper]]
    stage = "{kind = 'dynamic', time_step = 1e-7, steps = %d}"
    found = history(shared_tmp / "run", *given, f"stage=[{stage % 10}]")
    level = 0.5 * (found["probe/in/pressure"] + found["probe/out/pressure"]) - 1e6
    assert level[1] > 100.0 and np.abs(np.diff(level[6:], 2)).max() <= 1e-3 * level[1]
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
    if bend == 4:
        split = history(shared_tmp / "split", *given, f"stage=[{stage % 4}, {stage % 6}]")
        for key in ("probe/in/pressure", "probe/out/pressure"):
            assert split[key] == pytest.approx(found[key], rel=1e-10)


MOUTH = [
    "geometry={domain = [[0, 0], [12, 0], [12, 6], [12, 12], [0, 12], [0, 6]], size = 3, size_at_fractures = 1.5, fracture ="
    " [{name = 'drained', points = [[2, 3], [10, 3]]}, {name = 'sealed', points = [[0, 6], [12, 6]]}]}",
    "support=[{on = ['side1', 'side2', 'side6']}, {on = ['side3', 'side4', 'side5'], displacement = {x = 0, y ="
    " [[0, 0], [2e-7, 0], [6e-7, 8e-13], [1, 8e-13]]}}]",
    "well.in.flow_rate=0",
    "well.out.flow_rate=0",
    "stage.0={kind = 'dynamic', time_step = 1e-7, steps = 9}",
]


def test_the_level_follows_walls_that_are_held_and_set_moving(shared_tmp):
    """The mouth of a sealed fracture parts and stops: free walls are pushed once, and back once, by whatever rule."""
    levels = []
    for stepper in ("newmark", "hht"):
        found = history(shared_tmp / stepper, *MOUTH, f"method.stepper={stepper}")
        levels.append(0.5 * (found["probe/in/pressure"] + found["probe/out/pressure"]) - 1e6)
        largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
        assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
    size = np.abs(levels[0]).max()
    assert levels[0][2:4].mean() < -0.9 * size and levels[0][6:8].mean() > 0.9 * size > 900.0
    assert levels[0] == pytest.approx(levels[1], abs=1e-4 * size) and np.abs(levels[0][8:]).max() <= 1e-3 * size


@pytest.mark.parametrize("stepper", UNDAMPED)
def test_the_level_is_at_rest_as_a_well_leaves_its_limit(shared_tmp, stepper):
    """Walls that a well at its limit sped up go on as the well pumps: the level falls in a step, no lower, and rests."""
    given = [BENT.format(bend=4), "well.out.flow_rate=0", "well.in.maximum_pressure='1000120 Pa'", *UNDAMPED[stepper]]
    found = history(shared_tmp / "run", *given, "stage.0={kind = 'dynamic', time_step = 1e-7, steps = 10}")
    pressure = found["probe/in/pressure"] - 1e6
    assert pressure[1:6] == pytest.approx(np.full(5, 120.0)) and 21.0 < pressure[6] < 30.0  # it went to -75
    assert np.abs(np.diff(pressure[7:], 2)).max() <= 0.03 * np.abs(pressure[7:] - 120.0).min()
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
