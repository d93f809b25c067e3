"""Slip at a crossing with a fracture that slides: stress that is handed on, or the mesh?"""

from __future__ import annotations

import numpy as np
import pytest

import fracflow
from fracflow.mesh.store import load_mesh
from fracflow.output.events import read_events
from fracflow.output.slip_at_crossings import crossing_lines
from fracflow.remarks import bare
from fracflow.scene.scene import Scene

pytestmark = pytest.mark.serial

PLACE = (-8.75, 4.375)  # on B, 9.8 m from where A ends on it; a node of all meshes


def scene(size):
    """A slides from 7.34 MPa on and ends on B, which would from 14.6 MPa on."""
    return Scene.from_data({
        "rock": {"rock": {"youngs_modulus": 5e10, "poissons_ratio": 0.25, "density": 2700.0}},
        "fluid": {"viscosity": 1e-3, "density": 1e3, "initial_pressure": 5e6},
        "initial_stress": {"xx": -13e6, "yy": -25e6, "zz": -15e6},
        "support": [{"on": ["west", "east", "south", "north"]}],
        "stage": [{"kind": "quasi-static", "time_step": 2.0, "end": 26.0}],
        "geometry": {
            "domain": [-300, -300, 300, 300], "size": 100, "size_at_fractures": size, "snap": 0.3,
            "fracture": [{"name": "A", "points": [[-40.2, -69.6], [0, 0]]}, {"name": "B", "points": [[-70, 35], [70, -35]]}],
        },
        "fracture": {"default": {"normal_stiffness": 5e10, "shear_stiffness": 2e10, "aperture": 2e-4,
                                 "friction_coefficient": 0.6, "pressure": [[0.0, 7e6], [30.0, 13e6]]}},
        "output": {"pictures": False},
    })  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return {
        size: fracflow.run(scene(size), tmp_path_factory.mktemp("crossing") / f"{size:g}") for size in (10.0, 5.0, 2.5)
    }


def slips(run):
    return [event for event in read_events(run.folder / "events.csv") if event["kind"] == "slip"]


def test_slip_beside_a_crossing_is_stress_that_converges_and_its_first_time_is_not(runs):
    slip = [next(abs(e["slip"]) for e in slips(run) if np.allclose((e["x"], e["y"]), PLACE)) for run in runs.values()]
    change = np.abs(np.diff(slip))
    assert change[1] < 0.65 * change[0] and change[1] < 0.1 * slip[2], slip  # first order
    begins = [min(e["start"] for e in slips(run) if e["fracture"] == "B") for run in runs.values()]
    assert begins[2] < begins[0] < 0.5 * 5 * (14.6 - 7.0)  # long before its own strength, and earlier still


def test_where_slip_begins_by_a_neighbour_is_told_and_logged(runs):
    for run in runs.values():
        start = min(e["start"] for e in slips(run) if e["fracture"] == "B")
        line = f"slip that begins where another fracture slides: B beside A at (0, 0) from {start:g} s: the sliding one"
        assert any(bare(each).startswith(line) for each in (run.folder / "log.txt").read_text().splitlines())


def test_a_fracture_that_runs_at_once_or_first_is_not_told(runs):
    rows, mesh = slips(runs[10.0]), load_mesh(runs[10.0].folder / "mesh.h5")
    assert " from " in crossing_lines(rows, mesh, {})[0]
    assert crossing_lines([row for row in rows if row["fracture"] == "A"], mesh, {}) == []
    at_once = [{**row, "start": min(other["start"] for other in rows)} for row in rows]
    assert crossing_lines(at_once, mesh, {}) == []
