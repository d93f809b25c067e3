"""From a scene and its mesh to operators and loads: everything that stays the same during a run."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.cut_mesh import cut_mesh, near_mesh
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.distribute import distribute
from fracflow.mesh.graph import components
from fracflow.mesh.locate import (
    PLACE_ROUND_OFF,
    FracturePlace,
    RockPlace,
    beside,
    coordinates,
    on_fracture,
    point_along,
    probe_place,
    refuse_cut_off,
    tied_nodes,
)
from fracflow.mesh.near_cells import covers, near_cells, with_near_first
from fracflow.mesh.places import extent_of, place_text
from fracflow.mesh.read import GROWTH, SPLIT, GeometrySpec, MeshFile, MeshSource, build_unmeshed
from fracflow.mesh.split import ends_on_side, joined_ends, split
from fracflow.mesh.store import load_split
from fracflow.model.contact_mass import redistributed, redistributes
from fracflow.model.dirichlet import meeting_supports, overruled_rates, refuse_two_pressures
from fracflow.model.loads import Loads, assemble_loads
from fracflow.model.operators import Operators, assemble
from fracflow.model.probes import refuse_missing
from fracflow.model.solid import refuse_unsound
from fracflow.model.terms.registry import with_terms
from fracflow.remarks import note
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH
from fracflow.scene.values import AlongFracture, FractureEnd, Position

if TYPE_CHECKING:
    from fracflow.mesh.slices.beside import CellsBeside


@dataclass(frozen=True)
class Placed:
    """Where the scene's names sit on the mesh.

    wells   name -> flow nodes: one, or those of all fracture ends on a side with a pressure
    probes  name -> place
    points  name -> split nodes
    ties    (m, 2) pairs of node * dim + component that move alike
    notes   lines for the log
    apart   parts of the network that have wells and never meet, where there is more than one; on rank 0
    """

    wells: Mapping[str, tuple[int, ...]]
    probes: Mapping[str, FracturePlace | RockPlace]
    points: Mapping[str, Ints]
    ties: Ints
    notes: tuple[str, ...]
    apart: tuple[str, ...] = ()


@dataclass(frozen=True)
class SlowLoads:
    """Why a stage auto takes the place of a dynamic one.

    error  that leaving inertia out may cause, at most [1]
    name   of the decision, where it is undone
    """

    error: float
    name: str


@dataclass(frozen=True)
class FarSides:
    """Whether the rock is run without its sides, and without a mesh.

    error   that leaving them out may cause; 0 where it was not asked [1]
    faster  how many times a factorisation is then
    why     they are kept; empty where they may be left out
    """

    error: float = 0.0
    faster: float = 1.0
    why: str = ""


@dataclass(frozen=True)
class Model:
    """A scene made ready: ``mesh`` is on rank 0 only, and has its near cells alone where ranks cut cells, or took slices.

    stated   the scene as its file has it but for sides that are left out, where ``scene`` is a reduced one
    bounded  the scene as its file has it, where its sides are left out
    sides    whether they are; None of a scene that does not let the program choose
    of_event  whether an event has meshed the rock; ``unmeshed`` are the joints alone that the run began with, on rank 0
    whole    the model with the fractures that are ``locked``; None where none is
    beside   the cells of this model at joints of those
    slow     stages auto, by their numbers, that take the place of dynamic ones
    """

    scene: Scene
    mesh: SplitMesh | None
    placed: Placed
    operators: Operators
    loads: Loads
    stated: Scene
    whole: Model | None = None
    locked: tuple[str, ...] = ()
    beside: CellsBeside | None = None
    slow: Mapping[int, SlowLoads] = field(default_factory=dict)
    bounded: Scene | None = None
    sides: FarSides | None = None
    of_event: bool = False
    unmeshed: SplitMesh | None = None

    @property
    def stated_mesh(self) -> SplitMesh:
        """The mesh that the run began with, with all fractures, as ``mesh``."""
        mesh = self.unmeshed or (self.whole or self).mesh
        assert mesh is not None
        return mesh


@contextmanager
def naming(scene: Scene) -> Iterator[None]:
    """Add the name of the scene's file to every InputError inside. Raises that InputError."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise InputError(text if scene.source in text else f"{scene.source}: {text}") from None


