"""The catalogue as QuakeML, as ObsPy reads it, and against its schema."""

from __future__ import annotations

import math

import numpy as np
import obspy
import obspy.geodetics
import pytest
from obspy.io.quakeml.core import _validate
from stopped_run import SCENE, spoken

from fracflow.errors import InputError
from fracflow.output.events import columns_of
from fracflow.output.quakeml import export_quakeml, fault_plane, moment_tensor
from fracflow.scene.scene import load
from fracflow.scene.site import Site
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial
SITE = 'longitude = 11.0, latitude = 48.0, depth = "4 km", epoch = "2026-03-01T08:00:00+01:00"'
AUTO = SCENE.replace(
    'kind = "quasi-static", time_step = "6 h", end = "60 h"', 'kind = "auto", time_step = "6 h", end = "6 h"'
)
EVENT = {"kind": "event", "fracture": "Bruno", "x": 500.0, "y": 400.0, "start": 5400.5, "end": 5401.0, "slip": -2e-3}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run with a catalogue of one event, left-lateral on Bruno, which runs from (400, 600) to (600, 200)."""
    home = tmp_path_factory.mktemp("quakeml")
    (home / "scene.toml").write_text(
        f"site = {{{SITE}}}\n{AUTO}".replace("output = {", 'output = {event_length = "100 m", ')
    )
    run(load(home / "scene.toml"), home / "out")
    (home / "out/events.csv").write_text(table([{**EVENT, "moment": 3e9, "magnitude": 1.618}]))
    return home / "out"


def table(rows):
    node = 0
    heads = columns_of(1)
    texts = [",".join(str(row.get(head, node if head == "node" else 0.0 if head == "peak_slip_rate" else "")) for head in heads)
             for row in rows]  # fmt: skip
    return "\n".join([",".join(heads), *texts, ""])


def at_its_node(folder):
    """The number of the node at (500, 400) in events.csv."""
    from fracflow.mesh.store import load_mesh

    mesh = load_mesh(folder / "mesh.h5")
    node = int(mesh.origin[np.linalg.norm(mesh.points - [500.0, 400.0], axis=1).argmin()])
    text = (folder / "events.csv").read_text().splitlines()
    row = dict(zip(text[0].split(","), text[1].split(","), strict=True)) | {"node": str(node)}
    (folder / "events.csv").write_text("\n".join([text[0], ",".join(row.values()), ""]))


def test_obspy_reads_place_time_moment_and_plane(folder, tmp_path, monkeypatch, capfd):
    at_its_node(folder)
    file = tmp_path / "events.xml"
    code, said = spoken(["export", folder, "--quakeml", file], monkeypatch, capfd)
    assert not code and not said.startswith("fracflow:")
    assert _validate(str(file))
    (event,) = obspy.read_events(str(file))
    origin, magnitude, mechanism = (
        event.preferred_origin(),
        event.preferred_magnitude(),
        event.preferred_focal_mechanism(),
    )
    assert event.event_type == "induced or triggered event" and "Bruno" in event.event_descriptions[0].text
    assert origin.time == obspy.UTCDateTime("2026-03-01T08:30:00.5") and origin.depth == 4000.0
    east, north, _ = obspy.geodetics.gps2dist_azimuth(48.0, 11.0, origin.latitude, origin.longitude)
    assert east == pytest.approx(math.hypot(500.0, 400.0), rel=1e-3) and north == pytest.approx(51.34, abs=0.1)
    assert magnitude.mag == 1.618 and magnitude.magnitude_type == "Mw"
    tensor, plane = mechanism.moment_tensor, mechanism.nodal_planes.nodal_plane_1
    assert tensor.scalar_moment == pytest.approx(3e11)
    assert (plane.strike, plane.dip, plane.rake) == pytest.approx(
        (90.0 + math.degrees(math.atan2(400, 200)), 90.0, 0.0)
    )
    p = tensor.tensor
    whole = np.array([[p.m_rr, p.m_rt, p.m_rp], [p.m_rt, p.m_tt, p.m_tp], [p.m_rp, p.m_tp, p.m_pp]])
    assert np.linalg.norm(whole) / math.sqrt(2.0) == pytest.approx(3e11) and abs(np.trace(whole)) < 1.0


def place(plane, azimuth=90.0):
    return Site(longitude=0.0, latitude=0.0, azimuth=azimuth, plane=plane, epoch="2026-01-01T00:00:00Z")


@pytest.mark.parametrize(
    ("site", "along", "slip", "expected"),
    [
        (place("map"), (1, 0), 1.0, (90, 90, 180)),  # along east, the north side goes east: right-lateral
        (place("map"), (0, 1), -1.0, (0, 90, 0)),
        (place("map", 30.0), (1, 0), 1.0, (30, 90, 180)),
        (place("section"), (1, -1), 1.0, (0, 45, -90)),  # the upper side goes down to the east: normal
        (place("section"), (-1, 1), 1.0, (0, 45, -90)),  # the same, drawn from the other end
        (place("section"), (1, 1), 1.0, (180, 45, 90)),  # the upper side goes up to the east, on a plane that dips west
        (place("section"), (1, 1), -1.0, (180, 45, -90)),
        (place("section", 0.0), (1, -1), -1.0, (270, 45, 90)),
    ],
)
def test_planes_and_the_sense_of_slip(site, along, slip, expected):
    """The tensor is that of the walls' motion: u n + n u, in the axes of the Earth."""
    found = fault_plane(site, np.array(along, dtype=float), slip)
    assert (found.strike, found.dip, found.rake) == pytest.approx(expected)
    azimuth, s = math.radians(site.azimuth), np.array(along) / np.linalg.norm(along)
    x = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])  # north, east, down
    y = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0]) if site.plane == "map" else np.array([0.0, 0.0, -1.0])
    moved, normal = slip * (s[0] * x + s[1] * y), -s[1] * x + s[0] * y
    m = np.outer(moved, normal) + np.outer(normal, moved)
    mine = moment_tensor(found)
    theirs = {"Mrr": m[2, 2], "Mtt": m[0, 0], "Mpp": m[1, 1], "Mrt": m[0, 2], "Mrp": -m[1, 2], "Mtp": -m[0, 1]}
    assert mine == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("[site]", "[site_of_none]", "unknown|site"),
        ('epoch = "2026-03-01T08:00:00+01:00"', 'epoch = "2026-03-01"', "must be a time with its zone"),
        ("latitude = 48.0", "latitude = 148.0", "latitude"),
    ],
)
def test_a_site_that_is_none_is_one_line(folder, tmp_path, before, after, why):
    scene = (folder / "scene.toml").read_text()
    assert before in scene
    (tmp_path / "scene.toml").write_text(scene.replace(before, after))
    with pytest.raises(InputError, match=why):
        load(tmp_path / "scene.toml")


def test_a_run_without_a_site_says_what_to_add(tmp_path):
    (tmp_path / "scene.toml").write_text(AUTO)
    run(load(tmp_path / "scene.toml"), tmp_path / "out")
    with pytest.raises(InputError, match=r"no \[site\]: add to scene.toml: site = "):
        export_quakeml(tmp_path / "out", tmp_path / "events.xml")
