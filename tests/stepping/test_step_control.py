"""Steps as long as their error allows: the oscillator of 5.2 let go, and a quiet time after it."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

QUIET = "fracture.default.law=linear"  # u'' + u = P
END = 12.0


def _ran(folder, *overrides):
    """Times and displacements under a half sine of 2 for 2 s."""
    times = np.linspace(0.0, 2.0, 801)
    table = [[float(t), float(2.0 * np.sin(np.pi * t / 2.0))] for t in times] + [[END, 0.0]]
    given = ["output.pictures=false", QUIET, f"load.0.traction=[{table}, 0]", "stage.0.time_step=0.8", "stage.0.end=12"]
    run(load("meshes/report_5_2/scene.toml", [*given, *overrides]), folder, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    history = read_history(folder / "history.h5")
    return history["time"], history["probe/block/displacement"][:, 0], history


def _exact(t):
    """u'' + u = 2 sin(w t) to t = 2, free after."""
    w = np.pi / 2.0
    pushed = 2.0 / (1.0 - w**2) * (np.sin(w * t) - w * np.sin(t))
    u = 2.0 / (1.0 - w**2) * (np.sin(w * 2.0) - w * np.sin(2.0))
    v = 2.0 / (1.0 - w**2) * (w * np.cos(w * 2.0) - w * np.cos(2.0))
    return np.where(t < 2.0, pushed, u * np.cos(t - 2.0) + v * np.sin(t - 2.0))


@pytest.mark.serial
def test_error_follows_what_is_asked_for_and_steps_are_powers_of_two(shared_tmp):
    asked, found, counts = (1e-2, 1e-3, 1e-4), [], []
    for wanted in asked:
        time, moved, history = _ran(
            shared_tmp / str(wanted), f"accuracy.step_error={wanted}", "accuracy.max_halvings=12"
        )
        found.append(np.abs(moved - _exact(time)).max())
        counts.append(len(time))
        levels = np.log2(0.8 / history["step/dt"][1:])
        assert np.abs(levels - np.round(levels)).max() < 1e-9 and levels.max() > levels.min()
    assert found[2] < found[1] < found[0] and found[2] < 2e-2 * np.abs(_exact(np.linspace(0, END, 500))).max(), found
    # local errors fall with dt^3: a thousandth takes ten times the steps
    assert np.polyfit(np.log(asked), np.log(counts), 1)[0] == pytest.approx(-1 / 3, abs=0.1), counts


@pytest.mark.serial
@pytest.mark.parametrize("beta, gamma, order", [(1 / 6, 0.5, 2), (0.36, 0.7, 1)])
def test_error_follows_what_is_asked_for_whatever_beta_and_gamma(beta, gamma, order, shared_tmp):
    """A rule of order p has errors, and time steps, that fall with the power p/(p + 1), and 1/(p + 1), of what is asked."""
    asked, found, counts = (1e-2, 1e-3, 1e-4), [], []
    for wanted in asked:
        rule = (f"method.newmark_beta={beta}", f"method.newmark_gamma={gamma}")
        limits = (f"accuracy.step_error={wanted}", "accuracy.max_halvings=12")
        time, moved, _ = _ran(shared_tmp / str(wanted), *rule, *limits)
        found.append(np.abs(moved - _exact(time)).max() / np.abs(_exact(np.linspace(0, END, 500))).max())
        counts.append(len(time))
        assert found[-1] < counts[-1] * wanted, found  # errors add up
    assert np.polyfit(np.log(asked), np.log(counts), 1)[0] == pytest.approx(-1 / (order + 1), abs=0.1), counts
    assert np.polyfit(np.log(asked), np.log(found), 1)[0] == pytest.approx(order / (order + 1), abs=0.15), found


def test_an_error_that_is_never_reached_changes_nothing(shared_tmp):
    plain, free = _ran(shared_tmp / "plain"), _ran(shared_tmp / "free", "accuracy.step_error=0.999999")
    assert np.array_equal(plain[0], free[0]) and np.array_equal(plain[1], free[1])


@pytest.mark.parametrize("stepper", ["newmark", "generalised-alpha", "explicit"])
@pytest.mark.parametrize("error", [None, 1e-2, 1e-4])
def test_a_force_that_jumps_gives_its_impulse_however_steps_are_cut(shared_tmp, stepper, error):
    """1 from 0.87 to 2.03 s on a free mass of 1: 1.16 fast then, and 0.5 1.16^2 + 1.16 (4 - 2.03) away at 4 s."""
    table = '{time = [0, 0.87, 2.03], value = [0, 1, 0], interpolation = "step"}'
    given = ["output.pictures=false", QUIET, "fracture.default.shear_stiffness=1e-9", f"method.stepper={stepper}"]
    given += [f"load.0.traction=[{table}, 0]", "stage.0.time_step=0.4", "stage.0.end=4", "accuracy.max_halvings=8"]
    given += [] if error is None else [f"accuracy.step_error={error}"]
    run(load("meshes/report_5_2/scene.toml", given), shared_tmp / "out", MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    history = read_history(shared_tmp / "out" / "history.h5")
    assert history["probe/block/velocity"][-1, 0] == pytest.approx(1.16, rel=1e-7)
    assert history["probe/block/displacement"][-1, 0] == pytest.approx(0.5 * 1.16**2 + 1.16 * 1.97, rel=1e-7)