def split_of(scene: Scene) -> SplitMesh:
    """Read or build the mesh of a scene whose sizes are known, and split it; no cell is cut yet. Raises InputError."""
    if scene.is_unbounded:
        return build_unmeshed(geometry_of(scene), scene.refine)
    path = scene.mesh_path
    return load_split(path) if path is not None and path.suffix == SPLIT else split(source_of(scene).raw())


def source_of(scene: Scene) -> MeshSource:
    """Where the mesh of a scene comes from that is not split yet, and whose sizes are known."""
    path = scene.mesh_path
    return geometry_of(scene) if path is None else MeshFile(path, tuple(scene.fracture), scene.trust, scene.folder)


def read_sized(scene: Scene) -> SplitMesh:
    """The mesh of ``split_of`` for a run; where it is to be cut, its near cells are. Raises InputError."""
    return made_ready(scene, split_of(scene))


def made_ready(scene: Scene, mesh: SplitMesh) -> SplitMesh:
    """The mesh of ``split_of`` as wells join ends of fractures in it, and its near cells, cut, where it is to be cut.

    Raises InputError where it lacks a name of the scene.
    """
    scene.check_mesh_names(mesh.rocks, mesh.fractures, mesh.sides, tuple(mesh.named_points))
    if scene.is_unbounded:
        return mesh
    mesh = replace(mesh, cuts=scene.refine)
    joined: dict[int, str] = {}
    for well in scene.well if scene.has_flow else ():
        if well.on is not None and well.flow_rate is not None:
            ends = _ends_on(mesh, well.name, well.on)
            raw_nodes = mesh.flow_origin[ends].tolist()
            other = next((joined[node] for node in raw_nodes if joined.get(node, well.on) != well.on), None)
            if other is not None:
                raise InputError(
                    f"well.{well.name}: on: a fracture ends in the corner of {other} and {well.on}; move its end"
                )
            joined |= dict.fromkeys(raw_nodes, well.on)
            mesh = joined_ends(mesh, ends)
    return near_mesh(with_near_first(mesh, looked_at(scene, mesh))) if mesh.cuts else mesh


def looked_at(scene: Scene, mesh: SplitMesh) -> Bools:
    """Cells (m,) of a mesh that must be on rank 0 to find the scene's places, and to check it."""
    return near_cells(mesh, places_of(scene, mesh))


def places_of(scene: Scene, mesh: SplitMesh) -> Floats:
    """Places (p, dim) whose cells that takes, beside those at joints and sides; no cell is looked at."""
    places = []
    for probe in scene.probe:
        with suppress(InputError):  # raised again where it is placed
            what = f"probe.{probe.name}"
            places.append(coordinates(mesh, _asked(scene, probe.at, what, mesh), what))
    return np.array(places).reshape(-1, mesh.points.shape[1])


def fractures_of(scene: Scene) -> set[str]:
    """Names of fractures whose joints ``places_of`` needs."""
    return {probe.at.fracture for probe in scene.probe if isinstance(probe.at, (FractureEnd, AlongFracture))}


def fitting(scene: Scene, mesh: SplitMesh) -> SplitMesh:
    """A saved mesh; with all cells, where the scene has changed since and its places lie in others than the near ones."""
    uncut = mesh.uncut
    return mesh if not uncut.cuts or covers(uncut, looked_at(scene, uncut)) else cut_mesh(uncut)


def _ends_on(mesh: SplitMesh, well: str, side: str) -> Ints:
    """Flow nodes (n,) of fractures on the side of a well. Raises InputError where there are none."""
    found = ends_on_side(mesh, side)
    if not len(found):
        raise InputError(f'well.{well}: on = "{side}": no fracture reaches that side; give at = a place on a fracture')
    return found


