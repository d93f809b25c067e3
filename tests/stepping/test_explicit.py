"""Explicit steps on two masses: rock springs by central differences, joint and film at the end of the step."""

from dataclasses import dataclass

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.integrators.explicit import critical_step, joint_share, parts, predicted, velocity_after

pytestmark = pytest.mark.serial


@dataclass(frozen=True)
class Motion:
    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


MASS, ROCK = np.diag([1.0, 2.0]), np.array([[3.0, 0.0], [0.0, 5.0]])  # a spring from each mass to the ground
JUMP = np.array([[-1.0, 1.0]])
FASTEST = 3.0  # largest eigenvalue of M^-1 K_s: 3/1 and 5/2


def step(motion, pressure, dt, joint, conducts):
    """One step with a joint between the masses, and in it a fluid that leaves through a resistance: B' v + c p = 0."""
    share, inverse = joint_share(dt), np.linalg.inv(MASS)
    compliance = JUMP @ inverse @ JUMP.T
    free = JUMP @ predicted(motion, dt)
    before = joint * JUMP @ motion.displacement - pressure
    # e + S C (joint e + joint e_old - p - t_old) = free and 2/dt e + c p = - c p_old
    matrix = np.array([[1.0 + share * compliance[0, 0] * joint, -share * compliance[0, 0]], [2.0 / dt, conducts]])
    known = joint * JUMP @ motion.displacement - before
    right = np.array([(free - share * compliance @ known)[0], -conducts * pressure[0]])
    e, p = np.linalg.solve(matrix, right)
    pull = joint * (JUMP @ motion.displacement + e) - p
    moved = predicted(motion, dt) - share * inverse @ JUMP.T @ (pull - before)
    displacement = motion.displacement + moved
    acceleration = inverse @ (-ROCK @ displacement - JUMP.T @ pull)
    return Motion(displacement, velocity_after(motion, acceleration, dt), acceleration), np.array([p])


def amplification(dt, joint, conducts):
    """The step as a matrix on (u, v, p); accelerations follow from them."""
    columns = []
    for unit in np.eye(5):
        u, v, p = unit[:2], unit[2:4], unit[4:]
        a = np.linalg.inv(MASS) @ (-ROCK @ u - JUMP.T @ (joint * JUMP @ u - p))
        new, pressure = step(Motion(u, v, a), p, dt, joint, conducts)
        columns.append(np.concatenate([new.displacement, new.velocity, pressure]))
    return np.array(columns).T


@pytest.mark.parametrize("joint", [0.0, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("conducts", [1e-4, 1.0, 1e4])
def test_neither_joint_nor_film_limits_the_step(joint, conducts):
    dt = 0.999 * critical_step(FASTEST)
    assert np.abs(np.linalg.eigvals(amplification(dt, joint, conducts))).max() <= 1.0 + 1e-9


def test_the_rock_does():
    assert critical_step(FASTEST) == pytest.approx(2.0 / np.sqrt(3.0), rel=1e-15)
    assert np.abs(np.linalg.eigvals(amplification(1.01 * critical_step(FASTEST), 0.0, 1e9))).max() > 1.1
    assert critical_step(0.0) == np.inf


@pytest.mark.parametrize("joint", [0.0, 20.0])
def test_second_order_with_joint_and_film(joint):
    """Against the matrix exponential of the same equations, the pressure eliminated: p = -B' v/c."""
    conducts, end, start = 0.7, 1.3, np.array([1.0, -0.4, 0.3, 0.2])
    inverse = np.linalg.inv(MASS)
    stiff = inverse @ (ROCK + joint * JUMP.T @ JUMP)
    drag = inverse @ JUMP.T @ JUMP / conducts
    flow = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiff, -drag]])
    values, vectors = np.linalg.eig(flow)
    exact = (vectors @ (np.exp(values * end) * np.linalg.solve(vectors, start))).real
    errors = []
    for count in (20, 40, 80, 160):
        pressure = -JUMP @ start[2:] / conducts
        pull = joint * JUMP @ start[:2] - pressure
        motion = Motion(start[:2], start[2:], inverse @ (-ROCK @ start[:2] - JUMP.T @ pull))
        for _ in range(count):
            motion, pressure = step(motion, pressure, end / count, joint, conducts)
        errors.append(np.abs(np.concatenate([motion.displacement, motion.velocity]) - exact).max())
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.1)


def test_parts_are_no_longer_than_critical():
    assert parts(1.0, 1.0) == parts(1.0, np.inf) == parts(1.0, 1.0 - 1e-15) == 1
    assert parts(1.0, 0.9999) == 2
    assert parts(1.0, 0.25) == 4
    with pytest.raises(InputError, match="must be positive"):
        parts(0.0, 1.0)
