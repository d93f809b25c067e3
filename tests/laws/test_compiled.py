"""The compiled copy of the laws of friction: the bits of the laws themselves, wherever sections are."""

import numpy as np
import pytest

from fracflow.laws import HyperbolicCoulomb, SlipWeakening
from fracflow.laws.base import LawStep
from fracflow.laws.compiled import CompiledFriction, fastest, library

pytestmark = [pytest.mark.serial, pytest.mark.skipif(library() is None, reason="loops are not compiled here")]
SECTIONS = 4000
CHOICES = (
    {},
    {"coupled_tangent": False},
    {"strength_when_open": True},
    {"cohesion": np.inf},
    {"initial_normal_traction": 0.0, "cohesion": 0.0},
)


def law_of(kind, choices):
    rng = np.random.default_rng(5)
    given = {
        "normal_stiffness": rng.uniform(5.0, 20.0, SECTIONS),
        "shear_stiffness": 7.0,
        "aperture": rng.uniform(0.5, 1.0, SECTIONS),
        "friction_coefficient": 0.6,
        "cohesion": 0.3,
        "initial_normal_traction": -rng.uniform(0.0, 6.0, SECTIONS),
        "initial_shear_traction": rng.uniform(-1.0, 1.0, (SECTIONS, 1)),
    }
    if kind is SlipWeakening:
        given |= {"dynamic_friction_coefficient": 0.3, "slip_weakening_distance": rng.uniform(0.02, 1.0, SECTIONS)}
    else:
        given |= {"stick_slip_ratio": 0.8}
    return kind(**{**given, **choices})


@pytest.mark.parametrize("choices", CHOICES)
@pytest.mark.parametrize("kind", [HyperbolicCoulomb, SlipWeakening])
def test_response_has_the_bits_of_the_law(kind, choices):
    """Sticking, sliding either way, turning back, past D_c, open, shut beyond the aperture, overflow, and no number."""
    law, rng = law_of(kind, choices), np.random.default_rng(7)
    strain = rng.uniform(-1.0, 1.0, (SECTIONS, 2)) * [1.5, 1.2]
    strain[::500] = np.nan
    strain[1::500] = 0.0
    large = rng.choice([1e160, -1e308, np.inf], (SECTIONS // 50, 2))
    with np.errstate(invalid="ignore"):  # 0 times infinity, as a trial may have it
        strain[2::50] = large * rng.choice([0.0, 1.0], large.shape)
    history = law.initial_history(SECTIONS, 2)
    history["plastic_slip"] = rng.choice([0.0, 0.4, -0.7], (SECTIONS, 1))
    history["sliding"] = rng.choice([-1.0, 0.0, 1.0], (SECTIONS, 1))
    if "slip_path" in history:
        history["slip_path"] = rng.choice([0.0, 0.05, 2.0], SECTIONS)
    copy = fastest(law, SECTIONS, 2)
    assert isinstance(copy, CompiledFriction)
    for hold in (True, False):
        step = LawStep(hold=hold)
        with np.errstate(invalid="ignore", over="ignore"):  # held sliding without end of strength has no numbers
            mine, theirs = copy.evaluate(strain, history, step), law.evaluate(strain, history, step)
        ways = theirs.is_sliding, ~theirs.is_sliding, theirs.is_open, np.isneginf(theirs.traction[:, 1])
        assert all(each.mean() > 0.02 for each in ways) or "cohesion" in choices
        for name in ("traction", "tangent", "inelastic", "strength", "utilisation", "is_sliding", "is_open", "margin"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name), err_msg=name)
        np.testing.assert_allclose(mine.stored, theirs.stored, rtol=1e-13, atol=1e-15)
        assert mine.history.keys() == theirs.history.keys()
        for name, values in theirs.history.items():
            np.testing.assert_array_equal(mine.history[name], values, err_msg=name)


def test_others_serve_themselves():
    """Laws without a copy, those that inherit one, and sections in space."""

    class Own(HyperbolicCoulomb):
        pass

    law = law_of(HyperbolicCoulomb, {})
    own = law_of(Own, {})
    assert fastest(law, SECTIONS, 3) is law and fastest(own, SECTIONS, 2) is own
