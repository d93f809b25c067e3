"""Report, Section 5.1, Figs. 9 and 10: a rigid block on springs, sliding between two joints; three methods.

One unknown u: springs 2 x 0.05 = K, joints 2 x 1/2 = 1, their strength 2 C = 2, and alpha 2 = 1 while sliding.
"""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping
from fracflow.errors import InputError, SolveError
from fracflow.integrators import Steady
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve.request import StepRequest

SCENE = "meshes/report_5_1/scene.toml"
P = np.array([1, 2, 2.5, 2, 1, -0.5, -1.5])
# P = K u + f; sticking f = u - u_p, sliding f = +-1 (alpha = 1/2); u_p = u - f
U = np.array([10 / 11, 20 / 11, 15, 160 / 11, 150 / 11, 135 / 11, -5])
SLIP = np.array([0, 0, 14, 14, 14, 14, -4])
FIGURE_10 = ["fracture.default.stick_slip_ratio=1", "load.0.force=[2.5,0]", "accuracy.out_of_balance=1e-6"]
CHOICES = [(m, o) for m in ("default", "report") for o in ("hold", "one-change")]


def test_the_hand_solution_balances():
    """The oracle itself: equilibrium, and a strength that no sticking state passes."""
    force = U - SLIP
    assert np.abs(0.1 * U + force - P).max() < 1e-14
    sliding = np.array([0, 0, 1, 0, 0, 0, 1], dtype=bool)
    assert np.abs(force[~sliding]).max() < 2.0
    assert force[sliding] == pytest.approx([1.0, -1.0])
    # elastically, states 3 and 7 would pass the strength, with the slip there was before
    assert 2.5 / 1.1 > 2.0 and (-1.5 + 14) / 1.1 - 14 < -2.0


@pytest.mark.parametrize(("model", "overshoot"), CHOICES)
def test_seven_states_and_their_iterations(ran, model, overshoot):
    """Fig. 9; one iteration from state 4 to 5, two from 6 to 7, two to unload from 3 to 4, as the text says."""
    history = ran("report_5_1", f"model={model}", f"method.overshoot={overshoot}").history
    assert history["time"].tolist() == list(range(8))
    assert np.abs(history["probe/block/displacement"][1:, 0] - U).max() < 1e-12
    assert np.abs(history["probe/lower/plastic_slip"][1:] - SLIP).max() < 1e-12
    assert np.abs(2.0 * history["probe/lower/shear_traction"][1:] - (U - SLIP)).max() < 1e-12
    assert history["step/newton"][1:].tolist() == [1, 1, 2, 2, 1, 1, 2]
    assert np.abs(history["energy/residual"]).max() < 1e-12


def _figure_10(method, overshoot):
    """(4.9a) at the start and after each iteration of the step, counted by the step; the block's displacement."""
    settings = [f"method.newton={method}", f"method.overshoot={overshoot}", "accuracy.max_iterations=300"]
    model = prepare(load(SCENE, [*FIGURE_10, *settings]), MPI.COMM_WORLD)
    stepping = Stepping(model)
    state, report = stepping.step(equilibrium_state(model), StepRequest(1.0, 1.0, {}, stepping.model.loads), Steady())
    farthest = state.motion.displacement.norm(3)
    stepping.destroy()
    assert len(report.out_of_balance) == report.newton + 1
    return np.array(report.out_of_balance), farthest


@pytest.mark.parametrize("overshoot", ["hold", "one-change"])
def test_figure_10(overshoot):
    """Closed forms, P = 2.5 and strength 2: all start elastically, with the residual 3/11 at u = 25/11; the answer is 5.

    modified  R shrinks by 1 - 0.1/1.1 an iteration
    secant    u' = P / (0.1 + 2/u), so 1/u - 1/5 shrinks by 2/2.5
    """
    n = np.arange(200)
    expected = {
        "newton": np.array([2.5, 3 / 11, 0.0]),
        "modified": np.concatenate([[2.5], 3 / 11 * (10 / 11) ** n]),
        "secant": np.concatenate([[2.5], 0.5 - 0.1 / (0.2 + (11 / 25 - 0.2) * 0.8**n)]),
    }
    counts = {}
    for method, residuals in expected.items():
        found, displacement = _figure_10(method, overshoot)
        counts[method] = int(np.argmax(residuals < 1e-6))
        assert len(found) == counts[method] + 1, method
        assert np.abs(found - residuals[: len(found)]).max() < 1e-12, method
        assert abs(displacement - 5.0) < 1e-5, method  # R = K (5 - u)
    assert counts == {"newton": 2, "modified": 133, "secant": 61}
    assert min(counts["modified"], counts["secant"]) >= 20 * counts["newton"]


@pytest.mark.parametrize("overshoot", ["hold", "one-change"])
@pytest.mark.parametrize("method", ["modified", "secant"])
def test_the_other_methods_fail_on_unloading_and_say_so(shared_tmp, method, overshoot):
    """They reach state 3, in many iterations, and stop at state 4, the first that unloads."""
    settings = [f"method.newton={method}", f"method.overshoot={overshoot}", "accuracy.max_iterations=300"]
    scene = load(SCENE, [*settings, "output.pictures=false"])
    expected = rf'time 4: method\.newton = "{method}" did not converge in .*slipped before: lower, upper'
    with pytest.raises(SolveError, match=expected + r'.*; set method\.newton = "newton"$'):
        run(scene, shared_tmp / "run", MPI.COMM_WORLD)


def test_too_few_iterations_without_unloading_name_the_limit(shared_tmp):
    """Where nothing has slipped before, more iterations would do."""
    scene = load(SCENE, [*FIGURE_10, "method.newton=modified", "accuracy.max_iterations=100", "output.pictures=false"])
    with pytest.raises(SolveError, match=r'set method\.newton = "newton", or raise accuracy\.max_iterations$'):
        run(scene, shared_tmp / "run", MPI.COMM_WORLD)


def test_a_force_is_spread_over_its_rock(ran):
    """Half of what acts on the two springs goes to the block, the other half to their fixed ends."""
    history = ran("report_5_1", "load.0.on=spring", "load.0.force=[2,0]", "stage.states.end=1").history
    assert history["probe/block/displacement"][-1, 0] == pytest.approx(10 / 11, abs=1e-14)


def test_a_force_on_no_rock_is_refused():
    with pytest.raises(InputError, match=r'load\.0\.on = "ends": not in the mesh; .*allowed: .*block'):
        prepare(load(SCENE, ["load.0.on=ends"]), MPI.COMM_WORLD)
