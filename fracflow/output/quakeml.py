"""The catalogue of a run as QuakeML 1.2 BED (Schorlemmer et al. 2011), which ObsPy and other programs of seismology read.

An event has the origin where its fastest section slid as it began. Where the scene has output.event_length, it has its scalar
moment, its magnitude (Hanks and Kanamori 1979), and the moment tensor of a shear fault: the fracture there, and the sense of
its largest slip. Depth is in metres, downward positive, below sea level. Strike, dip and rake are those of Aki and Richards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from fracflow._version import __version__
from fracflow.errors import DiskError, InputError
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.mesh.store import load_mesh
from fracflow.output.events import read_events
from fracflow.output.folder import check_own, write_atomic
from fracflow.scene.scene import Scene, load
from fracflow.scene.site import Site, instant
from fracflow.storage.files import read_bytes
from fracflow.storage.sealed import digest

RADIUS, SQUARED_ECCENTRICITY = 6378137.0, 0.00669437999014  # of WGS 84, metres
BED = "http://quakeml.org/xmlns/bed/1.2"
OUTER = "http://quakeml.org/xmlns/quakeml/1.2"
NO_SITE = 'the scene has no [site]: add to scene.toml: site = {longitude = 0.0, latitude = 0.0, epoch = "2026-01-01T00:00:00Z"}'


@dataclass(frozen=True)
class Plane:
    """A fault plane and the direction in which its hanging wall slips [degrees]; Aki and Richards (2002), fig. 4.13."""

    strike: float
    dip: float
    rake: float


def fault_plane(site: Site, along: Floats, slip: float) -> Plane:
    """The plane of a fracture along (2,) that slips by ``slip``, top minus bottom.

    On a map fractures are vertical and slip is horizontal: positive slip is right-lateral. In a section it is along the dip.
    """
    x, y = along.tolist()
    if site.plane == "map":
        return Plane((site.azimuth - math.degrees(math.atan2(y, x))) % 360.0, 90.0, 180.0 if slip > 0.0 else 0.0)
    down = -1.0 if y > 0.0 else 1.0
    top_hangs = x > 0.0 or (x == 0.0 and y < 0.0)
    sinks = slip * down * (1.0 if top_hangs else -1.0) > 0.0  # the hanging wall, in the direction of dip
    dips_to = site.azimuth if down * x >= 0.0 else site.azimuth + 180.0
    return Plane((dips_to - 90.0) % 360.0, math.degrees(math.atan2(abs(y), abs(x))), -90.0 if sinks else 90.0)


def moment_tensor(plane: Plane) -> dict[str, float]:
    """Components for a scalar moment of 1: r up, t south, p east; Aki and Richards (2002), eq. 4.91 and box 4.4."""
    strike, dip, rake = (math.radians(angle) for angle in (plane.strike, plane.dip, plane.rake))
    along, up = math.cos(rake), math.sin(rake)
    xx = -math.sin(dip) * along * math.sin(2 * strike) - math.sin(2 * dip) * up * math.sin(strike) ** 2
    yy = math.sin(dip) * along * math.sin(2 * strike) - math.sin(2 * dip) * up * math.cos(strike) ** 2
    xy = math.sin(dip) * along * math.cos(2 * strike) + 0.5 * math.sin(2 * dip) * up * math.sin(2 * strike)
    xz = -math.cos(dip) * along * math.cos(strike) - math.cos(2 * dip) * up * math.sin(strike)
    yz = -math.cos(dip) * along * math.sin(strike) + math.cos(2 * dip) * up * math.cos(strike)
    return {"Mrr": math.sin(2 * dip) * up, "Mtt": xx, "Mpp": yy, "Mrt": xz, "Mrp": -yz, "Mtp": -xy}


def place(site: Site, x: float, y: float) -> tuple[float, float, float]:
    """Longitude and latitude [degrees], depth [m] of a place [m]; the ellipsoid is taken as flat around the origin."""
    azimuth, latitude = math.radians(site.azimuth), math.radians(site.latitude)
    up = y if site.plane == "section" else 0.0
    left = y if site.plane == "map" else 0.0
    east = x * math.sin(azimuth) - left * math.cos(azimuth)
    north = x * math.cos(azimuth) + left * math.sin(azimuth)
    part = 1.0 - SQUARED_ECCENTRICITY * math.sin(latitude) ** 2
    to_east = RADIUS / math.sqrt(part) * math.cos(latitude)
    to_north = RADIUS * (1.0 - SQUARED_ECCENTRICITY) / part**1.5
    return site.longitude + math.degrees(east / to_east), site.latitude + math.degrees(north / to_north), -up


def export_quakeml(folder: str | Path, file: str | Path) -> int:
    """Write the catalogue of a run as QuakeML and return the number of events.

    Raises InputError where the scene has no [site] or no units, is not of a plane, or has no catalogue; and DiskError.
    """
    folder = Path(folder)
    check_own(folder)
    rows = [row for row in read_events(folder / "events.csv") if row["kind"] == "event"]
    scene, mesh = load(folder / "scene.toml"), load_mesh(folder / "mesh.h5")
    if scene.site is None:
        raise InputError(f"{folder / 'scene.toml'}: {NO_SITE}")
    if scene.units == "none" or mesh.points.shape[1] != 2:
        raise InputError(f"{folder / 'scene.toml'}: QuakeML needs a plane scene with units; set units")
    if all(stage.kind != "auto" for stage in scene.stage):
        raise InputError(f'{folder}: has no catalogue; a stage of kind = "auto" makes one')
    run = digest(read_bytes(folder / "scene.toml", "name a run folder")).hex()[:8]
    root = ElementTree.Element("q:quakeml", {"xmlns": BED, "xmlns:q": OUTER})
    catalogue = ElementTree.SubElement(root, "eventParameters", publicID=f"smi:local/fracflow.{run}/catalogue")
    _add(catalogue, {"description": scene.title or scene.name})
    for number, row in enumerate(rows):
        _add_event(catalogue, f"smi:local/fracflow.{run}/event.{number}", scene, scene.site, mesh, row)
    ElementTree.indent(root)
    try:
        write_atomic(Path(file), f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n')
    except OSError as error:
        raise DiskError.of(error, file) from error
    return len(rows)


def _add_event(
    catalogue: ElementTree.Element, name: str, scene: Scene, site: Site, mesh: SplitMesh, row: Mapping[str, Any]
) -> None:
    units = scene.unit_system
    metre, second = units.to_si("length"), units.to_si("time")
    longitude, latitude, depth = place(site, row["x"] * metre, row["y"] * metre)
    try:
        time = instant(site.epoch) + timedelta(seconds=row["start"] * second)
    except OverflowError:
        raise InputError(
            f"{scene.source}: site.epoch: the event at time {row['start']:g} is after the year 9999"
        ) from None
    event = ElementTree.SubElement(catalogue, "event", publicID=name)
    about = f"on {row['fracture']}" + ("" if row["end"] is not None else ", under way")
    _add(event, {"preferredOriginID": f"{name}.origin", "type": "induced or triggered event"})
    _add(event, {"description": {"text": about, "type": "earthquake name"}})
    _add(
        event,
        {
            "origin": {
                "@publicID": f"{name}.origin",
                "time": {"value": time.strftime("%Y-%m-%dT%H:%M:%S.%fZ")},
                "longitude": {"value": longitude},
                "latitude": {"value": latitude},
                "depth": {"value": site.depth * metre + depth},
                "depthType": "other",
                "evaluationMode": "automatic",
                "creationInfo": {"author": f"fracflow {__version__}"},
            }
        },
    )
    if row["magnitude"] is None or scene.output.event_length is None:
        return
    plane = fault_plane(site, _along(mesh, row), row["slip"])
    moment = row["moment"] * scene.output.event_length * units.to_si("force*length")
    tensor = {key: {"value": moment * part} for key, part in moment_tensor(plane).items()}
    planes = {key: {"value": getattr(plane, key)} for key in ("strike", "dip", "rake")}
    _add(
        event,
        {
            "magnitude": {
                "@publicID": f"{name}.magnitude",
                "mag": {"value": row["magnitude"]},
                "type": "Mw",
                "originID": f"{name}.origin",
            },
            "focalMechanism": {
                "@publicID": f"{name}.mechanism",
                "triggeringOriginID": f"{name}.origin",
                "nodalPlanes": {"@preferredPlane": "1", "nodalPlane1": planes},
                "momentTensor": {
                    "@publicID": f"{name}.tensor",
                    "derivedOriginID": f"{name}.origin",
                    "momentMagnitudeID": f"{name}.magnitude",
                    "scalarMoment": {"value": moment},
                    "tensor": tensor,
                    "doubleCouple": 1.0,
                    "clvd": 0.0,
                },
            },
            "preferredMagnitudeID": f"{name}.magnitude",
            "preferredFocalMechanismID": f"{name}.mechanism",
        },
    )


def _along(mesh: SplitMesh, row: Mapping[str, Any]) -> Floats:
    """Direction (2,) of the fracture of an event where it began. Raises InputError."""
    if row["fracture"] in mesh.fractures:
        on = mesh.joint_fracture == mesh.fractures.index(row["fracture"])
        near = on & (mesh.origin[mesh.joint_bottom] == row["node"]).any(axis=1)
        if near.any():
            ends = mesh.points[mesh.joint_bottom[near]]
            return np.asarray((ends[:, 1] - ends[:, 0]).sum(axis=0))
    raise InputError(f'events.csv: an event on "{row["fracture"]}" at node {row["node"]}, which mesh.h5 has not')


def _add(parent: ElementTree.Element, entries: Mapping[str, Any]) -> None:
    """Elements by their names; ``@`` marks an attribute."""
    for key, value in entries.items():
        if key.startswith("@"):
            parent.set(key[1:], value)
            continue
        child = ElementTree.SubElement(parent, key)
        if isinstance(value, Mapping):
            _add(child, value)
        else:
            child.text = repr(float(value)) if isinstance(value, int | float) else value
