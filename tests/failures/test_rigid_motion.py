"""F9: k_n = 1e14 times a motion of 1000 that both walls share: refused by name, right at the stiffness named, or in steps."""

import re

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = "meshes/failures/rigid_motion/scene.toml"
EPS = np.finfo(float).eps
PROBES = 'probe=[{name = "left", at = [0, 0.5]}, {name = "middle", at = [0.5, 0.5]}]'


def _stiff(stiffness):
    return [f"fracture.seam.{part}_stiffness={stiffness}" for part in ("normal", "shear")]


def _ran(folder, *overrides):
    comm = MPI.COMM_WORLD
    run(load(SCENE, ["output.pictures=false", PROBES, *overrides]), folder, comm)
    history = comm.bcast(read_history(folder / "history.h5") if comm.rank == 0 else None)
    return history, max(np.abs(history[f"probe/{name}/normal_traction"][1:] + 1e6).max() for name in ("left", "middle"))


def test_refused_by_name_and_right_at_the_stiffness_named(shared_tmp):
    with pytest.raises(
        SolveError, match=r"tractions of seam .* keep 4\.7 digits, accuracy\.digits asks for 6"
    ) as caught:
        run(load(SCENE, ["output.pictures=false"]), shared_tmp / "refused", MPI.COMM_WORLD)
    assert -np.log10(EPS * 1e14 * 1e3 / 1e6) == pytest.approx(4.65, abs=0.01)
    found = re.search(r"shear_stiffness, 1e\+14 .* a stiffness of ([\d.e+]+) would do", str(caught.value))
    assert found
    enough = float(found[1])
    assert enough == pytest.approx(
        0.5 * 1e6 * 1e-6 / (EPS * 1e3), rel=0.03
    )  # with a margin, to be right as it is printed
    history, error = _ran(shared_tmp / "right", *_stiff(enough))
    assert error <= 10 * EPS * enough * 1e3 and error <= 1e6 * 1e-5
    assert 6.2 <= history["step/digits"][1] < 6.4
    assert (
        0.0 < history["step/round_off"][1] <= 20.0 * 10.0 ** -history["step/digits"][1]
    )  # no more is let pass than is lost


def test_right_in_steps_where_one_step_is_refused(shared_tmp):
    stiff = _stiff(1e13)
    with pytest.raises(SolveError, match=r"seam .* keep 5\.7 digits"):
        run(load(SCENE, ["output.pictures=false", *stiff]), shared_tmp / "refused", MPI.COMM_WORLD)
    history, error = _ran(shared_tmp / "steps", *stiff, "stage.push.time_step=0.05")
    assert error <= EPS * 1e13 * 1e3  # of all of the motion at once
    assert error <= 10 * EPS * 1e13 * 1e3 / np.sqrt(20)
    assert 6.0 < history["step/digits"][-1] < 6.5


def test_as_few_digits_as_the_scene_asks_for(shared_tmp):
    history, error = _ran(shared_tmp / "run", "accuracy.digits=4")
    assert error <= 10 * EPS * 1e14 * 1e3
    assert history["step/digits"][1] == pytest.approx(4.65, abs=0.01)


def test_in_soft_joints_it_is_the_rock_that_takes_the_digits(shared_tmp):
    with pytest.raises(SolveError, match=r"seam .* the rock's stiffness E/h = .* counted from where it is now"):
        run(
            load(SCENE, ["output.pictures=false", *_stiff(1e9), "accuracy.digits=12"]),
            shared_tmp / "run",
            MPI.COMM_WORLD,
        )


def test_a_nearly_closed_joint_keeps_the_digits_of_its_gap(shared_tmp):
    """k_n0 d_0 = 10 kPa under 1 GPa leaves a gap of 5e-11 m, and both walls move by 3 m."""
    tight = {"law": "hyperbolic-coulomb", "normal_stiffness": 2e9, "shear_stiffness": 1e9, "aperture": 5e-6}
    settings = [f"fracture.seam.{key}={value}" for key, value in (tight | {"friction_coefficient": 0.6}).items()]
    settings += ["rock.rock.youngs_modulus=1e11", "load.0.traction=[0, -1e9]"]
    settings += ["support.0.displacement.y=[[0, 0], [1, 3]]"]
    history, _ = _ran(shared_tmp / "run", *settings)
    assert 2e9 * 5e-6 * 1e-5 * EPS * 3 / 5e-11**2 > 1e-6 * 1e9  # by displacements fewer than 6 digits are left
    for name in ("left", "middle"):
        assert history[f"probe/{name}/normal_traction"][-1] == pytest.approx(-1e9, rel=1e-9)
    assert history["step/digits"][-1] > 9.0
    rounded = (
        4 * EPS * 1e11 * 3.0**2
    )  # work of what rounds off in the rock's forces E u, over u; net works are 1e-3 of theirs
    assert np.abs(history["energy/residual"]).max() <= rounded
