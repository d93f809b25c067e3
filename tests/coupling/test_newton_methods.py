"""Every method of NEWTON_METHODS gives the same balanced step where nothing unloads."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping
from fracflow.integrators import Steady
from fracflow.reduction.prepare import prepare
from fracflow.scene.method import Method
from fracflow.scene.scene import load
from fracflow.solve.request import StepRequest
from fracflow.solve.stiffness import NEWTON_METHODS

SLOW = "accuracy.max_iterations=1000"


def _steps(file, overshoot, controls, overrides):
    """Method -> state and report of one step, all from one mesh and its distribution."""
    found, model = {}, None
    for method in NEWTON_METHODS:
        settings = [f"method.newton={method}", f"method.overshoot={overshoot}", SLOW, *overrides]
        scene = load(f"meshes/{file}/scene.toml", settings)
        model = prepare(scene, MPI.COMM_WORLD) if model is None else replace(model, scene=scene)
        stepping = Stepping(model)
        found[method] = stepping.step(
            equilibrium_state(model), StepRequest(1.0, 1.0, controls, stepping.model.loads), Steady()
        )
        stepping.destroy()
    return found


def test_the_scene_knows_every_method():
    assert set(get_args(Method.model_fields["newton"].annotation)) == set(NEWTON_METHODS)


@pytest.mark.parametrize("overshoot", ["hold", "one-change"])
@pytest.mark.parametrize(
    ("scene", "controls", "overrides", "natural"),
    [
        ("report_5_1", {}, ["load.0.force=[2.5,0]"], (1.0, 1.0)),  # slides, with a drop of strength
        ("report_5_3", {"pumping": 2.2}, [], (1.7e-3, 3e4)),  # 2 % below failure; natural sizes f_n0/k_n0 and p0
    ],
)
def test_all_methods_reach_the_same_state(scene, controls, overrides, natural, overshoot):
    found = _steps(scene, overshoot, controls, overrides)
    reference, report = found.pop("newton")
    assert report.newton > 1, "the step is nonlinear"
    for name, (state, slower) in found.items():
        assert slower.newton > report.newton, name
        for mine, theirs, size in (
            (state.motion.displacement, reference.motion.displacement, natural[0]),
            (state.pressure, reference.pressure, natural[1]),
        ):
            change = mine - theirs
            assert change.norm(3) <= 1e-10 * max(theirs.norm(3), size), name
        assert np.array_equal(state.sections.is_sliding, reference.sections.is_sliding), name