def geometry_of(scene: Scene) -> GeometrySpec:
    """The geometry of a scene that has one, with its sizes known."""
    geometry = scene.geometry
    size = None if geometry is None else geometry.size or geometry.size_at_fractures
    assert geometry is not None and size is not None
    return GeometrySpec(
        np.array(geometry.outline, dtype=float),
        tuple((f.name, np.array(f.points, dtype=float)) for f in geometry.fracture),
        size,
        geometry.size_at_fractures,
        geometry.cells,
        next(iter(scene.rock)),
        size_at_tips=geometry.size_at_tips,
        growth=GROWTH if geometry.growth is None else geometry.growth,
        snap=geometry.snap,
        nodes=_well_places(scene),
        unit=scene.unit_system.behind(LENGTH),
    )


def _well_places(scene: Scene) -> Floats:
    """Where wells are that are given by coordinates or along a trace (n, 2): the mesh has a node there [length]."""
    wells = [well for well in scene.well if scene.has_flow and well.at is not None]
    given = [_asked(scene, well.at, f"well.{well.name}") for well in wells]
    return np.array([place for place in given if _is_point(place)]).reshape(-1, 2)


def _asked(scene: Scene, where: Position | None, what: str, mesh: SplitMesh | None = None) -> Any:
    """A place as ``mesh.locate`` takes it: one along a trace as coordinates, of the trace as it is drawn, or as a mesh has it.

    Raises InputError where the trace is shorter, or there is none.
    """
    if isinstance(where, FractureEnd):
        return where.fracture, where.end
    if not isinstance(where, AlongFracture):
        return where
    drawn = scene.geometry.fracture if scene.geometry is not None else ()
    points = next((np.array(each.points, dtype=float) for each in drawn if each.name == where.fracture), None)
    if points is None:
        if mesh is None:
            return where
        of_it = mesh.joint_along[mesh.joint_fracture == mesh.fractures.index(where.fracture)]
        distance = where.distance if where.fraction is None else where.fraction * float(of_it.max())
        assert distance is not None
        return tuple(point_along(mesh, where.fracture, distance, what, scene.unit_system.behind(LENGTH)).tolist())
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    distance = where.distance if where.fraction is None else where.fraction * along[-1]
    assert distance is not None
    unit = scene.unit_system.behind(LENGTH)
    if distance > along[-1] * (1.0 + 1e-9):
        raise InputError(
            f'{what}: at = {distance:.6g}{unit}: fracture "{where.fracture}" is {along[-1]:.6g}{unit} long; give less,'
            " or a fraction"
        )
    return tuple(float(np.interp(distance, along, part)) for part in points.T)


def place(scene: Scene, mesh: SplitMesh) -> Placed:
    """Find wells, probes and points on the mesh. Raises InputError."""
    unit = scene.unit_system.behind(LENGTH)
    asked = {
        f"{kind}.{entry.name}": _asked(scene, entry.at, f"{kind}.{entry.name}", mesh)
        for kind in ("well", "probe")
        for entry in getattr(scene, kind)
    }
    on = {f"well.{well.name}": _fracture_of(well.at) for well in scene.well}
    on |= {f"probe.{probe.name}": probe.on or _fracture_of(probe.at) for probe in scene.probe}
    drawn = {} if scene.geometry is None else {trace.name: trace.points for trace in scene.geometry.fracture}
    for what, at in asked.items():
        name = on[what]
        if name in drawn and name in mesh.fractures and _is_point(at):
            refuse_cut_off(mesh, np.array(drawn[name], dtype=float), np.array(at), what, name, unit)
    wells = {
        w.name: (on_fracture(mesh, asked[f"well.{w.name}"], f"well.{w.name}", on[f"well.{w.name}"], unit).flow,)
        if w.on is None
        else tuple(_ends_on(mesh, w.name, w.on).tolist())
        for w in scene.well
        if scene.has_flow
    }
    probes = {
        p.name: probe_place(mesh, asked[f"probe.{p.name}"], f"probe.{p.name}", on[f"probe.{p.name}"], unit)
        for p in scene.probe
    }
    refuse_missing(scene, mesh, probes)
    refuse_lone_wells(scene, mesh, wells)
    refuse_two_pressures(scene, wells)
    points = {name: np.flatnonzero(mesh.origin == node) for name, node in mesh.named_points.items()}
    extent = extent_of(mesh.points)
    spots = {name: mesh.points[mesh.flow_origin[nodes[0]]] for name, nodes in wells.items()}
    displaced = {name for name, spot in spots.items() if moved(mesh, asked[f"well.{name}"], spot, unit)}
    return Placed(
        wells,
        probes,
        points,
        tied_components(scene, mesh),
        (
            *(
                on_its_fracture(mesh, w.name, wells[w.name][0], asked[f"well.{w.name}"], unit)
                for w in scene.well
                if w.name in wells and w.at is not None
            ),
            *(
                remark_on(mesh, f"{name} sits on the fracture at {where}{unit}{away}", found.joints, asked[name], unit)
                for name, found in ((f"probe.{p.name}", probes[p.name]) for p in scene.probe)
                if isinstance(found, FracturePlace) and (away := moved(mesh, asked[name], found.point, unit))
                for where in (place_text(found.point, extent),)
            ),
            *meeting_wells(wells, displaced),
            *overruled_rates(scene, wells),
        ),
    )


