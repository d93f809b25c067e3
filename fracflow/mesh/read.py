"""A RawMesh from a geometry or mesh file, or from a polygon and fracture traces."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, RawMesh, SplitMesh
from fracflow.mesh.files.geo_check import check_geo
from fracflow.mesh.files.gmsh import FORMATS, Elements, open_checked, open_msh, open_other, run_worker
from fracflow.mesh.files.msh_check import LARGEST
from fracflow.mesh.interpret import interpret
from fracflow.mesh.locate import PLACE_ROUND_OFF
from fracflow.mesh.places import extent_of, place_text
from fracflow.mesh.plane.near import NearMiss, near_miss_lines, near_misses
from fracflow.mesh.plane.quads import all_quads
from fracflow.mesh.plane.quality import BLUNT, cell_areas, worst_cells
from fracflow.mesh.plane.sizes import Source, sources
from fracflow.mesh.plane.traces import STRETCH, Trace, TraceNetwork, cut_at, natural_snap, polygon_area, tidy
from fracflow.mesh.plane.unmeshed import cut, with_walls
from fracflow.remarks import note
from fracflow.storage.files import check_regular, read_bytes

SPLIT = ".h5"  # of a mesh that is split already, see ``mesh.store``
SUFFIXES = (".geo", ".msh", *FORMATS)
LEAST_SNAP = 1e-9  # of the domain's extent
SAME_AREA = 1e-9  # cells and domain
PER_GAP = 2.0  # size of triangles over the gap they fill: with a right angle
MOST_CELLS = 1e8
MOST_JOINTS = 1_000_000  # in rock that is not meshed
GROWTH = 0.3  # of the mesh size, per length away from the fractures
SMALL = 0.25  # of the size at fractures: smaller cells are reported
SHAPE = 0.433  # area of an equilateral triangle over its side squared
BYTES_PER_CELL = 50  # of a mesh file, with half a node
UNKNOWN = (".geo", ".vtu", ".xdmf")  # a program, and files whose data are packed or lie elsewhere


@dataclass(frozen=True)
class GeometrySpec:
    """A domain cut by fracture traces.

    domain             (k, 2) corners of a polygon, either way round [length]
    traces             name and points (m, 2) of each fracture; they may cross and reach the boundary [length]
    size               mesh size away from the fractures [length]
    size_at_fractures  mesh size on them; as ``size`` if None [length]
    cells              shape of the cells
    rock               name of the rock
    size_at_tips       mesh size at their ends inside the rock; as ``size_at_fractures`` if None [length]
    growth             of the mesh size per length away from the fractures [1]
    snap               points nearer than this to each other, or to a trace or side, become one with it; of the traces
                       themselves, ``natural_snap``, if None [length]
    nodes              (n, 2) points of the fractures that are to be nodes, as those of wells [length]
    unit               what messages write behind a length
    """

    domain: Floats
    traces: tuple[Trace, ...]
    size: float
    size_at_fractures: float | None = None
    cells: Literal["triangles", "quads"] = "triangles"
    rock: str = "rock"
    size_at_tips: float | None = None
    growth: float = GROWTH
    snap: float | None = None
    nodes: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    unit: str = ""

    def raw(self) -> RawMesh:
        """Its mesh by ``build_mesh``. Raises InputError."""
        return build_mesh(self)

    def sized(self) -> GeometrySpec:
        """Itself."""
        return self

    @property
    def expected(self) -> float:
        """How many cells its mesh has, at a guess: away from fractures, and where sizes grow beside them."""
        fine = self.size_at_fractures or self.size
        away = polygon_area(np.asarray(self.domain, dtype=float)) / self.size
        beside = 2.0 * _length(self.traces) / self.growth if fine < self.size else 0.0
        return float(away / self.size + beside / fine) / (1.0 if self.cells == "quads" else SHAPE)


@dataclass(frozen=True)
class MeshFile:
    """A mesh in a file, and the other arguments of ``read_mesh``."""

    path: Path
    fractures: tuple[str, ...]
    trust: bool = False
    folder: Path | None = None

    def raw(self) -> RawMesh:
        """Its mesh by ``read_mesh``. Raises InputError."""
        return read_mesh(self.path, self.fractures, self.trust, self.folder)

    def sized(self) -> MeshFile | Opened:
        """This file, or its elements where its size is no guide to how many there are. Raises InputError."""
        return open_mesh(self.path, self.fractures, self.trust, self.folder) if self.path.suffix in UNKNOWN else self

    @property
    def expected(self) -> float:
        """How many cells it has, at a guess by its size; 0 without a file, which is refused where it is read."""
        try:
            return self.path.stat().st_size / BYTES_PER_CELL
        except OSError:
            return 0.0


@dataclass(frozen=True)
class Opened:
    """The elements of a mesh file, before they mean anything.

    fractures  the names that are fractures
    name       of the file
    notes      on reading it
    """

    elements: Elements
    fractures: tuple[str, ...]
    name: str
    notes: tuple[str, ...] = ()

    def raw(self) -> RawMesh:
        """The mesh that they are. Raises InputError."""
        raw = interpret(self.elements, self.fractures, self.name)
        return replace(raw, notes=(*raw.notes, *self.notes))

    def sized(self) -> Opened:
        """Itself."""
        return self

    @property
    def expected(self) -> float:
        """How many cells it has."""
        return float(len(self.elements.nodes["triangle"]) + len(self.elements.nodes["quad"]))


class MeshSource(Protocol):
    """A mesh that is yet to be read or made, and split."""

    def raw(self) -> RawMesh:
        """Read or make it. Raises InputError."""

    def sized(self) -> MeshSource:
        """The same mesh, with a guess of its cells that is worth something. Raises InputError."""

    @property
    def expected(self) -> float:
        """How many cells it has, at a guess."""


def read_mesh(path: str | Path, fractures: Collection[str], trust: bool = False, folder: Path | None = None) -> RawMesh:
    """Read a Gmsh geometry (.geo) or mesh (.msh 2.2 or 4.1), or a mesh of another program (.inp, .vtu, .e, .exo, .xdmf).

    A physical curve, or set of edges, is a fracture if ``fractures`` has its name, or has "default" and the curve lies inside
    the mesh; else it is a side. A .geo is a program. Without ``trust`` only statements that make geometry are read
    (``geo_check``). Files that it includes must lie in ``folder``, or in its own where it lies elsewhere. Raises InputError,
    naming the file, for what cannot be read or has no meaning.
    """
    return open_mesh(Path(path), tuple(fractures), trust, folder).raw()


def open_mesh(path: Path, fractures: tuple[str, ...], trust: bool = False, folder: Path | None = None) -> Opened:
    """The elements of a file, as ``read_mesh`` takes it. Raises InputError for what cannot be read."""
    if path.suffix not in SUFFIXES:
        known = f"give a Gmsh .geo or .msh, {', '.join(FORMATS)}, or the {SPLIT} of fracflow mesh"
        raise InputError(f'{path}: unknown kind of file "{path.suffix}"; {known}')
    check_regular(path, "mesh.file names it from the scene's folder", LARGEST)
    notes: tuple[str, ...] = ()
    if path.suffix == ".msh":
        elements = open_msh(path)
    elif path.suffix in FORMATS:
        elements = open_other(path)
    else:
        if read_bytes(path, "mesh.file names it from the scene's folder").rpartition(b"\n")[2].strip():
            # Gmsh says nothing and leaves the line out.
            raise InputError(f"{path}: Gmsh would ignore the last line, which has no line end; add one")
        is_inside = folder is not None and Path(os.path.realpath(folder)) in Path(os.path.realpath(path)).parents
        if trust:
            elements = run_worker({"file": str(path.resolve())}, str(path))  # Gmsh runs the file itself
        else:
            checked = check_geo(path, folder if is_inside else None)
            elements, notes = open_checked(path, checked), checked.notes
    return Opened(elements, fractures, str(path), notes)


def build_mesh(geometry: GeometrySpec) -> RawMesh:
    """Mesh a domain so that its fractures are edges of cells, each facet running along its trace.

    The sides of a rectangle along the axes are south, east, north, west; those of another polygon side1,
    side2, ... in the order of its corners. The notes of the mesh say what was changed in the traces. A mesh that lacks one of
    the ``nodes`` is made again with traces cut there. Raises InputError for traces that cannot be made fit
    (``traces.tidy``).
    """
    _check_sizes(geometry, polygon_area(np.asarray(geometry.domain, dtype=float)))
    network, snap, misses = network_of(geometry)
    raw = _meshed(geometry, network, snap, misses)
    near = PLACE_ROUND_OFF * np.ptp(raw.points, axis=0).max()
    on_traces = raw.points[np.unique(raw.fracture_facets)]
    if all(np.linalg.norm(on_traces - place, axis=1).min(initial=np.inf) <= near for place in geometry.nodes):
        return raw
    return _meshed(geometry, cut_at(network, geometry.nodes, snap), snap, misses)


def _cells_of(job: dict[str, Any], geometry: GeometrySpec) -> RawMesh:
    """The mesh that Gmsh makes of a job."""
    elements, names = run_worker(job, "geometry"), [name for name, _ in geometry.traces]
    return interpret(all_quads(elements) if geometry.cells == "quads" else elements, names, "geometry")


def _meshed(geometry: GeometrySpec, network: TraceNetwork, snap: float, misses: list[NearMiss]) -> RawMesh:
    """The mesh of a ``network`` by Gmsh."""
    domain, sides = np.asarray(geometry.domain, dtype=float), side_names(np.asarray(geometry.domain, dtype=float))
    fine = float(geometry.size_at_fractures or geometry.size)
    is_quads = geometry.cells == "quads"
    coarser = 2 if is_quads else 1  # quads are cut in four in the end
    per_gap = PER_GAP / coarser
    at_tips = float(geometry.size_at_tips or fine)
    around = sources(network, fine, at_tips, per_gap, min(fine, per_gap * snap))
    job = {
        "points": network.points.tolist(),
        "sides": {name: network.along(-1 - k) for k, name in enumerate(sides)},
        "traces": {name: network.along(k) for k, (name, _) in enumerate(geometry.traces)},
        "size": coarser * float(geometry.size),
        "sources": [(coarser * size, size / 2, places.tolist()) for size, places in around if size < geometry.size],
        "growth": coarser * float(geometry.growth),
        "right_angled": is_quads,
        "rock": geometry.rock,
    }
    raw = _cells_of(job, geometry)
    if is_quads and worst_cells(raw.points, raw.cells)["cells over 150 degrees"] > BLUNT:
        # where sizes grow steeply Gmsh now and then leaves off its right-angled triangles: few and long ones remain
        raw = _cells_of(job | {"right_angled": False}, geometry)
    covered, whole = cell_areas(raw.points, raw.cells).sum(), polygon_area(domain)
    if abs(covered - whole) > SAME_AREA * whole:
        raise InputError(
            f"geometry: the cells cover {covered:.9g} of the domain's {whole:.9g}: Gmsh folded them over each other;"
            " change geometry.size or size_at_fractures a little"
        )
    between = [each for each in around if each[0] != at_tips]
    small = _small_cells(between, misses, fine, extent_of(domain), geometry.unit)
    return replace(raw, notes=(*network.notes, *near_miss_lines(misses), *small))


def build_unmeshed(geometry: GeometrySpec, halvings: int = 0) -> SplitMesh:
    """The joints of fractures in rock that is not meshed, and their walls; sizes as ``build_mesh`` has them, then halved.

    The domain is the box that traces are drawn in. Raises InputError for traces that cannot be made fit.
    """
    _check_sizes(geometry, 0.0)
    network, snap, misses = network_of(geometry)
    network = cut_at(network, geometry.nodes, snap)
    fine, names = float(geometry.size_at_fractures or geometry.size), [name for name, _ in geometry.traces]
    at_tips = float(geometry.size_at_tips or fine)
    around = sources(network, fine, at_tips, PER_GAP, min(fine, PER_GAP * snap))
    if len(meeting := network.points[network.meeting]) and at_tips < fine:  # stresses are as steep there
        around.append((at_tips, meeting))
    joints = cut(network, around, fine, float(geometry.growth), halvings)
    if len(joints[1]) > MOST_JOINTS:
        raise InputError(
            f'geometry.domain = "unbounded": {len(joints[1])} joints are more than'
            f" {MOST_JOINTS}: raise geometry.size_at_fractures, or give geometry.domain = [xmin, ymin, xmax, ymax]"
        )
    return with_walls(*joints, tuple(names), geometry.rock, (*network.notes, *near_miss_lines(misses)))


def network_of(geometry: GeometrySpec) -> tuple[TraceNetwork, float, list[NearMiss]]:
    """The network of a geometry, its snap [length], and what all but meets in it; none of them depends on mesh sizes.

    Raises InputError for traces that cannot be made fit (``traces.tidy``).
    """
    domain = np.asarray(geometry.domain, dtype=float)
    traces = [(name, np.asarray(points, dtype=float)) for name, points in geometry.traces]
    sides = side_names(domain)
    _check_traces(traces, (geometry.rock, *sides))
    snap = natural_snap(domain, traces)[0] if geometry.snap is None else float(geometry.snap)
    if snap < LEAST_SNAP * np.ptp(domain, axis=0).max():
        raise InputError(f"geometry.snap = {snap:.3g}{geometry.unit}: is round-off in a domain of this size; raise it")
    network = tidy(domain, sides, traces, snap, stretch=STRETCH * snap, unit=geometry.unit)
    return network, snap, near_misses(network, [name for name, _ in traces], sides, snap, geometry.unit)


def _small_cells(around: list[Source], misses: list[NearMiss], fine: float, extent: float, unit: str) -> list[str]:
    """Say where cells are far smaller than the size at fractures, and by which near miss."""
    least, places = min(around, key=lambda each: each[0], default=(fine, np.zeros((0, 2))))
    if least >= SMALL * fine:
        return []
    beside = [miss for miss in misses if np.linalg.norm(places - miss.point, axis=1).min() <= 2.0 * miss.distance]
    at, why = places[0], "where traces are near each other or meet at a small angle"
    if beside:
        at, why = np.array(beside[0].point), f"by the near miss of {beside[0].subject}"
    beside_others = f"{least / fine:.2g} of size_at_fractures"
    return [note(f"cells of {least:.3g}{unit}, {beside_others}, at {place_text(at, extent)}: {why}")]


def side_names(domain: Floats) -> list[str]:
    """Name the sides of a polygon (k, 2), from each corner to the next."""
    steps = np.roll(domain, -1, axis=0) - domain
    extent = np.ptp(domain, axis=0)
    is_corner = np.all(np.minimum(domain - domain.min(axis=0), domain.max(axis=0) - domain) <= 1e-12 * extent)
    if len(domain) != 4 or not is_corner or np.any(np.count_nonzero(np.abs(steps) > 1e-12 * extent, axis=1) != 1):
        return [f"side{number}" for number in range(1, len(domain) + 1)]
    middle = domain + steps / 2 - (domain.min(axis=0) + extent / 2)
    places = {(0, -1): "south", (1, 0): "east", (0, 1): "north", (-1, 0): "west"}
    return [places[tuple(np.sign(np.round(place / extent, 6)).astype(int).tolist())] for place in middle]


def _length(traces: Iterable[Trace]) -> float:
    """Of all traces [length]."""
    return float(sum(np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for _, points in traces))


def _check_sizes(geometry: GeometrySpec, area: float) -> None:
    """Raise InputError for mesh sizes that no machine could serve."""
    length = _length(geometry.traces)
    fine = geometry.size_at_fractures or geometry.size
    counts = {"size": (geometry.size, area / geometry.size**2), "size_at_fractures": (fine, length / fine)}
    for key, (value, count) in counts.items():
        if count > MOST_CELLS:
            fault = f"geometry.{key} = {value:g}: would take some {count:.1g} cells"
            raise InputError(f"{fault}; raise it, or check the units")


def _check_traces(traces: list[Trace], taken: Iterable[str]) -> None:
    """Raise InputError for the first trace without points, or without a name of its own."""
    names = set(taken)
    for name, points in traces:
        what = f'geometry: fracture "{name}"'
        if name in names:
            raise InputError(f"{what}: the name is taken by another fracture, a side or the rock; choose another")
        names.add(name)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.all(np.isfinite(points)):
            raise InputError(f"{what}: points must be two or more pairs [x, y] of finite numbers")
        if np.any(is_still := np.all(points[1:] == points[:-1], axis=1)):
            raise InputError(f"{what}: two points in a row are {points[np.argmax(is_still)].tolist()}; remove one")
