"""coupling = "condensed": the same steps as of Newton's method on all unknowns, with the rock factored once."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.stage import run_stage
from fracflow.advance.step import Stepping, stepper_of
from fracflow.errors import InputError, NotConverged
from fracflow.integrators import STEPPERS
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run
from fracflow.solve.condensed import CondensedRock, spread
from fracflow.solve.condensed_cost import break_even, condensed_step, condensing_cost, fits, full_step
from fracflow.solve.jacobian import JoinedMatrix

JOINT = {"normal_stiffness": 100.0, "shear_stiffness": 50.0, "aperture": 0.02, "friction_coefficient": 0.5}
STEEP = {"name": "steep", "points": [[0.9, 0.0], [2.1, 2.0]]}
FLAT = {"name": "flat", "points": [[0.0, 1.1], [3.0, 0.9]]}
TIP = {"name": "tip", "points": [[0.4, 1.4], [0.8, 1.7]]}
PRESSED = {"xx": -0.4, "yy": -0.4, "xy": 0.17}
PUSH = {
    "on": ["north"],
    "traction": [{"time": [0.0, 0.3], "value": [0.0, 0.3]}, {"time": [0.0, 0.3], "value": [0.0, -0.2]}],
}
FLUID = {"viscosity": 1e-6, "specific_weight": 1.0}
WELLS = [
    {"name": "in", "at": {"fracture": "flat", "end": "start"}, "flow_rate": 0.02},
    {"name": "out", "at": {"fracture": "flat", "end": "end"}, "pressure": 0.0},
]
HELD = {"support": [{"on": ["south", "west", "east"]}]}
STEADY = {"kind": "steady", "time_step": 0.05, "steps": 4}
GEOMETRY = {"domain": [0, 0, 3, 2], "fracture": [STEEP, FLAT, TIP], "size": 0.2, "cells": "triangles"}
CONNECTED = {**GEOMETRY, "fracture": [STEEP, FLAT]}
FULL = {"events", "undrained"}  # parts of steps are of any length; the fluid in the tip has no balance
AT_ENDS = {"events": "at-step-ends"}
MOVES = {"kind": "dynamic", "time_step": 0.05, "steps": 12}
CASES = {
    "dry": {"method": AT_ENDS},
    "events": {"stage": [{**MOVES, "steps": 2}]},
    "hht": {"method": {**AT_ENDS, "stepper": "hht"}},
    "absorbing": {"method": AT_ENDS, "support": [], "absorbing": [{"on": ["south", "west", "east"]}]},
    "tied": {"method": AT_ENDS, "tie": [{"on": ["north"], "components": ["x"]}]},
    "gauss": {"method": {**AT_ENDS, "quadrature": "gauss2"}},
    "film": {
        "method": {**AT_ENDS, "contact": "lumped"}, "fluid": FLUID, "well": WELLS, "stage": [{**MOVES, "steps": 9}],
    },
    "compressible": {
        "method": {**AT_ENDS, "contact": "lumped"}, "fluid": {**FLUID, "compressibility": 0.5}, "well": WELLS[:1],
    },
    "quasi-static": {
        "stage": [{"kind": "quasi-static", "time_step": 0.05, "steps": 6}], "method": {"flow_integrator": "bdf2"},
        "fluid": FLUID, "well": WELLS, **HELD,
    },
    "steady": {"stage": [STEADY], "fluid": FLUID, "well": WELLS, "geometry": CONNECTED, **HELD},
    "undrained": {"stage": [STEADY], "fluid": FLUID, "well": WELLS, **HELD},
    "static": {"stage": [STEADY], **HELD},
}  # fmt: skip


def _scene(coupling="monolithic", **more):
    data = {
        "units": "none",
        "geometry": GEOMETRY,
        "rock": {"rock": {"youngs_modulus": 10.0, "poissons_ratio": 0.25, "density": 1.0}},
        "fracture": {"default": JOINT},
        "initial_stress": PRESSED,
        "support": [{"on": ["south"]}],
        "load": [PUSH],
        "stage": [MOVES],
        **more,
    }
    data["method"] = {**data.get("method", {}), "coupling": coupling}
    return Scene.from_data(data)


def _run(model, scene):
    """States and reports of the first stage."""
    stepping = Stepping(replace(model, scene=scene))
    stage = scene.stage[0]
    state = stepping.enter(equilibrium_state(model), stepper_of(scene, stage), stage.time_step)
    steps = list(run_stage(stepping, state, 0, lambda line: None, {}))
    stepping.destroy()
    return steps


@pytest.mark.parametrize("case", CASES)
def test_agrees_with_newton_on_all_unknowns(case):
    scene = _scene(**CASES[case])
    model, comm = prepare(scene, MPI.COMM_WORLD), MPI.COMM_WORLD
    reference = _run(model, scene)
    found = _run(model, _scene("condensed", **CASES[case]))
    assert len(found) == len(reference)
    largest = {key: max(_vectors(step.state)[key].norm(3) for step in reference) for key in ("u", "v", "p")}
    for mine, theirs in zip(found, reference, strict=True):
        assert mine.state.time == pytest.approx(theirs.state.time, rel=1e-10)
        for key, vector in _vectors(mine.state).items():
            apart = np.abs(vector.getArray() - _vectors(theirs.state)[key].getArray()).max(initial=0.0)
            assert comm.allreduce(apart, op=MPI.MAX) <= (1e-9 if key == "v" else 1e-10) * largest[key], key
        assert np.array_equal(mine.state.sections.is_sliding, theirs.state.sections.is_sliding)
    slides = any(step.state.sections.is_sliding.any() for step in reference)
    assert comm.allreduce(slides, op=MPI.LOR), "the scene slips"
    if case not in FULL:
        assert sum(step.report.factorisations for step in found) == 1
        most = 2 if "fluid" in CASES[case] else 1  # another where little runs beside what full pressure would drive
        assert max(step.report.cycles for step in found) <= most


@pytest.mark.parametrize("case", ["compressible", "gauss"])
def test_all_ranks_solve_for_the_sections_as_rank_0_does(case, monkeypatch):
    """Of several ranks each has the rows of its own sections; one rank takes no other way."""
    scene = _scene("condensed", **CASES[case])
    model, comm = prepare(scene, MPI.COMM_WORLD), MPI.COMM_WORLD
    made, runs = [], []
    monkeypatch.setattr(
        spread.DenseSystem, "_rows", lambda *given, of=spread.DenseSystem._rows: made.append(1) or of(*given)
    )
    for fewest in (10**9, 0):
        monkeypatch.setattr(spread, "FEWEST", fewest)
        runs.append(_run(model, scene))
        assert bool(made) == (fewest == 0 and comm.size > 1)
    for mine, theirs in zip(*runs, strict=True):
        for key, vector in _vectors(mine.state).items():
            apart = vector - _vectors(theirs.state)[key]
            assert apart.norm(3) <= 1e-12 * _vectors(theirs.state)[key].norm(3), key
        assert mine.report.newton == theirs.report.newton
        assert np.array_equal(mine.state.sections.is_sliding, theirs.state.sections.is_sliding)


def _vectors(state):
    return {"u": state.motion.displacement, "v": state.motion.velocity, "p": state.pressure}


@pytest.mark.serial
def test_compliance_is_that_of_the_inverse():
    """G (4 M/dt^2 + K_s + G' W D G)^-1 G' by dense algebra, supports out."""
    scene, comm = _scene(geometry=CONNECTED), MPI.COMM_SELF
    model = prepare(scene, comm)
    ops, alphas = model.operators, STEPPERS["newmark"]().alphas(0.05)
    elastic = np.random.default_rng(1).uniform(1.0, 100.0, (len(ops.joints.weights), 2))[:, :, None] * np.eye(2)
    matrix = JoinedMatrix(ops, model.loads)
    rock = CondensedRock(matrix, model.loads, alphas, elastic)
    jump, stiff, mass = (
        each.convert("dense").getDenseArray().copy() for each in (ops.joints.jump, ops.stiffness, ops.mass)
    )
    springs = (ops.joints.weights[:, None] * np.diagonal(elastic, axis1=1, axis2=2)).ravel()
    whole = alphas.mass * mass + stiff + jump.T @ (springs[:, None] * jump)
    free = np.setdiff1d(np.arange(len(whole)), model.loads.held)
    wanted = jump[:, free] @ np.linalg.solve(whole[np.ix_(free, free)], jump[:, free].T)
    found = rock.compliance
    assert np.abs(found - wanted).max() <= 1e-12 * np.abs(wanted).max()
    rock.destroy()
    matrix.destroy()


def test_loose_block_is_named_as_without_condensing():
    """A push that the sliding fractures cannot stop."""
    loose = {"stage": [STEADY], "load": [{"on": ["north"], "traction": [0.5, 0.0]}], "accuracy": {"max_halvings": 0}}
    told = []
    for coupling in ("monolithic", "condensed"):
        scene = _scene(coupling, **loose)
        with pytest.raises(NotConverged, match="no equilibrium") as error:
            _run(prepare(scene, MPI.COMM_WORLD), scene)
        told.append(str(error.value).partition(":")[2][:40])
    assert told[0] == told[1]


def test_needs_are_told():
    with pytest.raises(InputError, match=r'method.overshoot.*contradicts coupling = "condensed".*"hold"'):
        _scene("condensed", method={"overshoot": "one-change"})
    with pytest.raises(InputError, match=r'method.storage.*needs "lumped"'):
        _scene("condensed", method={"storage": "consistent"}, fluid=FLUID, well=WELLS)


@pytest.mark.serial
@pytest.mark.parametrize(("unknowns", "jumps"), [(1_000, 40), (100_000, 800), (2_000_000, 4_000)])
def test_break_even_is_where_the_costs_meet(unknowns, jumps):
    for iterations in (1, 4):
        steps = break_even(unknowns, jumps, iterations)
        full, short = full_step(unknowns, iterations), condensed_step(unknowns, jumps, iterations)
        assert steps * full >= condensing_cost(unknowns, jumps) + steps * short
        assert (steps - 1) * full < condensing_cost(unknowns, jumps) + (steps - 1) * short
    assert fits(unknowns, jumps)
    assert break_even(unknowns, 100 * jumps) == np.inf and not fits(unknowns, 100 * jumps)


def test_the_log_says_what_is_condensed(shared_tmp):
    stages = [{**MOVES, "name": "shaking", "steps": 3}, {**STEADY, "name": "after", "steps": 2}]
    for coupling in ("condensed", "monolithic"):
        run(_scene(coupling, stage=stages, method=AT_ENDS, initial_stress={}, load=[], **HELD), shared_tmp / coupling)
    logs = {path.parent.name: path.read_text() for path in shared_tmp.glob("*/log.txt")}
    nodes, joints = re.search(r"(\d+) nodes, (\d+) joints", logs["condensed"]).groups()
    told = f"rock condensed to its joints, {2 * int(nodes)} displacements to {4 * int(joints)} jumps, which pays from"
    assert logs["condensed"].count(told) == 1 and ": stage shaking (3 steps), after (2 steps)\n" in logs["condensed"]
    assert "which pays from" not in logs["monolithic"]
