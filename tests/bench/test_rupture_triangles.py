"""`scripts/bench rupture_triangles`: its scenes are those of meshes/rupture on other meshes; a missed bar is told."""

import numpy as np
import pytest
import rupture_triangles as bench

from fracflow.scene.scene import load

pytestmark = pytest.mark.serial


def test_scenes_differ_from_the_rupture_in_mesh_and_probes_alone(tmp_path):
    own = load(bench.SCENE / "scene.toml").model_dump(exclude={"mesh", "geometry", "probe"})
    even = load(bench.quadrilaterals(tmp_path / "even", 250.0))
    uneven = load(bench.triangles(tmp_path / "uneven", 200.0, 0.2))
    for scene in (even, uneven):
        assert scene.model_dump(exclude={"mesh", "geometry", "probe"}) == own
        assert [probe.at[0] for probe in scene.probe] == [1e3 * x for x in bench.PLACES]
    assert "h = 250;" in (tmp_path / "even" / "fault.geo").read_text()
    assert (uneven.geometry.size, uneven.geometry.size_at_fractures, uneven.geometry.growth) == (1200.0, 200.0, 0.2)


def test_a_missed_bar_is_told():
    right = np.full(7, 4.0)
    good = bench.Found(right * 1.009, 0.009, 0.029, 1e-12, 1.0)
    assert all(check.ok for check in bench.checks([50.0], [good], right, [1.4]))
    bad = bench.Found(right * 0.989, 0.011, 0.031, 1e-9, 1.0)
    assert not any(check.ok for check in bench.checks([50.0], [bad], right, [1.39]))
