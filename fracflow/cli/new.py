"""A first scene, written with comments: of three fractures, or of a user's own traces or mesh."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

import numpy as np

from fracflow.errors import DiskError, InputError
from fracflow.mesh.facets import outer_besides, spot
from fracflow.mesh.interpret import EVERY
from fracflow.mesh.read import network_of, read_mesh
from fracflow.model.setup import geometry_of
from fracflow.remarks import digits
from fracflow.scene.geometry import read_traces
from fracflow.scene.scene import Scene
from fracflow.scene.toml import parse_toml, write_key, write_value
from fracflow.scene.unusual import degrees
from fracflow.storage.files import create_text, read_text, shown_plain

MARGIN = 1.0  # of the larger extent of traces, from them to the sides, which change their slip by a tenth at most
CELLS, CELLS_AT_FRACTURES, PER_FRACTURE = 12, 80, 6  # along the domain, there at fractures, and along a usual one
MOST_JOINTS = 2000
RATE = 5e-4  # pumped into a domain of a kilometre [L/s per m]
MOST_NAMED = 20  # names in a comment


@dataclass(frozen=True)
class SceneParts:
    """The parts of a new scene: its tables of geometry or mesh as text, and names in it.

    extent     of the larger side of the domain [length]
    fractures  names, the longest first
    """

    text: str
    extent: float
    fractures: Sequence[str]
    rocks: Sequence[str] = ("rock",)
    sides: Sequence[str] = ("west", "east", "south", "north")


FIRST = SceneParts(
    """[geometry] # x to the right, y upward [m]
domain = [-600, -700, 1700, 1300] # xmin, ymin, xmax, ymax; the sides are called west, south, east, north
size = 200 # of cells away from fractures; leave both sizes out, and they follow from the scene
size_at_fractures = 25

[[geometry.fracture]] # or all of them in a table: fractures_csv = "traces.csv" in [geometry]
name = "Anna"
points = [[200, 120], [340, 320], [830, 530]]

[[geometry.fracture]]
name = "Bruno"
points = [[430, 680], [640, 200]]

[[geometry.fracture]]
name = "Clara"
points = [[600, 540], [900, 380]]
""",
    2000.0,
    ("Anna", "Bruno", "Clara"),
)
SCENE = Path(__file__).with_name("first_scene.toml")
"""A scene with places for names and sizes."""


def write_scene(where: Path, traces: Path | None = None, mesh: Path | None = None, trust: bool = False) -> Path:
    """Write a scene, into ``where``/scene.toml unless that is a .toml itself; the path of the file.

    traces  a table of traces that it is of, read as ``geometry.fractures_csv`` is
    mesh    a mesh or geometry file that it is of; a .geo from whoever is trusted, with ``trust``

    A file that is there stays as it is. Raises InputError for it, and for traces and meshes that make no scene, and DiskError.
    """
    path = where if where.suffix == ".toml" else where / "scene.toml"
    if traces is not None and mesh is not None:
        raise InputError("new: --traces and --mesh: give one of them; traces are meshed by the program")
    if os.path.lexists(path):
        raise InputError(f"{path}: is there already, and is not written over; name another file or folder")
    parts = FIRST if traces is None else _of_traces(traces, path)
    parts = parts if mesh is None else _of_mesh(mesh, path, trust)
    text = _text(parts, path)
    scene = Scene.from_data(parse_toml(text, path), path)  # says at once what of the traces or the mesh fits no scene
    for line in degrees(scene):
        warnings.warn(line, stacklevel=2)
    if scene.geometry is not None:
        network_of(geometry_of(scene))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        create_text(path, text)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{path}: cannot be made, as a file has the name of its folder; name another folder") from None
    except OSError as error:
        raise DiskError.of(error, path) from error
    return path


def _text(parts: SceneParts, path: Path) -> str:
    longest = parts.fractures[0]
    title = f"Fluid pumped into {shown_plain(longest)}"
    rock = 'youngs_modulus = "50 GPa"\npoissons_ratio = 0.25\ndensity = "2700 kg/m^3"\n'
    template = Template(read_text(SCENE, "install fracflow again"))
    return template.substitute(
        path=shown_plain(str(path)),
        title=write_value(title),
        place=parts.text,
        rocks="\n".join(f"[rock.{write_key(name)}]\n{rock}" for name in parts.rocks),
        fracture=write_key(shown_plain(longest)),
        sides=write_value(list(parts.sides)),
        name=write_value(longest),
        rate=digits(RATE * parts.extent),
    )


def _of_traces(table: Path, path: Path) -> SceneParts:
    """A domain around the traces of a table. Raises InputError."""
    rows = read_traces(table)
    points = [np.asarray(row.points) for row in rows]
    lengths = np.array([np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each in points])
    low, high = np.min(np.concatenate(points), axis=0), np.max(np.concatenate(points), axis=0)
    margin = MARGIN * float((high - low).max())
    step = 10.0 ** math.floor(math.log10(margin)) / 2.0
    corners = [*np.floor((low - margin) / step) * step, *np.ceil((high + margin) / step) * step]
    extent = max(corners[2] - corners[0], corners[3] - corners[1])
    fine = max(min(extent / CELLS_AT_FRACTURES, float(np.median(lengths)) / PER_FRACTURE), lengths.sum() / MOST_JOINTS)
    coarse = max(extent / CELLS, fine)
    order = [rows[n].name for n in np.argsort(-lengths, kind="stable")]
    text = f"""[geometry] # x to the right, y upward [m]; the sides are called west, south, east, north
