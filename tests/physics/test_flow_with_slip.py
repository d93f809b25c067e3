"""A conductance that grows with slip: with a key of its own from outside, and by what a joint law remembers."""

import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.laws import FLOW_LAWS
from fracflow.laws.base import key
from fracflow.laws.cubic_flow import ExactCubic
from fracflow.output import read_history
from fracflow.scene.laws import FLOW_KEYS, check_flow

from .rough_walls import RoughWalls
from .test_dilation import SCENE

SHARE = 0.2
STEADY = SCENE.replace("KIND", "steady").replace(
    'law = "linear"', 'law = "hyperbolic-coulomb"\nfriction_angle_deg = 20'
)


class OpensBySlip(ExactCubic):
    """Rough walls without a key of their own, in the place of a law that scenes know."""

    rides_up, knows_slip, hydraulic = SHARE, True, RoughWalls.hydraulic


class OpensByPlasticSlip(ExactCubic):
    """The same by what the joint law remembers."""

    reads: ClassVar = ("plastic_slip",)

    def hydraulic(self, opening, slip, history, step):
        aperture, by_opening, _ = super().hydraulic(opening, slip, history, step)
        return aperture + SHARE * np.linalg.norm(history["plastic_slip"], axis=2), by_opening, None


@pytest.mark.parametrize("law, slip", [(OpensBySlip, "slip"), (OpensByPlasticSlip, "plastic_slip")])
def test_conductance_grows_with_slip(run_scene, monkeypatch, law, slip):
    monkeypatch.setitem(FLOW_LAWS, "front", law)
    found = run_scene(STEADY)
    if MPI.COMM_WORLD.rank:
        return
    ends = found.fields["fractures"]
    wide = ends["aperture"] + SHARE * np.abs(ends[slip])
    assert wide.max() > 1.1 * ends["aperture"].max(), "it slips by as much as it is wide"
    flow = found.probe("middle", "flow_rate")[-1] * 12e-3 * 2.0 / 1e5
    assert wide.min() ** 3 < flow < wide.max() ** 3
    assert found.closes()


@pytest.mark.serial
def test_its_key_is_read_where_a_scene_chooses_it(tmp_path, run_scene, monkeypatch):
    text = (
        STEADY.replace('aperture = "1 mm"', f'aperture = "1 mm"\nrides_up = {SHARE}')
        + '[method]\nconductance = "rough"\n'
    )
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    law = Path(__file__).with_name("rough_walls.py")
    subprocess.run([sys.executable, law, "run", tmp_path / "scene.toml", "-o", tmp_path / "out"], check=True)
    monkeypatch.setitem(FLOW_LAWS, "front", OpensBySlip)
    same, rate = run_scene(STEADY), read_history(tmp_path / "out" / "history.h5")["probe/middle/flow_rate"]
    assert rate == pytest.approx(same.probe("middle", "flow_rate"), rel=1e-9) and rate[-1] > 0.0


@pytest.mark.serial
def test_its_key_belongs_to_its_scenes_only(monkeypatch):
    monkeypatch.setitem(FLOW_LAWS, "rough", RoughWalls)
    monkeypatch.setitem(FLOW_KEYS, "rough", {"rides_up": key("")["key"]})
    assert not list(check_flow("rough", {"rides_up": 0.1})) and not list(check_flow("exact", {"rides_up": None}))
    ((name, why),) = check_flow("exact", {"rides_up": 0.1})
    assert name == "rides_up" and '"rough"' in why
