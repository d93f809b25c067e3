"""The mesh that rock without one gets once an event needs inertia: its sides, its sizes, and the model of it.

An unbounded domain has a box around its fractures with absorbing sides. At a distance r from a fracture of half length a an
event changes stresses by (a/r)^2 of their change there. At the nearest side of the usual box that is 6 % (``nearness``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.mesh.around import mesh_around
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.plane.traces import polygon_area
from fracflow.mesh.read import GROWTH, side_names
from fracflow.mesh.rock_cells import RockCells
from fracflow.model.setup import Model, geometry_of, naming, place, set_up
from fracflow.output.remarks import MESH_OF_EVENTS
from fracflow.reduction.decision import Decision
from fracflow.reduction.mesh_size import ACROSS, graded_count, growth_of, trace_lengths
from fracflow.reduction.unresolved import unresolved, unresolved_slip
from fracflow.remarks import digits, note
from fracflow.scene.method import Points
from fracflow.scene.scene import Scene
from fracflow.scene.terms import Absorbing
from fracflow.scene.units import LENGTH

MARGIN = 2.0  # of the larger extent of all fractures: rock between them and the sides
MUCH_FROZEN = 0.1  # of the stress drop of an event
PER_EXTENT = 8.0  # cells far away, over that extent: ten in a wave of the corner frequency of slip along all of it


def event_scene(scene: Scene, bounded: Scene | None = None) -> Scene:
    """The unbounded scene with the outline, the sides and the sizes of the mesh of its events.

    bounded  the scene as its file has it, where the plan has left out its sides
    """
    assert scene.geometry is not None
    geometry = scene.geometry
    points = np.array([point for trace in geometry.fracture for point in trace.points])
    extent = float(np.ptp(points, axis=0).max())
    fine = geometry.size_at_fractures or geometry.size or extent
    if bounded is not None:
        assert bounded.geometry is not None
        corners, sides = bounded.geometry.outline, {"support": bounded.support, "absorbing": bounded.absorbing}
        size = bounded.geometry.size or float(np.ptp(np.array(corners), axis=0).min()) / ACROSS
    else:
        margin = MARGIN * extent if geometry.event_margin is None else geometry.event_margin
        corners = _box(points.min(axis=0) - margin, points.max(axis=0) + margin)
        sides = {"absorbing": (Absorbing(on=tuple(side_names(np.array(corners)))),)}
        size = geometry.size or extent / PER_EXTENT
    keys = {
        "domain": corners,
        "size": max(size, fine) / 2**geometry.refine,
        "growth": growth_of(bounded or scene, size, corners)[0],
        "refine": 0,
    }
    return scene.model_copy(update={"geometry": geometry.model_copy(update=keys), **sides})


def _box(low: Floats, high: Floats) -> Points:
    (left, bottom), (right, top) = low.tolist(), high.tolist()
    return (left, bottom), (right, bottom), (right, top), (left, top)


def cells_of_event(scene: Scene, bounded: Scene | None = None) -> float:
    """Number of cells, about, of the mesh of an unbounded scene's events; ``bounded`` as above."""
    geometry = event_scene(scene, bounded).geometry
    assert geometry is not None and geometry.size is not None
    length = float(trace_lengths(geometry).sum())
    fine = min(geometry.size, (geometry.size_at_fractures or geometry.size) / 2**scene.refine)
    area = polygon_area(np.array(geometry.outline))
    return graded_count(geometry.size, fine, area, length, geometry.growth or GROWTH)


def period_of_event(scene: Scene, bounded: Scene | None = None) -> float:
    """Longest period of S waves in the box of that mesh between sides that stay where they are [time]; ``bounded`` as above."""
    geometry = event_scene(scene, bounded).geometry
    assert geometry is not None
    speed = max(rock.s_speed for rock in scene.rock.values())
    return float(2.0 / (speed * np.hypot(*(1.0 / np.ptp(np.array(geometry.outline), axis=0)))))


