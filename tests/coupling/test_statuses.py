"""Sections at their strength: they slide, but for those that sliding has carried backward in the same step."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.laws import LawStep
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.solve.statuses import Statuses

STIFF, SLIP, NORMAL, FRICTION = 1e12, 7.0, 100e6, 0.6
ROUND_OFF = 1e-12 * STIFF * SLIP  # of the elastic trial [Pa]


@pytest.mark.serial
@pytest.mark.parametrize("short", [0.5, 2.0, -2.0])
def test_a_section_that_slid_backward_slides_again_only_beyond_round_off(short):
    """After a slip of 7 m the trial is known to 7 Pa. It is ``short`` of the strength by so many of these."""
    scene = Scene.from_data({
        "geometry": {"domain": "unbounded", "size_at_fractures": 1.0, "fracture": [{"name": "f", "points": [[0, 0], [4, 0]]}]},
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25}},
        "initial_stress": {"xx": -NORMAL, "yy": -NORMAL},
        "fracture": {"f": {
            "aperture": 1e-3, "normal_stiffness": STIFF, "shear_stiffness": STIFF, "friction_coefficient": FRICTION,
        }},
        "stage": [{"kind": "quasi-static", "time_step": 1, "steps": 1}],
    })  # fmt: skip
    model = prepare(scene, MPI.COMM_SELF)
    state, joints = equilibrium_state(model), model.operators.joints
    before = tuple(
        {**each, "plastic_slip": np.full_like(each["plastic_slip"], SLIP)} for each in state.sections.history
    )
    strain = np.zeros_like(state.sections.strain)
    strain[:, 0] = SLIP + (FRICTION * NORMAL - short * ROUND_OFF) / STIFF
    held, found = (joints.evaluate(strain, before, LawStep(1.0, 1.0, True, hold)) for hold in (True, False))
    assert not held.is_sliding.any() and (found.is_sliding == (short < 1.0)).all()
    first = Statuses(before, np.zeros(len(strain), dtype=bool))
    assert (first.after(joints, before, held, found)[1] == found.is_sliding).all()
    again, changed = Statuses(before, ~first.refused).after(joints, before, held, found)
    assert changed.all() if short < 0.0 else not changed.any()
    assert not joints.have_changed(before, again.history).any() or short < 0.0
    sliding = Statuses(joints.with_status(before, found.history), first.refused)
    if short < 0.0:  # the other way round: what slides, and would stick, is refused
        assert sliding.after(joints, before, found, held)[0].refused.all()
    state.destroy()
