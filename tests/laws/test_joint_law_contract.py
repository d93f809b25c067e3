"""The contract of every joint law of the registry."""

from __future__ import annotations

from dataclasses import fields
from typing import ClassVar

import numpy as np
import pytest

from fracflow.laws import JOINT_LAWS, HistoryVariable, LawStep, keys_of, published_history
from fracflow.scene.materials import Fracture
from fracflow.scene.units import UnitSystem

pytestmark = pytest.mark.serial

SECTIONS = 40
SAMPLES = {
    "hyperbolic-coulomb": dict(
        normal_stiffness=2e3,
        shear_stiffness=1.5e3,
        aperture=0.01,
        friction_coefficient=0.7,
        cohesion=0.5,
        stick_slip_ratio=0.8,
        initial_normal_traction=-4.0,
        initial_shear_traction=1.0,
    ),
    "slip-weakening": dict(
        normal_stiffness=2e3,
        shear_stiffness=1.5e3,
        aperture=0.01,
        friction_coefficient=0.7,
        dynamic_friction_coefficient=0.3,
        slip_weakening_distance=0.025,
        cohesion=0.5,
        initial_normal_traction=-4.0,
        initial_shear_traction=1.0,
    ),
    "rate-and-state": dict(
        normal_stiffness=2e3,
        shear_stiffness=1.5e3,
        aperture=0.01,
        friction_coefficient=0.7,
        reference_slip_rate=1e-6,
        direct_effect=0.01,
        evolution_effect=0.015,
        characteristic_slip=0.001,
        initial_slip_rate=1e-9,
        initial_normal_traction=-4.0,
        initial_shear_traction=1.0,
    ),
    "linear": dict(
        normal_stiffness=2e3, shear_stiffness=1.5e3, initial_normal_traction=-4.0, initial_shear_traction=1.0
    ),
}


@pytest.fixture(params=sorted(JOINT_LAWS))
def law(request):
    return JOINT_LAWS[request.param](**SAMPLES[request.param])


@pytest.fixture(params=[2, 3], ids=["2d", "3d"])
def dim(request):
    return request.param


def path(dim, seed=0, steps=30):
    """Random walk of strains that closes, opens, slides and reverses."""
    rng = np.random.default_rng(seed)
    strain = np.zeros((SECTIONS, dim))
    for _ in range(steps):
        strain = strain + rng.normal(0.0, 1.5e-3, strain.shape)
        strain[:, -1] = np.clip(strain[:, -1], -0.008, 0.004)
        yield strain


