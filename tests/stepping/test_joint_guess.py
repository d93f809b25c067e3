"""Joints of explicit steps: the compiled guess has the balance and the statuses that the laws alone find."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.laws import HyperbolicCoulomb, LawStep, Linear, SlipWeakening, compiled
from fracflow.model.joints import Joints, LawGroup
from fracflow.solve.clusters import Batch, Clusters, Exchange
from fracflow.solve.leapfrog.compiled import library
from fracflow.solve.leapfrog.guess import joint_guess
from fracflow.solve.leapfrog.in_a_row import StepsInARow
from fracflow.solve.leapfrog.joints import JointSolver

pytestmark = [pytest.mark.serial, pytest.mark.skipif(library() is None, reason="loops are not compiled here")]
STEPS, PAIRS, STIFF = 100, 12, 1e10
COUNT = 3 * 3 * PAIRS  # three laws, by sections alone and in pairs


def joints_of(rng):
    """Sections of three laws in turn, each with parameters of its own; one in four has a cohesion, one never fails."""
    groups, count = [], COUNT // 3
    for k, law in enumerate((Linear, HyperbolicCoulomb, SlipWeakening)):
        given = {
            "normal_stiffness": STIFF * rng.uniform(0.5, 2.0, count),
            "shear_stiffness": STIFF * rng.uniform(0.5, 2.0, count),
            "initial_normal_traction": -1e6 * rng.uniform(0.5, 1.0, count),
            "initial_shear_traction": 1e5 * rng.uniform(-1.0, 1.0, (count, 1)),
        }
        if k:
            given |= {"aperture": 1e-3, "friction_coefficient": rng.uniform(0.3, 0.8, count)}
            given["cohesion"] = np.where(np.arange(count) % 4, 0.0, 1e5)
            given["cohesion"][0] = np.inf
        if k == 1:
            given |= {"stick_slip_ratio": rng.choice([0.9, 1.0], count), "strength_when_open": False}
        if k == 2:
            given |= {"dynamic_friction_coefficient": 0.2, "slip_weakening_distance": 2e-4, "strength_when_open": True}
        groups.append(LawGroup(np.arange(k, COUNT, 3), law(**given)))
    empty = SimpleNamespace()
    return Joints(2, empty, empty, rng.uniform(0.5, 1.0, COUNT), np.zeros((COUNT, 2)), (), tuple(groups), np.zeros(1))


def clusters_of(rng):
    """A third of the sections alone, the others two at a node, of any laws and directions; nodes are light or heavy."""

    def batch(rows):
        members, angle = rows.shape[1], rng.uniform(0.0, np.pi, rows.shape)
        turned = np.moveaxis(
            np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), (0, 1), (2, 3)
        )
        shared = np.einsum("cmik,cnjk->cminj", turned, turned) * (0.5 + 0.5 * np.eye(members))[:, None, :, None]
        matrix = shared.reshape(len(rows), 2 * members, 2 * members)
        return Batch(rows, matrix * 10.0 ** rng.uniform(-1.0, 0.0, (len(rows), 1, 1)) / STIFF)

    order = rng.permutation(COUNT)
    exchange = Exchange(MPI.COMM_SELF, np.arange(COUNT), np.array([COUNT]), np.array([COUNT]))
    alone = COUNT // 3
    return Clusters(exchange, (batch(order[:alone, None]), batch(order[alone:].reshape(-1, 2))))


def test_guess_is_what_the_laws_find():
    """In a random walk that opens and closes sections and drives them to and fro, section by section."""
    rng, comm = np.random.default_rng(3), MPI.COMM_SELF
    joints, clusters = joints_of(rng), clusters_of(rng)
    operators = SimpleNamespace(joints=joints, layout=SimpleNamespace(comm=comm), blocks=None)
    solver, plain = (JointSolver(operators, clusters, 30) for _ in range(2))
    plain.guess = None
    sections = joints.evaluate(np.zeros((COUNT, 2)), joints.initial_history())
    confirmed, seen = [], np.zeros((4, COUNT), dtype=bool)
    for number in range(STEPS):
        free = np.sin(0.1 * number + np.arange(COUNT))[:, None] * [4e-5, 2e-5] + 1e-5 * rng.normal(size=(COUNT, 2))
        step = LawStep(0.1 * number, 0.1, True)
        found, wanted = solver.solve(sections, free, 1.0, step), plain.solve(sections, free, 1.0, step)
        guessed = solver.guess.solve(sections, free, 1.0)
        confirmed.append(np.array_equal(found.sections.strain, sections.strain + guessed.change))
        moved = np.abs(wanted.sections.strain - sections.strain).max()
        assert np.abs(found.sections.strain - wanted.sections.strain).max() < 1e-12 * moved
        for one, other in zip(found.sections.history, wanted.sections.history, strict=True):
            assert all(np.array_equal(one[name], other[name]) for name in one if name == "sliding")
        sections = wanted.sections
        is_sliding, is_open = sections.is_sliding, sections.is_open
        seen |= np.array([is_sliding, is_open, ~is_sliding & ~is_open, seen[0] & ~is_sliding])
    assert np.mean(confirmed) == 1.0
    assert (seen[:, joints.laws[1].sections].sum(axis=1) > 5).all() and (
        seen[:, joints.laws[2].sections].sum(axis=1) > 5
    ).all()


@pytest.mark.parametrize("number", [1, 2], ids=["coulomb", "weakening"])
@pytest.mark.parametrize("coupled", [True, False])
def test_the_answer_of_one_law_is_its_own(number, coupled):
    """To the bit, where all sections follow it, and however they move; sections of a straight fault among them, or nearly so.

    Newton's method takes as few iterations as with the law itself.
    """
    rng = np.random.default_rng(4 + number)
    group = joints_of(rng).laws[number]
    count = len(group.sections)
    law = replace(group.law, coupled_tangent=coupled)
    empty = SimpleNamespace()
    joints = Joints(
        2, empty, empty, np.ones(count), np.zeros((count, 2)), (), (LawGroup(np.arange(count), law),), np.zeros(1)
    )
    rows, shared = np.arange(count).reshape(-1, 2), rng.uniform(0.1, 1.0, (count // 2, 1, 1)) / STIFF
    turned = np.tile(np.eye(2) + 0.1 * (1.0 - np.eye(2)), (2, 2)) * shared  # both walls of one node
    near = turned * (1.0 + 1e-7 * np.kron(np.eye(2), np.ones((2, 2))))
    third, whole = count // 6, turned + np.eye(4) * shared * rng.integers(0, 2, (count // 2, 1, 1))
    kinds = zip(np.split(rows, (third, 2 * third)), (turned, near, whole), (0, third, 2 * third), strict=True)
    batches = tuple(Batch(each, matrix[first : first + len(each)]) for each, matrix, first in kinds)
    stays = Exchange(MPI.COMM_SELF, np.arange(count), np.array([count]), np.array([count]))
    operators = SimpleNamespace(joints=joints, layout=SimpleNamespace(comm=MPI.COMM_SELF), blocks=None)
    solver, plain = (JointSolver(operators, Clusters(stays, batches), 30) for _ in range(2))
    plain.guess = None
    sections = joints.evaluate(np.zeros((count, 2)), joints.initial_history())
    slid, iterations = 0, np.zeros(2)
    for step in range(STEPS):
        free = np.sin(0.1 * step + np.arange(count))[:, None] * [4e-5, 2e-5] + 1e-5 * rng.normal(size=(count, 2))
        trial, time = solver.guess.solve(sections, free, 1.0), LawStep(0.1 * step, 0.1, True)
        judged, solved = joints.evaluate(trial.strain, trial.status, time), plain.solve(sections, free, 1.0, time)
        wanted = solved.sections
        assert trial.iterations > 0 and trial.answer is not None
        iterations += [trial.iterations, solved.iterations]
        for name in ("traction", "tangent", "inelastic", "strength", "utilisation", "margin", "is_sliding", "is_open"):
            assert np.array_equal(getattr(trial.answer, name), getattr(judged, name)), name
        assert np.allclose(trial.answer.stored, judged.stored, rtol=1e-14)
        assert all(np.array_equal(values, judged.history[0][name]) for name, values in trial.answer.history[0].items())
        assert np.abs(trial.strain - wanted.strain).max() < 1e-11 * np.abs(wanted.strain - sections.strain).max()
        sections, slid = wanted, slid + int(wanted.is_sliding.sum())
    assert slid > STEPS and iterations[0] < 1.05 * iterations[1]


@pytest.mark.parametrize(
    ("steepest", "bound"), [(0.0, np.inf), (0.4, 2e6), (0.8, 1.1e6), (0.95, -np.inf), (2.0, -np.inf)]
)
def test_loops_stop_before_a_section_may_jump(steepest, bound):
    """At a multiple of the present compression up to which no strength falls faster than shear stiffness unloads.

    steepest  fall of strength with slip over that stiffness, where compression is largest [1]
    """
    law = SlipWeakening(
        1e10,
        1e10,
        1e-3,
        friction_coefficient=0.5 + steepest,
        dynamic_friction_coefficient=0.5,
        slip_weakening_distance=1e-4,
    )
    joints = SimpleNamespace(laws=(SimpleNamespace(law=law),))
    loops = SimpleNamespace(_friction=law, nodes=SimpleNamespace(operators=SimpleNamespace(joints=joints)))
    tractions = np.array([[3e6, -5e5], [0.0, 2e6], [0.0, -1e6]])

    def bound_at(traction):
        return StepsInARow._most_pressed(loops, SimpleNamespace(traction=traction))

    assert bound_at(tractions) == pytest.approx(bound, rel=1e-15)
    assert bound_at(np.full((1, 2), np.nan)) == (-np.inf if steepest else np.inf)
    assert StepsInARow._most_pressed(SimpleNamespace(_friction=None), None) == np.inf  # without joints


def test_laws_without_a_copy():
    """Laws that inherit from those with one are others; so are joints in space."""
    rng = np.random.default_rng(3)
    joints, clusters = joints_of(rng), clusters_of(rng)
    layout = SimpleNamespace(comm=MPI.COMM_SELF)

    class Other(Linear):
        """Another law."""

    law = joints.laws[0].law
    other = Other(law.normal_stiffness, law.shear_stiffness)
    strange = replace(joints, laws=(LawGroup(joints.laws[0].sections, other), *joints.laws[1:]))
    for each in (strange, replace(joints, dim=3)):
        assert joint_guess(SimpleNamespace(joints=each, layout=layout), clusters, 30) is None


def test_columns_in_c_are_those_handed_to_it():
    """By their names, in the order of ``PARAMETERS`` behind the law's number and its section's weight."""
    given = {
        "normal_stiffness": "K_N", "shear_stiffness": "K_S", "aperture": "GAP", "initial_normal_traction": "F_N",
        "initial_shear_traction": "F_S", "cohesion": "COHESION", "friction_coefficient": "PEAK",
        "dynamic_friction_coefficient": "DYNAMIC", "slip_weakening_distance": "DISTANCE", "stick_slip_ratio": "RATIO",
        "strength_when_open": "OPEN_STRENGTH",
    }  # fmt: skip
    text = Path(compiled.__file__).with_name("friction.h").read_text(encoding="utf-8")
    columns = re.search(r"enum \{ (KIND.*?), LAW \};", text)
    assert columns and columns[1].split(", ") == ["KIND", "WEIGHT", *(given[name] for name in compiled.PARAMETERS)]


def test_the_guess_knows_the_round_off_of_joints_almost_closed():
    """There friction follows the closure so steeply that round-off of strains is most of what is left of the motion."""
    rng = np.random.default_rng(5)
    joints, clusters = joints_of(rng), clusters_of(rng)
    operators = SimpleNamespace(joints=joints, layout=SimpleNamespace(comm=MPI.COMM_SELF), blocks=None)
    solver = JointSolver(operators, clusters, 30)
    sections = joints.evaluate(np.zeros((COUNT, 2)), joints.initial_history())
    for _ in range(10):
        free = rng.uniform(0.5, 1.0, (COUNT, 2)) * [1.0, -1.0]  # a thousand apertures
        assert solver.guess.solve(sections, free, 1.0).iterations > 0
