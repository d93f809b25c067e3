"""Dilation around every law of friction."""

import numpy as np
import pytest
from test_joint_law_contract import PATHS, SAMPLES, SECTIONS, latched

from fracflow._petsc import MPI
from fracflow.laws import JOINT_LAWS, JointLaw, LawStep, may_dilate
from fracflow.laws.dilation import Dilatant
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial

SLOPE, DISTANCE, DT = 0.3, 0.03, 1e4
FRICTION = sorted(name for name, law in JOINT_LAWS.items() if may_dilate(law))


def of(name, dim=2, slope=SLOPE):
    """The dilatant law of that name, its initial shear turned in three dimensions."""
    shear = np.tile([1.0, 0.0][: dim - 1], (SECTIONS, 1))
    sample = {**SAMPLES[name], "initial_shear_traction": shear}
    return Dilatant(JOINT_LAWS[name](**sample), slope, DISTANCE)


def ridden_up(slip):
    """The integral of the slope that falls linearly."""
    slip = np.minimum(slip, DISTANCE)
    return SLOPE * (slip - slip**2 / (2.0 * DISTANCE))


def test_every_method_of_a_law_is_that_of_the_friction():
    """An inherited one would answer for a law without friction."""
    methods = {name for name, value in vars(JointLaw).items() if callable(value) and not name.startswith("_")}
    assert methods - vars(Dilatant).keys() == set()


def test_a_law_may_creep_without_a_state(tmp_path, monkeypatch):
    """Steps ask a law for its rate of slip, and do not look it up in its history."""
    monkeypatch.setattr(JOINT_LAWS["hyperbolic-coulomb"], "creeps", True)
    folder, settings = tmp_path / "run", ["output.pictures=false", "stage.0.steps=2", "rock.rock.density=2700"]
    totals = run(load("meshes/r01_inclined_joint/scene.toml", settings), folder, MPI.COMM_SELF)
    assert totals.steps > 1 and not totals.doubts


def test_linear_joints_do_not_dilate():
    assert FRICTION == ["hyperbolic-coulomb", "rate-and-state", "slip-weakening"]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("course", PATHS)
@pytest.mark.parametrize("name", FRICTION)
def test_tangent_opening_and_response(name, course, dim):
    """The tangent is the derivative, u is that of the path in contact, and the rest is the friction of eps_n - u."""
    law, delta, checked, moved_on = of(name, dim), 1e-9, 0, 0
    past = law.initial_history(SECTIONS, dim)
    path, uneven = np.zeros(SECTIONS), 0
    for strain in PATHS[course](dim):
        strain = strain.copy()
        strain[:, -1] = np.maximum(
            strain[:, -1], past["dilation"] - 0.008
        )  # a step takes no wall further than contact allows
        step = LawStep(0.0, DT)
        before = {key: value.copy() for key, value in past.items()}
        response = law.evaluate(strain, past, step)
        assert all(np.array_equal(before[key], past[key]) for key in past)
        opening = response.inelastic[:, -1]
        held = LawStep(0.0, DT, hold=True)
        plain = law.law.evaluate(strain - opening[:, None] * np.eye(dim)[-1], latched(law, past, response), held)
        for key in ("traction", "stored"):
            assert np.allclose(getattr(plain, key), getattr(response, key), rtol=1e-12, atol=1e-13)
        slipped = np.linalg.norm(plain.inelastic[:, :-1] - past["plastic_slip"], axis=1)
        path += np.where(response.is_open, 0.0, slipped)
        assert np.allclose(opening, ridden_up(path), rtol=1e-12, atol=1e-16)
        moved_on += np.sum(opening > past["dilation"])
        here = latched(law, past, response)
        base = law.evaluate(strain, here, step)
        for j in range(dim):
            shift = delta * np.eye(dim)[j]
            ahead, behind = (law.evaluate(strain + sign * shift, here, step) for sign in (1.0, -1.0))
            difference = (ahead.traction - behind.traction) / (2 * delta)
            smooth = (base.margin > 1e-3) & (ahead.is_open == behind.is_open) & (base.history["ridden"] < DISTANCE)
            smooth &= (ahead.is_sliding == base.is_sliding) & (behind.is_sliding == base.is_sliding)
            smooth &= np.abs(strain[:, -1] - base.inelastic[:, -1]) > 2 * delta
            size = np.abs(base.tangent).max(axis=(1, 2), initial=1.0)[:, None]
            right = np.abs(difference - base.tangent[:, :, j]) <= 1e-5 * size
            uneven += np.sum(smooth[:, None] & ~right)
            checked += smooth.sum()
        past = response.history
    assert checked > 500 and moved_on > 100
    assert uneven == 0


@pytest.mark.parametrize("name", FRICTION)
def test_without_an_angle_every_bit_stays(name):
    law = of(name, slope=0.0)
    past, same = law.initial_history(SECTIONS, 2), law.law.initial_history(SECTIONS, 2)
    for strain in PATHS["course"](2):
        found, plain = law.evaluate(strain, past, LawStep(0.0, DT)), law.law.evaluate(strain, same, LawStep(0.0, DT))
        for key in ("traction", "tangent", "inelastic", "stored"):
            assert np.array_equal(getattr(found, key), getattr(plain, key))
        past, same = found.history, plain.history


@pytest.mark.parametrize("name", FRICTION)
def test_a_long_slip_at_once_does_not_crush_the_walls(name):
    """A trial far beyond what the closure can take: slip ends where the strength of the closing walls stops it."""
    law = of(name, slope=5.0)
    strain = np.zeros((SECTIONS, 2))
    strain[:, 0] = np.linspace(0.0, 1.0, SECTIONS)
    found = law.evaluate(strain, law.initial_history(SECTIONS, 2), LawStep(0.0, DT))
    assert np.isfinite(found.traction).all() and (found.inelastic[1:, -1] > 0.0).all()
    assert (strain[:, -1] - found.inelastic[:, -1] > -0.01).all()
    assert (np.diff(found.inelastic[:, -1]) >= 0.0).all()


@pytest.mark.parametrize("name", FRICTION)
def test_walls_that_ride_up_as_fast_as_they_move_apart_stay_in_contact(name):
    """Their normal traction falls to zero without a jump, where slip without strength lifts them; parted ones touch at u."""
    law, spacing = of(name), 0.011 / (SECTIONS - 1)
    strain, past = np.zeros((SECTIONS, 2)), law.initial_history(SECTIONS, 2)
    strain[:, 0], strain[:, 1] = 0.05, np.linspace(0.0, 0.011, SECTIONS)
    part, step = 4.0 / 2e3, LawStep(0.0, DT)  # the opening at which the closure has no traction, -f_n0/k_n0
    found = law.evaluate(strain, past, step)
    rides = strain[:, 1] < part + ridden_up(0.05)
    assert np.array_equal(found.is_open, ~rides) and (strain[rides, 1] > part).sum() > 10
    k_n = 2e3 / np.minimum(1.0 + (strain[:-1, 1] - ridden_up(0.05)) / 0.01, 1.0) ** 2
    assert np.all(np.diff(found.traction[:, 1]) <= 1.01 * k_n * spacing) and np.all(
        np.diff(found.traction[:, 1]) >= 0.0
    )
    contact = law.approach(strain, strain, past, step)[:, 1]
    assert not law.status or np.array_equal(contact < 0.0, rides)  # friction without a status has no events
    apart = law.evaluate(strain, {**past, "apart": np.ones(SECTIONS)}, step)
    assert np.array_equal(apart.is_open, strain[:, 1] > part)
    assert np.array_equal(apart.history["apart"], apart.is_open)
