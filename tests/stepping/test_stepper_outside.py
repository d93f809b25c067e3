"""An integrator that only the tests have, registered from outside the package: its order, its key, and resumed runs of it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from fracflow.integrators import STEPPERS, Alphas, HasMotion, Stepper
from fracflow.integrators.newmark import error_by_jerk, newmark_alphas, weighed
from fracflow.integrators.parameters import check_parameters, parameter

pytestmark = pytest.mark.serial
TESTS = Path(__file__).parents[1]


@dataclass(frozen=True)
class Bossak(Stepper):
    """M ((1 - alpha) a_new + alpha a) + S_new = 0 (Wood, Bossak and Zienkiewicz 1981), second order."""

    alpha: float = parameter(-0.1, "bossak_alpha", "alpha of bossak [1]", at_least=-1.0 / 3.0, at_most=0.0)

    order: ClassVar[int] = 2
    damps: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_parameters(self)

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        motion = newmark_alphas(time_step, (1.0 - self.alpha) ** 2 / 4.0, 0.5 - self.alpha)
        return weighed(motion, of_inertia=self.alpha, of_forces=0.0)

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        return error_by_jerk((1.0 - self.alpha) ** 2 / 4.0 - 1.0 / 6.0, time_step, old, new)


def whole_and_cut(folder: Path) -> None:
    """Scenes of a dynamic stage and of a stage auto, each run whole, and stopped and resumed. In a process of its own."""
    STEPPERS["bossak"] = Bossak
    from physics.test_books import CRACK, DYNAMIC, QUASI

    from fracflow._petsc import MPI
    from fracflow.scene.scene import load
    from fracflow.simulation.run import resume, run

    (folder / "dynamic.toml").write_text(CRACK + QUASI + DYNAMIC, encoding="utf-8")
    two_modes = TESTS.parent / "meshes" / "failures" / "two_modes" / "scene.toml"
    short = ["stage.push.end=430", "stage.push.dynamic_time_step=0.5", "stage.push.at_rest=0.1"]
    given = ["method.stepper=bossak", "method.bossak_alpha=-0.2", "output.pictures=false", "output.checkpoint_every=1"]
    for name, path, sets, cut in (("dynamic", folder / "dynamic.toml", [], 7), ("auto", two_modes, short, 30)):
        scene, left = load(path, [*given, *sets]), [cut]

        def stop(step: object, left: list[int] = left) -> None:
            left[0] -= 1
            if left[0] == 0:
                raise KeyboardInterrupt

        run(scene, folder / f"{name}-whole", MPI.COMM_WORLD)
        with pytest.raises(KeyboardInterrupt):
            run(scene, folder / f"{name}-cut", MPI.COMM_WORLD, stop)
        resume(folder / f"{name}-cut", MPI.COMM_WORLD)


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    """Folder of the runs; the rule is known to the process that made them only."""
    folder = tmp_path_factory.mktemp("bossak")
    call = f"import sys; sys.path[:0] = {[str(TESTS), str(TESTS.parent / 'scripts')]!r}; from pathlib import Path; "
    call += f"import stepping.test_stepper_outside as t; t.whole_and_cut(Path({str(folder)!r}))"
    subprocess.run([sys.executable, "-c", call], check=True)
    assert "bossak" not in STEPPERS
    return folder


@pytest.mark.parametrize("name", ["dynamic", "auto"])
def test_runs_close_their_energy_and_are_resumed_to_the_bit(stepped, name):
    from fracflow.output import read_history

    whole, cut = (read_history(stepped / f"{name}-{kind}" / "history.h5") for kind in ("whole", "cut"))
    assert {1, 2} == set(whole["step/kind"]) and len(whole["time"]) > 8
    assert [
        k for k in whole if k != "step/factorisations" and not np.array_equal(whole[k], cut[k], equal_nan=True)
    ] == []
    size = max(np.abs(values).max() for key, values in whole.items() if key.startswith("energy/"))
    assert np.abs(whole["energy/residual"]).max() < 1e-10 * size
    assert whole["energy/kinetic"].max() > 0.0


def test_it_is_of_second_order_and_damps():
    from stepping.test_steppers import Motion, advance, amplification, order_of

    errors = []
    for steps in (40, 80, 160, 320):
        motion = Motion(1.0, 0.0, -1.0)
        for _ in range(steps):
            motion = advance(Bossak(), motion, 3.0 / steps, 1.0, 0.0, 1.0)
        errors.append(abs(motion.displacement - np.cos(3.0)))
    assert order_of(errors) == pytest.approx(2, abs=0.05)
    assert np.abs(np.linalg.eigvals(amplification(Bossak(), 1e5))).max() < 0.99