def _fracture_of(at: Position | None) -> str | None:
    """The fracture that a place along its trace is on; None for other places."""
    return at.fracture if isinstance(at, AlongFracture) else None


def on_its_fracture(mesh: SplitMesh, name: str, node: int, asked: Position, unit: str) -> str:
    """Say on which fractures a well lies: Gmsh may have given the number of its physical point to another one."""
    joints = np.flatnonzero(np.any(mesh.joint_flow == node, axis=1))
    on = [mesh.fractures[f] for f in np.unique(mesh.joint_fracture[joints])]
    spot, extent = mesh.points[mesh.flow_origin[node]], extent_of(mesh.points)
    line = f"well.{name} is on {', '.join(on)} at {place_text(spot, extent)}{unit}{moved(mesh, asked, spot, unit)}"
    return remark_on(mesh, line, joints, asked, unit)


def remark_on(mesh: SplitMesh, line: str, joints: Ints, asked: Position, unit: str) -> str:
    """A line on a place: a note, or a warning where the coordinates asked for lie beside the joints (n,) that it is on."""
    off = beside(mesh, joints, np.asarray(asked, dtype=float)) if _is_point(asked) else 0.0
    return f"{line}: that is {off:.3g}{unit} beside the fracture: give a place on it" if off else note(line)


def _is_point(asked: object) -> bool:
    """Whether a place is given by coordinates, or was made them."""
    return isinstance(asked, tuple) and not isinstance(asked[0], str)


def moved(mesh: SplitMesh, asked: Position, spot: Floats, unit: str) -> str:
    """Say how far from the coordinates asked for a ``spot`` (dim,) is; "" if there."""
    away = float(np.linalg.norm(np.asarray(asked, dtype=float) - spot)) if _is_point(asked) else 0.0
    near = PLACE_ROUND_OFF * extent_of(mesh.points)
    return "" if away <= near else f", {away:.3g}{unit} from where it was asked"


def meeting_wells(wells: Mapping[str, tuple[int, ...]], away: Container[str]) -> Iterator[str]:
    """A line for each two wells on one node, at least one of which is ``away`` from where it was asked."""
    for one, other in combinations(wells, 2):
        if not {*wells[one]}.isdisjoint(wells[other]) and (one in away or other in away):
            yield (
                f"well.{one} and well.{other} share a node: for one each, set geometry.snap below their distance, or give a"
                " [mesh] with a node at each"
            )


