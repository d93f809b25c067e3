"""A rate-dependent law from outside the package: exact steady states at the level of the law, and whole runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from laws.rate_and_state import RateAndState, steady_friction

from fracflow.laws import JOINT_LAWS, LawStep

pytestmark = pytest.mark.serial

F_N, SLOW, FAST, D_C = 1e6, 1e-6, 1e-5, 1e-5
LAW = RateAndState(
    normal_stiffness=2e10,
    shear_stiffness=5e10,
    aperture=1e-3,
    friction_coefficient=0.6,
    direct_effect=0.010,
    evolution_effect=0.015,
    state_distance=D_C,
    reference_rate=SLOW,
    initial_state=D_C / SLOW,
    initial_normal_traction=-F_N,
    initial_shear_traction=0.6 * F_N,
)


def driven(law, history, slip, rates, dt, dim=2):
    """Tractions and histories while a section is driven at these rates, a step of length dt each."""
    responses = []
    for rate in rates:
        slip = slip + rate * dt
        strain = np.zeros((1, dim))
        strain[:, 0] = slip
        responses.append(law.evaluate(strain, history, LawStep(dt=dt)))
        history = responses[-1].history
    return responses, slip


def test_steady_state_after_a_step_of_the_rate():
    """f0 + (a - b) ln(V/V0) before and after, and between them a ln(V2/V1) at once: exact but for the spring."""
    slow, slip = driven(LAW, LAW.initial_history(1, 2), 0.0, [SLOW] * 40, 0.1 * D_C / SLOW)
    assert slow[-1].traction[0, 0] / F_N == pytest.approx(steady_friction(LAW, SLOW), rel=1e-9)
    fast, slip = driven(LAW, slow[-1].history, slip, [FAST] * 200, 0.01 * D_C / FAST)
    fast += driven(LAW, fast[-1].history, slip, [FAST] * 220, 0.1 * D_C / FAST)[0]
    frictions = np.array([each.traction[0, 0] / F_N for each in fast])
    assert frictions[-1] == pytest.approx(steady_friction(LAW, FAST), rel=1e-9)
    assert fast[-1].history["age"][0] == pytest.approx(D_C / FAST, rel=1e-9)
    peak = steady_friction(LAW, SLOW) + LAW.direct_effect * np.log(FAST / SLOW)
    assert peak - 0.004 < frictions.max() < peak, "the direct effect, less what evolves while the spring is loaded"


def test_contacts_age_while_nothing_slips():
    held, _ = driven(LAW, LAW.initial_history(1, 2), -1e-3, [0.0], 1e3)
    freed = LAW.evaluate(np.array([[-1.2e-5, 0.0]]), LAW.initial_history(1, 2), LawStep(dt=1e3))
    assert freed.history["age"][0] == pytest.approx(D_C / SLOW + 1e3, rel=1e-6)
    assert held[0].traction[0, 0] < 0.0, "it slips the other way where it is driven there"


@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_is_the_derivative(dim):
    rng, step = np.random.default_rng(1), 1e-11
    strain = rng.uniform(-2e-5, 2e-5, (60, dim))
    strain[:, 0] += 1e-5
    history, ahead = LAW.initial_history(60, dim), LawStep(dt=1.0)
    response = LAW.evaluate(strain, history, ahead)
    assert (np.linalg.norm(response.inelastic, axis=1) > 0.0).all()
    for column in range(dim):
        move = np.zeros(dim)
        move[column] = step
        after, before = (LAW.evaluate(strain + sign * move, history, ahead).traction for sign in (1.0, -1.0))
        assert np.allclose((after - before) / (2.0 * step), response.tangent[:, :, column], rtol=1e-4, atol=2e5)


def test_at_once_nothing_slips():
    strain, history = np.array([[1e-3, 0.0]]), LAW.initial_history(1, 2)
    response = LAW.evaluate(strain, history, LawStep(dt=0.0))
    assert response.traction[0, 0] == pytest.approx(0.6 * F_N + 5e10 * 1e-3)
    assert all(np.array_equal(response.history[name], history[name]) for name in history)


SLIDER = """
[output]
pictures = false
checkpoint_every = 1
[geometry]
domain = [0, 0, 2, 2]
size = 1
cells = "quads"
fracture = [{name = "seam", points = [[0, 1], [2, 1]]}]
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0
density = 2700
[initial_stress]
yy = "-1 MPa"
xy = "0.6 MPa"
[fracture.seam]
law = "outside-rate"
normal_stiffness = "20 GPa/m"
shear_stiffness = "50 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.6
direct_effect = 0.010
evolution_effect = 0.015
state_distance = "1 mm"
reference_rate = "1e-6 m/s"
initial_state = "1000 s"
[[support]]
on = "south"
[[support]]
on = "north"
displacement = {x = [[0, 0], [200, 2e-4], [4200, 4.02e-2]], y = 0}
[[tie]]
on = ["west", "east"]
[[probe]]
name = "middle"
at = [1, 1]
on = "seam"
[[stage]]
kind = "quasi-static"
time_step = 100
steps = 26
[[stage]]
kind = "dynamic"
time_step = 1e-3
steps = 4
"""
CUT = 9


def whole_and_cut(folder: Path) -> None:
    """Run the slider, and run it again with a stop after which it is resumed. In a process of its own."""
    JOINT_LAWS["outside-rate"] = RateAndState
    from fracflow._petsc import MPI
    from fracflow.scene.scene import load
    from fracflow.simulation.run import resume, run

    (folder / "scene.toml").write_text(SLIDER, encoding="utf-8")
    scene, left = load(folder / "scene.toml"), [CUT]

    def stop(step: object) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    run(scene, folder / "whole", MPI.COMM_WORLD)
    with pytest.raises(KeyboardInterrupt):
        run(scene, folder / "cut", MPI.COMM_WORLD, stop)
    resume(folder / "cut", MPI.COMM_WORLD)


@pytest.fixture(scope="module")
def slid(tmp_path_factory):
    """Folder of both runs of the slider; the law is known to the process that made them only."""
    folder = tmp_path_factory.mktemp("slider")
    tests = str(Path(__file__).parents[1])
    call = (
        f"import sys; sys.path.insert(0, {tests!r}); from pathlib import Path; import laws.test_rate_and_state as t; "
    )
    subprocess.run([sys.executable, "-c", call + f"t.whole_and_cut(Path({str(folder)!r}))"], check=True)
    assert "outside-rate" not in JOINT_LAWS
    return folder


def history_of(folder):
    from fracflow.output import read_history

    return read_history(folder / "history.h5")


def test_a_slider_comes_to_the_steady_states_of_its_rates(slid):
    history = history_of(slid / "whole")
    friction = history["probe/middle/shear_traction"] / 1e6
    assert friction[:3] == pytest.approx(0.6, rel=1e-9), "in steady state at V0"
    assert friction[26] == pytest.approx(steady_friction(LAW, FAST), rel=1e-8)
    assert friction.max() > 0.605, "the direct effect"
    assert history["step/kind"][-1] == 2 and np.abs(friction[-1] - friction[26]) < 1e-3, "with inertia too"


def test_its_energy_closes(slid):
    history = history_of(slid / "whole")
    largest = max(np.abs(values).max() for name, values in history.items() if name.startswith("energy/"))
    assert np.abs(history["energy/residual"]).max() <= 1e-10 * largest
    slip, traction = history["probe/middle/plastic_slip"], history["probe/middle/shear_traction"]
    work = 2.0 * float(np.sum(0.5 * (traction[1:] + traction[:-1]) * np.diff(slip)))  # over a seam 2 m long
    assert history["energy/friction"][-1] == pytest.approx(work, rel=1e-9) and work > 0.9 * largest


def test_its_history_is_kept_and_a_cut_run_ends_as_the_whole_one(slid):
    from fracflow.output.checkpoint import read_arrays

    one, other = (history_of(slid / name) for name in ("whole", "cut"))
    assert one.keys() == other.keys()
    assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in one)
    state, same = (read_arrays(slid / name / "checkpoint.h5")["past/0/age"] for name in ("whole", "cut"))
    assert np.array_equal(state, same) and state == pytest.approx(D_C * 100 / FAST, rel=1e-3)


def test_its_history_is_published_by_itself(slid):
    """In probes at every step, and in the fields of fractures; nothing else says so than the law."""
    from fracflow.output import list_steps, read_step

    _, point, cell = read_step(list_steps(slid / "whole", "fractures")[-1][1])
    assert {**point, **cell}["age"] == pytest.approx(D_C * 100 / FAST, rel=1e-3)
    probed = history_of(slid / "whole")["probe/middle/age"]
    assert probed[0] == pytest.approx(1000.0, rel=1e-12) and probed[26] == pytest.approx(D_C * 100 / FAST, rel=1e-3)
