"""Strength that falls with slip: closed forms of a spring that is pulled, in one step or in many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fracflow.laws import SlipWeakening

pytestmark = pytest.mark.serial

K, D_C, F_N = 1e9, 2e-3, -1e6
LAW = SlipWeakening(
    normal_stiffness=1e10,
    shear_stiffness=K,
    aperture=1e-3,
    friction_coefficient=0.7,
    dynamic_friction_coefficient=0.2,
    slip_weakening_distance=D_C,
    cohesion=5e4,
    initial_normal_traction=F_N,
)
PEAK, LOW = 5e4 + 0.7e6, 5e4 + 0.2e6
FALL = (PEAK - LOW) / D_C  # 2.5e8, a quarter of the spring
END = LOW / K + D_C  # slip of the joint at which the weakening ends


def pulled(slips, opening=0.0, law=LAW):
    """Answers, one step after another."""
    past, answers = law.initial_history(1, 2), []
    for slip in slips:
        answers.append(law.evaluate(np.array([[slip, opening]]), past))
        past = answers[-1].history
    return answers


def traction_of(slip):
    """A spring in series with the falling strength, pulled forward from rest."""
    if K * slip <= PEAK:
        return K * slip
    plastic = (K * slip - PEAK) / (K - FALL)
    return PEAK - FALL * plastic if plastic < D_C else LOW


@pytest.mark.parametrize("steps", [1, 2, 7, 100])
@pytest.mark.parametrize("slip", [0.5e-3, 0.76e-3, 1.5e-3, 2.2e-3, 2.5e-3, 1e-2])
def test_the_response_does_not_depend_on_the_steps(slip, steps):
    assert PEAK / K < 0.76e-3 and END == pytest.approx(2.25e-3)
    last = pulled(np.linspace(0.0, slip, steps + 1)[1:])[-1]
    assert last.traction[0, 0] == pytest.approx(traction_of(slip), rel=1e-12)
    assert last.history["slip_path"][0] == pytest.approx(slip - traction_of(slip) / K, rel=1e-9, abs=1e-18)
    assert last.is_sliding[0] == (K * slip > PEAK)
    assert last.strength[0] == pytest.approx(traction_of(slip) if K * slip > PEAK else PEAK, rel=1e-12)


def test_energy_of_fracture():
    """A full weakening dissipates (tau_p - tau_d) D_c/2 beyond the dynamic strength; the mean traction counts it."""
    answers = pulled(np.linspace(0.0, END, 51))
    plastic = np.array([each.inelastic[0, 0] for each in answers])
    traction = np.array([each.traction[0, 0] for each in answers])
    work = np.sum(0.5 * (traction[1:] + traction[:-1]) * np.diff(plastic))
    onset = np.argmax(plastic > 0)
    # the step that passes the peak holds some stick: its mean traction misses the peak by no more than that
    missed = 0.5 * (PEAK - traction[onset - 1]) * plastic[onset]
    assert work + missed == pytest.approx((LOW + PEAK) / 2 * D_C, rel=1e-12)


def test_the_tangent_softens_and_feels_the_normal_traction():
    past = pulled([1.2e-3])[0].history
    stick = {**past, "sliding": np.zeros((1, 1))}
    for start in (past, stick):
        answer = LAW.evaluate(np.array([[1.5e-3, 0.0]]), start)
        assert answer.tangent[0, 0, 0] == pytest.approx(-K * FALL / (K - FALL), rel=1e-12)
        mu = (answer.traction[0, 0] - 5e4) / -F_N
        assert answer.tangent[0, 0, 1] == pytest.approx(-mu * 1e10 * K / (K - FALL), rel=1e-12)
    after = LAW.evaluate(np.array([[9e-3, 0.0]]), past)
    assert after.tangent[0, 0].tolist() == pytest.approx([0.0, -0.2 * 1e10])


def test_what_re_sticks_keeps_what_it_has_lost():
    """Unloading is elastic; sliding goes on from the strength that was left, forward or back, and nothing heals open."""
    past = pulled([1.5e-3])[0].history
    left = traction_of(1.5e-3)
    back = LAW.evaluate(np.array([[1.3e-3, 0.0]]), past)
    assert not back.is_sliding[0] and back.tangent[0, 0, 0] == K
    assert back.traction[0, 0] == pytest.approx(left - K * 0.2e-3)
    assert back.strength[0] == pytest.approx(left, rel=1e-12) and back.history["slip_path"] == past["slip_path"]
    again = LAW.evaluate(np.array([[2.0e-3, 0.0]]), back.history)
    assert again.traction[0, 0] == pytest.approx(traction_of(2.0e-3), rel=1e-12)
    rest = back.history
    for slip in (1.0e-3, 0.0):
        reverse = LAW.evaluate(np.array([[slip, 0.0]]), rest)
        rest = reverse.history
    path = past["slip_path"][0]
    trial = K * past["plastic_slip"][0, 0]  # at no slip the spring pulls back with it
    more = (trial - left) / (K - FALL)
    assert reverse.traction[0, 0] == pytest.approx(-(left - FALL * more), rel=1e-12)
    assert reverse.history["slip_path"][0] == pytest.approx(path + more, rel=1e-12)
    opened = LAW.evaluate(np.array([[0.0, 1e-3]]), rest)
    assert opened.is_open[0] and opened.traction[0].tolist() == [0.0, 0.0]
    assert opened.history["slip_path"] == rest["slip_path"]


@pytest.mark.parametrize("factor", [0.999, 1.001, 3.0])
def test_a_fall_steeper_than_the_spring_jumps_to_the_end(factor):
    """Past k_s D_c = drop the onset of slip has one answer only, on the dynamic strength."""
    law = replace(LAW, slip_weakening_distance=(PEAK - LOW) / (factor * K))
    before, after = pulled([PEAK / K * (1 - 1e-9), PEAK / K * (1 + 1e-9)], law=law)
    assert law.steepness(before.traction, law.initial_history(1, 2))[0] == pytest.approx(factor, rel=1e-12)
    assert law.steepness(before.traction, {**after.history, "slip_path": np.ones(1)})[0] == 0.0
    jumped = factor > 1.0
    expected = LOW if jumped else PEAK
    assert after.traction[0, 0] == pytest.approx(expected, rel=1e-5)
    assert (after.history["slip_path"][0] >= law.slip_weakening_distance) == jumped


def test_the_distance_may_change_from_section_to_section():
    law = replace(LAW, slip_weakening_distance=np.array([2e-3, 4e-3]))
    answer = law.evaluate(np.array([[2.0e-3, 0.0]] * 2), law.initial_history(2, 2))
    assert answer.traction[0, 0] == pytest.approx(traction_of(2.0e-3), rel=1e-12)
    assert answer.traction[1, 0] == pytest.approx(PEAK - FALL / 2 * (2e6 - PEAK) / (K - FALL / 2), rel=1e-12)


def test_path_of_a_turn_in_three_dimensions():
    """The slip that counts is the length of its path, not its end."""
    law, past = replace(LAW, dynamic_friction_coefficient=0.7), LAW.initial_history(1, 3)
    path = 0.0
    for n in range(200):
        angle = 2 * np.pi * n / 200
        before = past["plastic_slip"]
        past = law.evaluate(np.array([[5e-3 * np.cos(angle), 5e-3 * np.sin(angle), 0.0]]), past).history
        path += np.linalg.norm(past["plastic_slip"] - before)
    assert past["slip_path"][0] == pytest.approx(path, rel=1e-12) and path > 0.02


def test_the_steepest_fall_under_any_compression():
    """None where friction does not fall, else no bound."""
    friction = LAW.friction_coefficient
    assert replace(LAW, dynamic_friction_coefficient=friction).most_steepness(np.inf) == 0.0
    assert LAW.most_steepness(np.inf) == np.inf and LAW.most_steepness(0.0) == 0.0