def tied_components(scene: Scene, mesh: SplitMesh) -> Ints:
    """Pairs (m, 2) of node * dim + component that [[tie]] joins. Raises InputError."""
    dim = mesh.points.shape[1]
    rigid = np.isin(mesh.rocks, [name for name, rock in scene.rock.items() if rock.rigid])
    on_rigid = np.unique(mesh.cells[rigid[mesh.cell_rock]])
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for tie in scene.tie:
        nodes = tied_nodes(mesh, tie.on)
        if np.isin(nodes, on_rigid).any():
            raise InputError(f"tie: on = {list(tie.on)}: lies on a rigid rock, whose nodes already move as one")
        pairs += [nodes * dim + ("x", "y").index(part) for part in tie.components]
    return np.concatenate(pairs)


def refuse_lone_wells(scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InputError where a steady stage would have to pump, by one well alone, into an undrained component."""
    count = len(mesh.flow_origin)
    if not scene.has_flow or not count or not any(stage.kind == "steady" for stage in scene.stage):
        return
    label = components(mesh.joint_flow[:, 0], mesh.joint_flow[:, 1], count)
    drained = {int(label[node]) for w in scene.well if w.pressure is not None for node in wells[w.name]}
    held = [scene.drains(name) or scene.fracture_named(name).pressure is not None for name in mesh.fractures]
    drained |= set(label[mesh.joint_flow[np.array(held, dtype=bool)[mesh.joint_fracture]]].ravel().tolist())
    pumped: dict[int, list[str]] = {}
    limited = {w.name for w in scene.well if w.maximum_pressure is not None or w.minimum_pressure is not None}
    for well in scene.well:
        if well.pressure is None:
            pumped.setdefault(int(label[wells[well.name][0]]), []).append(well.name)
    for component, names in pumped.items():
        if component not in drained and len(names) == 1 and names[0] not in limited:
            inside = np.unique(mesh.joint_fracture[label[mesh.joint_flow[:, 0]] == component])
            fractures = ", ".join(mesh.fractures[i] for i in inside)
            raise InputError(
                f"well.{names[0]}: a steady stage pumps into {fractures}, which no [[well]] with a pressure drains:"
                ' give one, or use kind = "quasi-static", whose walls store the fluid'
            )


def set_up(
    scene: Scene, comm: MPI.Comm, mesh: SplitMesh | None, placed: Placed, cell_rank: Ints | None = None,
    blocks: Blocks | None = None,
) -> Model:  # fmt: skip
    """Blocks, operators and loads of a scene whose sizes are known. Raises InputError, on every rank. Collective.

    mesh       on rank 0
    placed     where the scene's names sit on it
    cell_rank  ranks (cells,) of the cells, as they are before they are cut, in an earlier run, on rank 0
    blocks     of a mesh that is distributed already
    """
    rigid = [name for name, rock in scene.rock.items() if rock.rigid]
    blocks = blocks or distribute(mesh, comm, rigid, placed.ties, cell_rank)
    if not scene.is_unbounded:
        refuse_unsound(blocks)
    operators = with_terms(assemble(blocks, scene), scene)
    numbers = {name: flow_numbers(blocks, np.array(nodes, dtype=np.int64)) for name, nodes in placed.wells.items()}
    loads = assemble_loads(blocks, scene, operators, placed.points, numbers)
    if redistributes(scene) and not scene.is_unbounded:
        operators = redistributed(operators, scene, loads, mesh)
    lines = meeting_supports(scene, blocks, placed.points)
    lines += [line for term in operators.terms for line in term.notes]
    lines += operators.far.notes if operators.far is not None else ()
    placed = replace(placed, notes=(*placed.notes, *lines))
    return Model(scene, mesh, placed, operators, loads, scene)


def flow_numbers(blocks: Blocks, ids: Ints) -> Ints:
    """PETSc numbers (n,) of flow nodes given by their original numbers (n,). Collective."""
    own = blocks.flow.starts[blocks.comm.rank] + np.arange(len(blocks.flow.ids))
    parts = blocks.comm.allgather([(i, own[blocks.flow.ids == i][0]) for i in np.intersect1d(ids, blocks.flow.ids)])
    known = {int(i): int(n) for part in parts for i, n in part}
    return np.array([known[int(i)] for i in ids], dtype=np.int64)