def before_events(scene: Scene, bounded: Scene | None = None) -> tuple[str, ...]:
    """A line on the mesh that events of an unbounded scene would have, before the first one; ``bounded`` as above."""
    if not scene.is_unbounded or not scene.has_dynamics:
        return ()
    geometry, unit = event_scene(scene, bounded).geometry, scene.unit_system.behind(LENGTH)
    assert geometry is not None
    corners = np.array(geometry.outline)
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    cells = f"about {cells_of_event(scene, bounded):.2g} cells"
    points = np.array([point for trace in geometry.fracture for point in trace.points])
    extent, margin = float(np.ptp(points, axis=0).max()), geometry.event_margin
    beside = MARGIN * extent if margin is None else margin
    change = f"the slip and opening of an event by about {digits(100.0 * nearness(extent, beside))} %"
    sides = "the sides of the scene"
    if bounded is None:
        sides = f"absorbing sides (geometry.event_margin), which change {change}"
    near = []
    if bounded is None and margin is not None and margin < extent:
        near.append(
            f"geometry.event_margin = {margin:.6g}{unit}: sides nearer than the extent of the fractures change {change};"
            f" leave it out for {MARGIN * extent:.6g}{unit}"
        )
    return (
        *near,
        note(
            f"stage auto: for events that need inertia the rock is meshed, with {sides}: {cells}"
            f" from ({left:.6g}, {bottom:.6g}) to ({right:.6g}, {top:.6g}){unit}"
        ),
    )


def nearness(extent: float, margin: float) -> float:
    """(a/r)^2, the share of the stress of jumps along 2 a = extent that sides at r = margin change.

    Without inertia held sides take 0.3 to 0.5 times that of the slip of one crack. Of its opening they take 0.8 to 1.3 times.
    """
    return (0.5 * extent / max(margin, 0.5 * extent)) ** 2


def stress_left_frozen(scene: Scene, when: str, share: float) -> str:
    """A line on the ``share`` of its stress drop that an event has left frozen; a warning, with the remedy, above MUCH_FROZEN.

    when   the end of the event, in words
    share  infinite where no stress dropped
    """
    assert scene.geometry is not None
    size, unit = scene.geometry.size_at_fractures or scene.geometry.size, scene.unit_system.behind(LENGTH)
    part, finer = "stands beside no drop of stress", "a smaller geometry.size_at_fractures"
    if np.isfinite(share):
        part = f"is {share:.2g} of its stress drop, weighted by slip"
        if size is not None:
            size /= 2**scene.refine  # bench event_mesh --joints: half of it leaves 0.56 to 0.74
            finer = f"joints of {0.5 * size:.3g}{unit}, half as long (geometry.size_at_fractures), leave about two thirds of it"
    line = f"time {when}: the stress that this event leaves frozen {part}"
    if share <= MUCH_FROZEN:
        return note(line)
    first = 'method.tips = "corrected" and ' if scene.method.tips == "plain" else ""
    return (
        f"{line}: cells at the ends of its slip are too stiff: {first}{finer}; waves that are left count too (at_rest)"
    )


def mesh_of_events(when: str, why: str, cells: int, nodes: int, times: int = 1, frozen: str = "") -> Decision:
    """The record of a run whose rock was not meshed until an event needed it, so many ``times``.

    frozen  the largest traction that a change of rock has left on the fractures, with its unit
    """
    error = f"frozen traction of at most {frozen} on the fractures" if frozen else "none"
    again = f", taken {times} times" if times > 1 else ""
    return Decision(
        MESH_OF_EVENTS, False, "an event that needs inertia", f"{cells} cells, {nodes} nodes{again}, made at time {when}",
        "made at the first one", error, f"nothing: {why}", added=True,
    )  # fmt: skip


def with_event_mesh(
    model: Model, comm: MPI.Comm, saved: SplitMesh | None = None, cell_rank: Ints | None = None
) -> Model:
    """The model of the same scene on the mesh of its events. Raises InputError, on every rank. Collective.

    saved, cell_rank  mesh and partition (cells,) of an earlier run, on rank 0
    """
    scene = event_scene(model.scene, model.bounded)

    def work() -> SplitMesh:
        assert model.mesh is not None
        return saved or mesh_around(geometry_of(scene), model.mesh)

    with naming(scene):
        mesh = on_root(comm, work)
        placed = comm.bcast(on_root(comm, lambda: place(scene, mesh) if mesh is not None else None), root=0)
        assert placed is not None
        found = set_up(scene, comm, mesh, replace(placed, notes=()), cell_rank)
        if comm.bcast(saved is None, root=0):
            block = found.operators.blocks.solid
            lines = unresolved(scene, mesh, placed.wells, RockCells.of(block, block.cell_ids, comm))
            lines += on_root(comm, lambda: unresolved_slip(scene, mesh, placed.wells) if mesh else []) or []
            found = replace(found, placed=replace(found.placed, notes=(*lines, *found.placed.notes)))
    return replace(
        found, stated=model.stated, sides=model.sides, bounded=model.bounded, of_event=True, unmeshed=model.mesh
    )
