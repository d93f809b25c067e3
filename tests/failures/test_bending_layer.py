"""F6c: a layer that bends over springs that only push; Newton's whole steps go in circles, a line search ends right."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import nnls

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping
from fracflow.errors import SolveError
from fracflow.integrators import Steady
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve.globalisation import by_energy, by_residual
from fracflow.solve.request import StepRequest

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "bending_layer" / "scene.toml"

FREE = ["fracture.bedding.shear_stiffness=1e-9"]  # nothing but the springs across


def _ran(folder, *overrides):
    comm = MPI.COMM_WORLD
    run(load(SCENE, ["output.pictures=false", *overrides]), folder, comm)
    return comm.bcast(read_history(folder / "history.h5") if comm.rank == 0 else None)


def test_whole_steps_go_in_circles_and_name_them(shared_tmp):
    expected = (
        r"11 sections keep changing between open and closed: bedding at \(10, 0\), .*bedding at \(7, 0\), .* more places;"
        r' relative residual of the solid \S+, .*wanted 1e-11, worst in bedding at \(.*\); .*line_search = "energy"'
    )
    with pytest.raises(SolveError, match=expected):
        _ran(shared_tmp / "run", "method.line_search=none", "accuracy.max_halvings=0")


def _contact_forces():
    """Forces q >= 0 of the springs by non-negative least squares: r = q / (k w) + g_0 + C q >= 0, q r = 0; and the motion."""
    model = prepare(load(SCENE, FREE), MPI.COMM_SELF)
    joints, layout = model.operators.joints, model.operators.layout
    held, size = model.loads.held, layout.total
    stiffness = np.array(model.operators.stiffness.getValues(range(size), range(size)))
    jump = np.array(joints.jump.getValues(range(2 * len(joints.weights)), range(size)))[1::2]
    right = layout.solid_vector()
    model.loads.force(1.0, {}, right)
    free = np.setdiff1d(np.arange(size), held)
    flexible = np.linalg.inv(stiffness[np.ix_(free, free)])
    gaps = jump[:, free] @ flexible @ right.getArray()[free]
    matrix = jump[:, free] @ flexible @ jump[:, free].T + np.diag(1.0 / (1e6 * joints.weights))
    upper = np.linalg.cholesky(matrix).T
    forces, _ = nnls(upper, np.linalg.solve(upper.T, -gaps))
    return forces, flexible @ (right.getArray()[free] + jump[:, free].T @ forces), free


@pytest.mark.serial
@pytest.mark.parametrize("search", ["energy", "residual"])
def test_the_searches_find_the_one_equilibrium(search):
    """The energy is strictly convex: one equilibrium, which least squares find with the joints as unilateral springs."""
    forces, displacement, free = _contact_forces()
    model = prepare(load(SCENE, [*FREE, f"method.line_search={search}"]), MPI.COMM_SELF)
    stepping = Stepping(model)
    state, report = stepping.step(equilibrium_state(model), StepRequest(1.0, 1.0, {}, stepping.model.loads), Steady())
    found = state.motion.displacement.getArray()[free]
    assert report.newton <= 30
    assert np.abs(found - displacement).max() <= 1e-6 * np.abs(displacement).max()
    opening = state.sections.strain[:, -1]  # at the clamped end it is zero, neither open nor closed
    assert np.array_equal(opening < -1e-9 * np.abs(opening).max(), forces > 1e-9 * forces.max())
    assert 0 < state.sections.is_open.sum() < len(forces)
    stepping.destroy()


def test_the_default_ends_right_on_any_number_of_ranks(shared_tmp):
    history = _ran(shared_tmp / "run")
    assert history["step/dt"].tolist() == [0.0, 1.0]
    assert history["step/solid_residual"][-1] <= 1e-11
    assert 0 < history["step/open"][-1] < 22


@pytest.mark.serial
@pytest.mark.parametrize("stiff", [1.0, 1e2, 1e6])
def test_the_energy_search_finds_the_kink(stiff):
    """Power 1 - t up to 1/4, from there falling ``stiff`` times as fast: its root, or the whole step."""

    def power(t):
        return 1.0 - t - stiff * max(0.0, t - 0.25)

    found = by_energy(power, power(0.0), np.inf)
    root = (1.0 + 0.25 * stiff) / (1.0 + stiff)
    if power(1.0) >= -0.5:
        assert found == 1.0
    else:
        assert root - 0.1 <= found <= root + 1e-6
        assert abs(power(found)) <= 0.1 or found >= root
    assert by_energy(lambda t: -1.0, -1.0, 0.5) == 1.0


@pytest.mark.serial
def test_the_energy_search_stops_just_past_a_change():
    """A step too far is taken just past its first change, where the energy still falls; or less, where it no longer does."""
    past = 0.25 * (1.0 + 1e-6)
    assert by_energy(lambda t: 1.0 - 1e3 * max(0.0, t - 0.25), 1.0, past) == past
    assert by_energy(lambda t: 1.0 - 5.0 * max(0.0, t - 0.25), 1.0, past) == past  # its lowest energy is at 0.45
    assert by_energy(lambda t: 1.0 - t, 1.0, past) == 1.0
    found = by_energy(lambda t: 1.0 - 10.0 * t, 1.0, past)
    assert abs(found - 0.1) <= 0.01


@pytest.mark.serial
def test_the_residual_search_stops_just_past_a_change():
    """Whole step refused; just past the change is tried before the halves."""
    asked = []

    def size(t):
        asked.append(t)
        return abs(1.0 - t / 0.3) * 1.2 if t > 0.3 else 1.0 - t

    assert by_residual(size, 1.0, 0.3 * (1 + 1e-6)) == 0.3 * (1 + 1e-6)
    assert asked == [1.0, 0.3 * (1 + 1e-6)]
    assert by_residual(lambda t: abs(1.0 - 2.0 * t) + 0.1 * (t > 0.9), 1.0, np.inf) == 0.5
    assert by_residual(lambda t: 1.0 - 0.5 * t, 1.0, 0.1) == 1.0
    assert by_residual(lambda t: 1.0 + t, 1.0, np.inf) == pytest.approx(2.0**-13, abs=1e-3)
