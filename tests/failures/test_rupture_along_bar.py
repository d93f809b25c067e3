"""F5b: the load at which slip runs away along a bar: where strength drops at once the mesh decides, and the card says so."""

import json

import pytest
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.cli.app import app
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial
SCENE = "meshes/failures/rupture_along_bar/scene.toml"
WEAKENS = (
    "fracture.bed={law = 'slip-weakening', normal_stiffness = 1, shear_stiffness = 400, aperture = 10,"
    " friction_coefficient = {along = [0, 3.999, 4, 24], value = [0.6, 0.6, 1, 1]},"
    " dynamic_friction_coefficient = 0.6, slip_weakening_distance = 0.4}"
)


def _runs_away(folder, mesh, excess, *overrides):
    """Whether slip passes x = 12 where S = (strength - tau_0)/(tau_0 - 0.6) is ``excess``."""
    over = 0.4 / (1.0 + excess)
    overrides += ("method.events=at-step-ends",)  # hundreds of them, and the threshold does not hang on their instants
    at_once = [f"load.1.traction=[[[0, 0], [1, {over}]], 0]", f"load.2.traction=[[[1, 0], [1.001, {over}]], 0]"]
    settings = [f"mesh.file={mesh}.geo", "output.pictures=false", "stage.run.time_step=0.1", *at_once, *overrides]
    run(load(SCENE, settings), folder / f"{mesh}{excess}", MPI.COMM_WORLD)
    return read_history(folder / f"{mesh}{excess}" / "history.h5")["probe/ahead/plastic_slip"][-1] > 0.0


def test_a_drop_at_once_runs_as_far_as_the_mesh_lets_it(shared_tmp):
    """Published thresholds: S = 6.88 at h = 1, 14.98 at h = 0.5."""
    assert not _runs_away(shared_tmp, "coarse", 9.0)
    assert _runs_away(shared_tmp, "fine", 11.0)


@pytest.mark.parametrize("mesh", ["fine", "finer"])
def test_weakening_with_slip_has_a_threshold_of_its_own(shared_tmp, mesh):
    """Published: S = 4.90 at h = 0.5, 5.14 at h = 0.25, 5.23 at h = 1/16."""
    assert _runs_away(shared_tmp, mesh, 4.6, WEAKENS, "stage.run.end=23")
    assert not _runs_away(shared_tmp, mesh, 5.5, WEAKENS, "stage.run.end=23")


def _card(*settings):
    words = [word for setting in settings for word in ("--set", setting)]
    numbers = json.loads(CliRunner().invoke(app, ["check", SCENE, "--json", *words]).output)["card"]
    return {number["name"]: number for number in numbers}


def test_the_card_warns_and_says_what_to_do():
    """l = sqrt(E D/k_s) = 0.05; with D_c = 0.4 the length sqrt(E D D_c/dtau) is 1, at S = 5.5 as at any other."""
    for mesh, size in (("coarse", 1.0), ("fine", 0.5)):
        card = _card(f"mesh.file={mesh}.geo")
        assert card["joint length scale"]["value"] == pytest.approx(size / 0.05)
        assert card["joint length scale"]["out_of_range"] and card["joint length scale"]["where"] == "bed"
        assert card["joint length scale"]["limit"] == 0.25
        assert "joints shorter than 0.0125" in card["joint length scale"]["remedy"]
        # 4 joints in sqrt(E D D_c/dtau), E D = 1, dtau = 0.4
        assert f"slip_weakening_distance above {0.4 * (4 * size) ** 2:.2g}" in card["joint length scale"]["remedy"]
        assert card["nucleation length"]["out_of_range"]
    for mesh, size, distance in (("coarse", 1.0, 0.4), ("finer", 0.25, 0.41)):
        card = _card(f"mesh.file={mesh}.geo", WEAKENS, f"fracture.bed.slip_weakening_distance={distance}")
        zone = (distance / 0.4) ** 0.5
        assert card["cohesive zone"]["value"] == pytest.approx(zone / size)
        assert card["cohesive zone"]["out_of_range"] == (zone / size < 4)
        assert card["nucleation length"]["value"] == pytest.approx(3.1416 * zone, rel=1e-4)
        assert card["nucleation length"]["limit"] == pytest.approx(5 * size)
        assert not card["joint length scale"]["out_of_range"]
    remedy = _card("mesh.file=coarse.geo", WEAKENS)["cohesive zone"]["remedy"]
    assert "joints shorter than 0.25," in remedy and "slip_weakening_distance above 6.4" in remedy
