"""A cut-out of meshes/mapped_network: three of its traces with friction of rate and state, up to the first event."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from _launch import without_ranks

from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = Path("meshes/mapped_network/scene.toml")
TRACES = {"1", "4", "24"}  # with the injector, crossed by it, and with two of the other wells
OTHERS = ("out5", "out6", "out8", "far29", "far12")  # wells and probes on traces left out
SHORT = [
    "output.pictures=false", "output.vtkhdf=false", "geometry.domain=[200, 0, 450, 350]", "stage.days.time_step=5 min",
    "stage.days.end=4 min", "stage.days.dynamic_time_step=12 ms",
]  # fmt: skip
OF_TRACE, OF_WHOLE = np.hypot(87.312806, 158.0887), 2.4e10  # length [m]; moment of the first event of the scene [N m/m]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    home = tmp_path_factory.mktemp("cut_out")
    scene = [line for line in SCENE.read_text().splitlines() if not any(f'"{name}"' in line for name in OTHERS)]
    (home / "scene.toml").write_text("\n".join(scene))
    head, *rows = (SCENE.parent / "traces.csv").read_text().splitlines()
    (home / "traces.csv").write_text("\n".join([head, *(row for row in rows if row.split(",")[0] in TRACES)]))
    run(load(home / "scene.toml", SHORT), home / "one")
    return home


def event_of(folder):
    (event,) = [row for row in read_events(folder / "events.csv") if row["kind"] == "event"]
    return event


pytestmark = pytest.mark.serial


def test_injection_sets_off_an_event_on_its_trace(folder):
    event, kept = event_of(folder / "one"), read_history(folder / "one" / "history.h5")
    assert event["fracture"] == "1" and event["moment"] == pytest.approx(OF_WHOLE, rel=0.05)
    assert 0.9 * OF_TRACE < event["length"] < OF_TRACE, "the rest creeps meanwhile"
    assert {1, 2} <= {*kept["step/kind"]} and kept["step/kind"][-1] == 1, "minutes, an event with inertia, and minutes"
    assert np.abs(kept["energy/residual"]).max() <= 1e-10 * kept["energy/friction"].max()


@pytest.mark.starts_ranks
def test_two_ranks_have_the_same_catalogue(folder):
    clean = without_ranks()
    words = [sys.executable, "-m", "fracflow", "run", str(folder / "scene.toml"), "-o", str(folder / "two")]
    sets = [word for each in SHORT for word in ("--set", each)]
    subprocess.run(["mpirun", "-n", "2", *words, *sets], check=True, capture_output=True, env=clean, timeout=300)
    one, two = event_of(folder / "one"), event_of(folder / "two")
    assert (two["fracture"], two["start"]) == (one["fracture"], one["start"])
    for key in ("slip", "length", "moment", "magnitude", "dissipated", "radiated"):
        assert two[key] == pytest.approx(one[key], rel=1e-6), key