def course(dim, steps=12):
    """Every section alike: pushed on in shear far past its strength, back, on again while the walls part and close."""
    rng = np.random.default_rng(1)
    there, back, on = np.linspace(0.0, 0.04, steps), np.linspace(0.04, 0.02, steps), np.linspace(0.02, 0.06, steps)
    along = np.concatenate([there, back, on, on[-1:].repeat(steps)])
    across = np.concatenate(
        [-1e-3 * np.ones(3 * steps), np.linspace(-1e-3, 4e-3, steps // 2), np.full(steps // 2, -2e-3)]
    )
    turned = rng.uniform(0.9, 1.1, (SECTIONS, 2))
    for slip, opening in zip(along, across, strict=True):
        strain = np.zeros((SECTIONS, dim))
        strain[:, 0], strain[:, -1] = slip * turned[:, 0], opening * turned[:, 1]
        if dim == 3:
            strain[:, 1] = 0.3 * slip * turned[:, 1]
        yield strain


PATHS = {"walk": path, "course": course}


@pytest.fixture(params=PATHS)
def strains(request, dim):
    return list(PATHS[request.param](dim))


def copy(past):
    return {name: array.copy() for name, array in past.items()}


def latched(law, past, response):
    """The history of ``past`` with the status the response has chosen."""
    return {name: (response.history if name in law.status else past)[name] for name in past}


def test_shapes_and_finite(law, dim):
    past = law.initial_history(SECTIONS, dim)
    shapes = {"shear": (SECTIONS, dim - 1), "scalar": (SECTIONS,)}
    for strain in path(dim):
        response = law.evaluate(strain, past)
        assert response.traction.shape == response.inelastic.shape == (SECTIONS, dim)
        assert response.tangent.shape == (SECTIONS, dim, dim)
        for name in ("stored", "utilisation", "is_sliding", "is_open", "margin"):
            assert getattr(response, name).shape == (SECTIONS,)
        assert response.is_sliding.dtype == response.is_open.dtype == bool
        for name in ("traction", "tangent", "stored", "inelastic"):
            assert np.isfinite(getattr(response, name)).all()
        assert (response.margin >= 0).all() and (response.utilisation >= 0).all()  # false for nan
        assert set(response.history) == set(law.history)
        for name, variable in law.history.items():
            assert response.history[name].shape == shapes[variable.kind]
        assert (law.step_limit(strain, -strain) > 0).all()
        ahead = np.roll(strain, 1, axis=0) - strain
        change = law.change_at(strain, ahead)
        past_it = law.evaluate(strain + ahead, past, LawStep(hold=True)).is_open
        assert (change > 0).all()
        assert np.array_equal(change <= 1.0, past_it != response.is_open)
        past = response.history


def test_pure(law, dim):
    past = law.initial_history(SECTIONS, dim)
    for strain in path(dim):
        kept, kept_strain = copy(past), strain.copy()
        first, second = law.evaluate(strain, past), law.evaluate(strain, past)
        assert np.array_equal(strain, kept_strain)
        for name in past:
            assert np.array_equal(past[name], kept[name])
            assert not np.shares_memory(past[name], first.history[name])
        assert np.array_equal(first.traction, second.traction)
        past = first.history


def test_initial_state(law, dim):
    response = law.evaluate(np.zeros((SECTIONS, dim)), law.initial_history(SECTIONS, dim))
    assert np.allclose(response.traction[:, :-1], law.initial_shear_traction)
    assert np.allclose(response.traction[:, -1], law.initial_normal_traction)
    assert np.all(response.stored == 0) and np.all(response.inelastic == 0)


def test_tangent_is_the_derivative(law, dim, strains):
    """Central differences with the status latched, where the status holds on both sides."""
    past, step, checked, slid = law.initial_history(SECTIONS, dim), 1e-9, 0, 0
    for strain in strains:
        response = law.evaluate(strain, past)
        here = latched(law, past, response)
        base = law.evaluate(strain, here)
        for j in range(dim):
            shift = step * np.eye(dim)[j]
            ahead, behind = law.evaluate(strain + shift, here), law.evaluate(strain - shift, here)
            difference = (ahead.traction - behind.traction) / (2 * step)
            smooth = (base.margin > 1e-3) & (ahead.is_open == behind.is_open)
            smooth &= (ahead.is_sliding == base.is_sliding) & (behind.is_sliding == base.is_sliding)
            smooth &= np.abs(strain[:, -1]) > 2 * step
            assert np.allclose(difference[smooth], base.tangent[smooth][:, :, j], rtol=1e-5, atol=1e-3)
            checked += smooth.sum()
            slid += (smooth & base.is_sliding).sum()
        past = response.history
    assert checked > 500
    assert slid > 50 or not law.status


def test_dissipation(law, dim, strains):
    past, before = law.initial_history(SECTIONS, dim), np.zeros((SECTIONS, dim))
    for strain in strains:
        response = law.evaluate(strain, past)
        work = np.einsum("ni,ni->n", response.traction, response.inelastic - before)
        assert (work >= -1e-14).all()
        past, before = response.history, response.inelastic


def test_the_course_meets_every_state(law, dim):
    """So that the tests above see each law with a strength stick, slide, reverse, part and meet again."""
    if not law.status:
        return
    past, seen = law.initial_history(SECTIONS, dim), []
    for strain in course(dim):
        response = law.evaluate(strain, past)
        seen.append((response.is_sliding[0], response.is_open[0]))
        past = response.history
    kinds = [key for n, key in enumerate(seen) if n == 0 or key != seen[n - 1]]
    stick, slide, apart = (False, False), (True, False), (False, True)
    assert kinds[:2] == [stick, slide] and kinds.count(stick) >= 2 and apart in kinds
    assert kinds.index(apart) < len(kinds) - 1


def test_the_next_event_is_told(law, dim, strains):
    """Distances of friction are negative where sticking ends, or sliding, and those of contact where the walls touch."""
    past, eps, rng = law.initial_history(SECTIONS, dim), 1e-9, np.random.default_rng(5)
    for strain in strains:
        response = law.evaluate(strain, past)
        ahead = eps * rng.normal(size=strain.shape)
        contact = law.approach(strain, ahead, past)[:, 1]
        if not law.status:
            assert np.isinf(law.approach(strain, ahead, past)).all()
            continue
        assert np.array_equal(contact > 0.0, response.is_open)
        stuck = ~past["sliding"].any(axis=1) & ~response.is_open & (response.margin > 1e-6)
        ends = law.approach(strain, ahead, past)[:, 0] < 0.0
        assert np.array_equal(ends[stuck], response.is_sliding[stuck])
        here = response.history
        onward = law.approach(strain, ahead, here)[:, 0]
        clear = response.is_sliding & (np.abs(onward) > 1e-2 * eps * law.shear_stiffness)
        goes_on = law.evaluate(strain + ahead, here).is_sliding
        assert np.array_equal(onward[clear] > 0.0, goes_on[clear])
        past = here


def test_flipped_friction(law, dim, strains):
    """A section that sticks then slides the way of its trial traction, one that slides sticks; others stay as they are."""
    past = law.initial_history(SECTIONS, dim)
    chosen = np.arange(SECTIONS) % 2 == 0
    for strain in strains if law.status else ():
        response = law.evaluate(strain, past)
        was, other = past["sliding"].any(axis=1), law.with_other_status(strain, past, chosen)["sliding"]
        assert np.array_equal(other.any(axis=1), was ^ chosen)
        assert np.array_equal(other[~chosen], past["sliding"][~chosen])
        past = response.history


def test_softening_is_told(law, dim):
    """``steepness`` is the fall of strength with plastic slip, over the shear stiffness; 0 where it does not fall."""
    past = law.initial_history(SECTIONS, dim)
    for strain in course(dim):
        response = law.evaluate(strain, past)
        on = response.is_sliding & ~np.isinf(response.strength)
        ahead = strain.copy()
        ahead[:, :-1] += 1e-6 * response.history.get("sliding", 0.0)
        more = law.evaluate(ahead, response.history)
        on &= more.is_sliding
        moved = np.linalg.norm(more.inelastic - response.inelastic, axis=1)
        fall = np.linalg.norm(response.traction[:, :-1], axis=1) - np.linalg.norm(more.traction[:, :-1], axis=1)
        steep = law.steepness(response.traction, response.history)
        pressed = float(np.maximum(-response.traction[:, -1], 0.0).max())
        assert np.isinf(pressed) or steep.max() <= law.most_steepness(pressed) * (1.0 + 4e-16)
        same = steep == law.steepness(more.traction, more.history)  # not across the end of the weakening
        assert np.allclose(fall[on & same], (steep * moved * law.shear_stiffness)[on & same], rtol=1e-6, atol=1e-9)
        past = response.history


def test_the_drop_of_strength_is_told(law, dim):
    """``strength_drop`` is what has gone of the strength after more slip than ``slip_length``, and not before."""
    strain, past = np.zeros((SECTIONS, dim)), law.initial_history(SECTIONS, dim)
    strain[:, -1] = -np.linspace(0.0, 5e-3, SECTIONS)
    pressed = -law.evaluate(strain, past).traction[:, -1]
    peak, drop, length = law.evaluate(strain, past).strength, law.strength_drop(pressed), law.slip_length(SECTIONS)
    assert drop.shape == length.shape == (SECTIONS,) and (drop >= 0.0).all() and (length >= 0.0).all()
    assert bool(law.weakens_over) == bool((np.isfinite(length) & (length > 0.0)).any())
    assert bool(law.no_drop) == bool((length == 0.0).any())
    if not law.status:
        assert np.isinf(peak).all() and np.isinf(length).all() and not drop.any()
        return

    def lost(slip):
        strain[:, 0] = slip + (peak - law.initial_shear_traction) / law.shear_stiffness
        answer = law.evaluate(strain, past)
        assert answer.is_sliding.all()
        return peak - np.linalg.norm(answer.traction[:, :-1], axis=1), answer.inelastic[:, 0]

    fallen, slipped = lost(0.1)
    assert np.isinf(length).all() or (slipped >= length).all()
    assert fallen == pytest.approx(drop, rel=1e-12)
    fallen, slipped = lost(1e-6)
    early = slipped < length
    assert np.array_equal(early, length > 0.0)
    assert fallen[~early] == pytest.approx(drop[~early], rel=1e-12) and (fallen[early] < 0.1 * drop[early]).all()


@pytest.mark.parametrize("name", JOINT_LAWS)
def test_what_a_law_advises_are_keys_of_its_own(name):
    law = JOINT_LAWS[name]
    for said in (law.weakens_over, law.no_drop.partition(" = ")[0]):
        assert not said or said in keys_of(law)


def test_stored_energy_is_the_work_of_the_traction(law, dim):
    """Traction = d stored / d strain while sticking."""
    past, step = law.initial_history(SECTIONS, dim), 1e-7
    strain = np.random.default_rng(3).uniform(-1e-4, 1e-4, (SECTIONS, dim))
    base = law.evaluate(strain, past)
    assert not base.is_sliding.any()
    for j in range(dim):
        shift = step * np.eye(dim)[j]
        slope = law.evaluate(strain + shift, past).stored - law.evaluate(strain - shift, past).stored
        assert np.allclose(slope / (2 * step), base.traction[:, j], rtol=1e-6, atol=1e-6)


def test_one_change_of_status(law, dim):
    """Sticking to sliding one way to sliding the other takes three calls."""
    past = law.initial_history(1, dim)
    if not law.status:  # nothing to latch: the answer is the same with every status held
        strain = np.full((1, dim), 1e-3)
        assert np.array_equal(
            law.evaluate(strain, past).traction, law.evaluate(strain, past, LawStep(hold=True)).traction
        )
        return
    there, back = np.zeros((1, dim)), np.zeros((1, dim))
    there[0, 0], back[0, 0] = 0.1, -0.1
    past = law.evaluate(there, past).history
    reverse = law.evaluate(back, past)
    assert not reverse.is_sliding[0]
    assert np.array_equal(reverse.inelastic[0, :-1], past["plastic_slip"][0])
    again = law.evaluate(back, latched(law, past, reverse))
    assert again.is_sliding[0] and again.traction[0, 0] < 0


def test_rotation_of_shear(law):
    """Shear is isotropic: rotated slip gives rotated shear traction, tangent and history."""
    law = type(law)(**{**vars(law), "initial_shear_traction": np.tile([0.8, 0.0], (SECTIONS, 1))})
    angle = 0.7
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    turned_law = type(law)(**{**vars(law), "initial_shear_traction": law.initial_shear_traction @ turn[:2, :2].T})
    past, turned_past = law.initial_history(SECTIONS, 3), law.initial_history(SECTIONS, 3)
    for strain in path(3):
        plain, turned = law.evaluate(strain, past), turned_law.evaluate(strain @ turn.T, turned_past)
        assert np.allclose(turned.traction, plain.traction @ turn.T, atol=1e-9)
        assert np.allclose(turned.tangent, turn @ plain.tangent @ turn.T, atol=1e-6)
        past, turned_past = plain.history, turned.history


def test_3d_with_slip_along_one_axis_is_2d(law):
    flat, solid = law.initial_history(SECTIONS, 2), law.initial_history(SECTIONS, 3)
    law3 = type(law)(**{**vars(law), "initial_shear_traction": np.tile([1.0, 0.0], (SECTIONS, 1))})
    for strain in path(2):
        two = law.evaluate(strain, flat)
        three = law3.evaluate(np.insert(strain, 1, 0.0, axis=1), solid)
        assert np.allclose(three.traction, np.insert(two.traction, 1, 0.0, axis=1), atol=1e-12)
        assert np.allclose(three.stored, two.stored)
        flat, solid = two.history, three.history


def test_parameters_may_be_arrays(law, dim):
    arrays = {k: v if isinstance(v, bool) else np.full(SECTIONS, v) for k, v in vars(law).items()}
    arrays["initial_shear_traction"] = np.full((SECTIONS, dim - 1), law.initial_shear_traction)
    many = type(law)(**arrays)
    past = law.initial_history(SECTIONS, dim)
    for strain in path(dim):
        one = law.evaluate(strain, past)
        assert np.array_equal(one.traction, many.evaluate(strain, past).traction)
        past = one.history


def test_no_sections(law, dim):
    response = law.evaluate(np.zeros((0, dim)), law.initial_history(0, dim))
    assert response.traction.shape == (0, dim)


def test_hold_keeps_every_status(law, dim):
    """With ``step.hold`` a sticking section stays elastic past its strength, a sliding one slides though it unloads."""
    past = law.initial_history(1, dim)
    there, back = np.zeros((1, dim)), np.zeros((1, dim))
    there[0, 0], back[0, 0] = 0.1, -0.1
    assert not law.evaluate(there, past, LawStep(hold=True)).is_sliding.any()
    if law.status:
        slid = {**past, **{name: law.evaluate(there, past).history[name] for name in law.status}}
        held = law.evaluate(back, slid, LawStep(hold=True))
        assert held.is_sliding.all()
        assert held.traction[0, 0] > 0.0


def test_turning_while_sliding_is_no_change_of_status():
    """In three dimensions a slide may turn across an axis; only its reversal, its end and its begin are changes."""
    law = JOINT_LAWS["hyperbolic-coulomb"](**SAMPLES["hyperbolic-coulomb"])
    old = {"sliding": np.array([[1.0, 1e-9], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])}
    new = {"sliding": np.array([[1.0, -1e-9], [-1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])}
    assert law.has_changed(old, new).tolist() == [False, True, True, True]


@pytest.mark.parametrize("name", JOINT_LAWS)
def test_every_parameter_of_a_law_is_a_key_of_the_scene(name):
    keys = set(Fracture.model_fields) | {"coupled_tangent", "strength_when_open", "radiates"}  # the last are [method]'s
    keys |= {"wave_impedance"}  # the rock's
    assert {field.name for field in fields(JOINT_LAWS[name])} <= keys


@pytest.mark.parametrize("name", ["hyperbolic-coulomb", "slip-weakening"])
def test_a_section_at_its_strength_fails_whichever_way_round_off_has_it(name):
    """(2.12) |f_s| >= f_sy."""
    pressed = np.repeat(np.random.default_rng(76).uniform(1.0, 1e8, 40), 5)
    peak = 0.5 + 0.7 * pressed
    steps = np.tile(np.arange(-2, 3), 40) * np.finfo(float).eps
    still, some = np.zeros((len(pressed), 2)), np.where(np.arange(len(pressed)) % 2, 1.0, -1.0)

    def slides(shear, pressed=pressed, **keys):
        given = {**SAMPLES[name], "initial_normal_traction": -pressed, "initial_shear_traction": shear, **keys}
        law = JOINT_LAWS[name](**given)
        return law.evaluate(still, law.initial_history(len(still), 2)).is_sliding

    assert slides(some * peak * (1.0 + steps)).all()
    assert not slides(some * peak * (1.0 - 1e-9)).any()
    assert not slides(0.0 * peak, 0.0 * pressed, cohesion=0.0).any()  # no strength, and nothing to resist


def test_history_is_declared(law):
    system = UnitSystem.parse("SI")
    for name, variable in law.history.items():
        assert variable.meaning and system.to_si(variable.dimension) > 0.0, name
    assert set(law.status) <= set(law.history)


def test_one_name_of_history_has_one_meaning():
    class Other(JOINT_LAWS["slip-weakening"]):
        history: ClassVar = {"slip_path": HistoryVariable("scalar", "time", "age")}

    with_slip = (JOINT_LAWS[name] for name in ("hyperbolic-coulomb", "slip-weakening", "linear"))
    assert published_history(with_slip) == {}, "output has what these laws remember by other names"
    published_history(JOINT_LAWS.values())
    assert set(published_history([Other])) == {"slip_path"}

    class Third(Other):
        history: ClassVar = {"slip_path": HistoryVariable("scalar", "length", "path")}

    with pytest.raises(ValueError, match="slip_path"):
        published_history([Other, Third])
