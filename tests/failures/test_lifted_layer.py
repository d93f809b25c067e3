"""F6b: a layer of 3 m pulled off its joint, which 1 MPa presses; and blocks that slide, and that ties or supports hold."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve.floating import Floating, null_motions

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "lifted_layer" / "scene.toml"


def _failure(folder, *overrides):
    with pytest.raises(SolveError) as caught:
        run(load(SCENE, ["output.pictures=false", *overrides]), folder, MPI.COMM_WORLD)
    return str(caught.value)


def test_the_whole_step_names_block_direction_and_net_force(shared_tmp):
    """0.5 MPa too much on 3 m."""
    message = _failure(shared_tmp / "run", "accuracy.max_halvings=0")
    expected = r'time 1 s: block 1 \(rock "rock", centred at \(1\.5, 1\.5\)\) has no support in x, y, rotation'
    assert re.search(
        expected + r" \(all 12 joints open\): net force 1\.5e\+06 N/m in \+y; there is no equilibrium", message
    )


def test_halving_leads_to_the_last_equilibrium(shared_tmp):
    """The joint opens at time 2/3; a sixth half ends at 0.671875, where 1.5 t MPa is 7812.5 Pa too much."""
    message = _failure(shared_tmp / "run")
    force = float(re.search(r"net force (\S+) N/m in \+y", message)[1])
    assert force == pytest.approx(3 * (1.5e6 * 0.671875 - 1e6), rel=1e-3)
    if MPI.COMM_WORLD.rank == 0:
        assert read_history(shared_tmp / "run" / "history.h5")["time"][-1] == 0.65625


def test_a_layer_that_slides_is_named_too(shared_tmp):
    """tan(30 deg) of 1 MPa holds 577 kPa; the last digit of 1 m/s is a part in 64 of 600 kPa on 3 m."""
    message = _failure(shared_tmp / "run", "load.1.traction=[[[0, 0], [1, 6e5]], 0]")
    assert "has no support in x (all 12 joints slide)" in message
    force = float(re.search(r"net force (\S+) N/m in \+x", message)[1])
    time = float(re.search(r"time (\S+) s:", message)[1])
    assert force == pytest.approx(3 * (6e5 * time - np.tan(np.radians(30)) * 1e6), rel=1e-3)
    assert 0 < 6e5 * time - np.tan(np.radians(30)) * 1e6 < 6e5 / 64


@pytest.mark.parametrize("over", [1e-9, 1e-7])
@pytest.mark.parametrize("way", ["x", "y"])
def test_a_block_at_its_very_limit_is_named(way, over, shared_tmp):
    """A part in 1e9 more than friction, or the stress, holds: too little to see it fly, too much to balance."""
    holds = {"x": np.tan(np.radians(30)) * 1e6, "y": 1e6}[way]
    table = f"[[0, 0], [1, {holds * (1 + over)}]]"
    traction = {"x": f"[{table}, 0]", "y": f"[0, {table}]"}[way]
    message = _failure(shared_tmp / "run", f"load.1.traction={traction}", "accuracy.max_halvings=2")
    assert 'block 1 (rock "rock", centred at (1.5, 1.5))' in message
    if way == "x":  # all slide; a last section that opens and closes shares the other force
        force = float(re.search(r"has no support in x .* net force (\S+) N/m in \+x", message)[1])
        assert force == pytest.approx(3 * holds * over, rel=0.02)


@pytest.mark.serial
def test_null_motions_of_springs_in_a_row():
    """Three masses, two springs of very different stiffness: only the common motion is free."""
    one, other = np.array([1.0, -1.0, 0.0]), 1e-4 * np.array([0.0, 1.0, -1.0])
    motions = null_motions(np.outer(one, one) + np.outer(other, other))
    assert motions.shape == (3, 1)
    assert np.abs(motions - motions[0]).max() < 1e-6
    assert null_motions(np.eye(3)).shape == (3, 0)
    assert null_motions(np.zeros((3, 3))).shape == (3, 3)


@pytest.mark.serial
@pytest.mark.parametrize("chains", [0, 1, 2, 40])
def test_null_motions_of_many_blocks_stay_sparse(chains):
    """1000 masses in a row, 40 of them held but for the last ``chains`` pieces, of which each moves as one."""
    count, piece = 1000, 25
    springs = np.flatnonzero(np.arange(count - 1) % piece != piece - 1)
    ends = np.concatenate([springs, springs + 1])
    rows = np.tile(np.arange(len(springs)), 2)
    jumps = sparse.csr_matrix((np.repeat([1.0, -1.0], len(springs)), (rows, ends)), shape=(len(springs), count))
    held = np.arange(count) % piece == 0
    held[count - chains * piece :] = False
    motions = null_motions(jumps.T @ jumps + sparse.diags(held.astype(float)))
    assert motions.shape == (count, chains)
    expected = np.kron(np.eye(count // piece)[:, count // piece - chains :], np.full((piece, 1), piece**-0.5))
    assert np.abs(motions @ (motions.T @ expected) - expected).max(initial=0.0) <= 1e-9


def _motions(*overrides, carried):
    """Free motions of both layers where every section carries (along, across)."""
    model = prepare(load(SCENE, list(overrides)), MPI.COMM_WORLD)
    state = equilibrium_state(model)
    sections = state.sections
    sections.tangent[:] = sections.tangent * np.array(carried)[:, None]
    floating = Floating(model.operators, model.loads)
    return floating, floating.find(sections, is_filled=False)


@pytest.mark.parametrize(
    ("overrides", "carried", "free"),
    [
        ([], (1, 1), 0),
        ([], (0, 1), 1),  # slides along
        ([], (1, 0), 2),  # lifts off, and turns
        ([], (0, 0), 3),
        (["support.0.on=north"], (0, 0), 3),  # now the lower one
        (["support=[]"], (1, 1), 3),  # both as one
        (["support=[]"], (0, 0), 6),
        (["support.0.on=['south', 'north']"], (0, 0), 0),
        (["support=[{on = 'south'}, {on = 'north', components = ['x']}]"], (0, 0), 2),  # up, and about its top
        (
            ["tie=[{on = 'east', components = ['x']}]"],
            (0, 0),
            1,
        ),  # the nodes of both layers move alike in x, none turns
        (["tie=[{on = ['west', 'east'], components = ['y']}]"], (0, 0), 2),  # a layer that repeats itself does not turn
    ],
)
def test_what_floats(overrides, carried, free):
    _, motions = _motions(*overrides, carried=carried)
    assert motions.shape == (6, free)
    assert np.abs(motions.T @ motions - np.eye(free)).max(initial=0.0) < 1e-9


def test_a_layer_that_repeats_itself_shifts_and_does_not_turn():
    _, motions = _motions("tie=[{on = ['west', 'east'], components = ['y']}]", carried=(0, 0))
    assert np.abs(motions[[2, 5]]).max() < 1e-9


def test_the_net_force_on_a_block():
    """A force on every unknown of the upper layer adds up to its own resultant and moment."""
    floating, _ = _motions(carried=(1, 1))
    block, layout = floating.operators.blocks.solid, floating.operators.layout
    balance = layout.solid_vector()
    upper = (block.piece == 1)[: block.owned]
    start = block.unknown_starts[floating.operators.blocks.comm.rank]
    points, own = block.points[: block.owned][upper], block.unknown[: block.owned][upper] - start
    balance.getArray()[own[:, 0]] = 2.0
    balance.getArray()[own[:, 1]] = points[:, 0]
    x, y = points.T
    local = np.array([-2.0 * len(x), -x.sum(), (-x * (x - 1.5) + 2.0 * (y - 1.5)).sum()])
    expected = layout.comm.allreduce(local)
    force = floating.net_force(balance)
    assert force[0] == pytest.approx(0.0, abs=1e-9)
    assert force[1] * [1, 1, floating.frames.size[1]] == pytest.approx(expected, rel=1e-12)
    balance.destroy()