domain = [{", ".join(f"{each:.10g}" for each in corners)}] # xmin, ymin, xmax, ymax: around the traces
fractures_csv = {write_value(_relative(table, path))}
size = {digits(coarse)} # of cells away from fractures; leave both sizes out, and they follow from the scene
size_at_fractures = {_below(fine)}
{_named(order)}"""
    return SceneParts(text, extent, order)


def _of_mesh(file: Path, path: Path, trust: bool) -> SceneParts:
    """The names and sizes of a mesh. Raises InputError."""
    raw = read_mesh(file, [EVERY], trust, path.absolute().parent)
    if not raw.fractures:
        raise InputError(
            f"{file}: no named curve inside the mesh is a fracture; give each one a physical curve, or a set of edges"
        )
    if not raw.sides:
        raise InputError(f"{file}: no side has a name; give the outer curves physical curves, or sets of edges")
    if len(outer := outer_besides(raw.cells, raw.side_facets)):
        at = spot(raw.points, outer[0])
        warnings.warn(
            f"{file}: {len(outer)} outer edges have no name, as at {at}: nothing can hold or load them, and a run"
            " under initial stress is refused; give their curves physical curves",
            stacklevel=2,
        )
    ends = raw.points[raw.fracture_facets]
    lengths = np.bincount(raw.fracture_of, np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), len(raw.fractures))
    order = [raw.fractures[n] for n in np.argsort(-lengths, kind="stable")]
    text = f"""[mesh]
file = {write_value(_relative(file, path))}
{_named(order)}"""
    return SceneParts(text, float(np.ptp(raw.points, axis=0).max()), order, raw.rocks, raw.sides)


def _below(size: float) -> str:
    """The largest size of two digits that is no larger: `check` holds cells beside fractures against it."""
    unit = 10.0 ** (math.floor(math.log10(size)) - 1)
    return f"{math.floor(size / unit + 1e-9) * unit:.10g}"


def _relative(file: Path, path: Path) -> str:
    """How a scene at ``path`` names a file."""
    return os.path.relpath(file.absolute(), path.absolute().parent)


def _named(names: Sequence[str]) -> str:
    """A comment with the names of the fractures, the longest first."""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return f"# fractures, the longest first: {', '.join(map(shown_plain, names[:MOST_NAMED]))}{more}\n"
