"""Sides that are far: a bounded rock whose sides hardly act on its fractures is run without these, and without a mesh.

Stress beside a fracture of half length a falls as (a/r)^2, SHED to 1.5 times its own change of stress (Sneddon 1946). A held
side sends back about the stress that reaches it: that is the error of leaving it out. Before a run it follows from lengths.
In each step it follows from the jumps D. Their largest principal stress along the sides is taken over the change of stress
along the fractures, int D.t/int |D|.

Sides that are held all round also keep the volume of the rock. A net volume V of open fractures squeezes its area A by V/A,
and it presses back with (lambda + G) V/A. A fracture that a change of stress S opens has V = 2 pi a^2 S/E'. So
pi a^2/A (1 - nu)/(1 - 2 nu) of S comes back: 4 (a/R)^2 in a box of 2 R for nu = 0.45, 200 (a/R)^2 for 0.499.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from fracflow.elements import dislocation
from fracflow.errors import ReductionInvalid
from fracflow.mesh.agreement import on_root
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.mesh.plane.traces import polygon_area
from fracflow.mesh.read import side_names
from fracflow.model.setup import FarSides, Model
from fracflow.model.state import State
from fracflow.reduction.decision import Decision, ReductionInput, tolerance_of
from fracflow.reduction.mesh_size import ACROSS, graded_count, growth_of, trace_lengths, typical_length
from fracflow.reduction.sliced import Kept
from fracflow.remarks import digits, note
from fracflow.scene.quantities import probed
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH
from fracflow.solve.rock_cost import direct, unmeshed

PART = "sides and mesh of the rock"
CRITERION = (
    "stress of all fractures on the sides, and what keeps the volume of the rock, over the change of stress along them"
)
SHED = 1.0  # stress at a distance r, over (a/r)^2 of the change along a fracture, in the mean of all directions
ANSWER = 2.0  # error at the fractures, over the stress that reaches the sides: a margin
ANSWERED = 0.4  # of slip, over (a/r)^2: 0.3 to 0.5 at held sides
ALARMING = 0.1  # change of slip from which on a line says so
BULKY = 0.4  # Poisson's ratio up to which a line on distances is enough: fractures of a network seldom all open wide
ENDS = 1e-3  # of its half length: a fracture that comes so near to a side ends there
PLACES = 16  # along a side, and from bend to bend of a trace, where stresses and distances are looked at
PER_FRACTURE = 16  # joints, where the scene states no size
TIPPED = 12.0  # joints that finer tips add to a fracture
AT_TIPS = 4.0  # times finer joints at tips than elsewhere
CLEARLY = 1.25  # times less CPU time of an iteration: prices are as exact as that
LEAST = 0.01  # CPU s of one: less is not worth another model

Reach = tuple[float, float, str]
"""Half the extent of a fracture and how far the nearest side is [length], and its name."""


def why_meshed(scene: Scene) -> str:
    """Why a scene with sides needs them, or a mesh, wherever they are; empty where their distance decides."""
    return next(_obstacles(scene), "")


def one_obstacle(scene: Scene) -> list[str]:
    """A line on the one thing, but inertia, that keeps the mesh of a scene with far sides, where that costs time; else none."""
    if scene.geometry is None or scene.is_unbounded or not scene.geometry.fracture or scene.model != "default":
        return []
    found, (meshed, without) = list(_obstacles(scene)), _cpu(scene)
    if (
        len(found) != 1
        or any(stage.kind == "dynamic" for stage in scene.stage)
        or estimated(scene) >= tolerance_of(scene)
        or meshed < max(LEAST, CLEARLY * without)
    ):
        return []
    faster = f"else an iteration would be some {meshed / max(without, 1e-3):.2g} times faster"
    return [note(f"one thing keeps the mesh of the rock, whose sides are far: {found[0]}; {faster}")]


def _obstacles(scene: Scene) -> Iterator[str]:
    """All that keeps sides or a mesh wherever the sides are, one of each kind."""
    geometry = scene.geometry
    assert geometry is not None
    if odd := [stage.title for stage in scene.stage if stage.kind not in ("auto", "quasi-static", "steady")]:
        yield f"stage {odd[0]} has inertia, or begins out of balance"
    if scene.body_force is not None or scene.initial is not None or scene.carries_unbalanced:
        yield "a start that is not at rest, or forces on the volume of the rock"
    if any(rock.rigid for rock in scene.rock.values()):
        yield "the rock is rigid"
    if scene.load or scene.tie or scene.term_tables.keys() - {"absorbing"}:
        yield "loads, ties or terms on its sides, whose work is not counted in rock without sides"
    if any(each.waves or each.without_inertia != "held" for each in scene.absorbing):
        yield "absorbing sides that waves come in by, or that are free without inertia"
    moving = (s for s in scene.support if s.displacement is not None or s.displacement_gradient is not None)
    if (mover := next(moving, None)) is not None:
        yield f"support on {mover.on[0]} moves"
    if free := _free_sides(scene):
        yield f"side {free[0]} is not held in x and y"
    if any(well.on is not None for well in scene.well):
        yield "a well is on a side"
    on_joints = {name for name, row in probed().items() if row.home in ("section", "flow")}
    for probe in scene.probe:
        if probe.quantities is None or not on_joints.issuperset(probe.quantities):
            what = "displacement" if probe.quantities is None else min({*probe.quantities} - on_joints)
            yield (
                f"probe {probe.name} measures {what}, to which sides add by length over distance, not by its square"
                " (its quantities may leave that out)"
            )
            break
    if scene.output.fields_every:
        yield "output.fields_every asks for fields of the rock up to its sides"
    method = scene.method
    if method.stepper == "explicit" and scene.has_dynamics:
        yield 'method.stepper = "explicit" divides by the mass of cells, also before an event'
    if method.coupling != "auto" or method.rock_solver != "auto" or scene.petsc or geometry.cells != "triangles":
        yield "its solver or its cells are stated"


def _free_sides(scene: Scene) -> list[str]:
    """Sides that are not held in both x and y, where there is no inertia."""
    assert scene.geometry is not None
    held = _held(scene)
    sides = side_names(np.array(scene.geometry.outline, dtype=float))
    return [side for side in sides if not {(side, "x"), (side, "y")} <= held]


def _held(scene: Scene) -> set[tuple[str, str]]:
    """Sides and the components in which something holds them, where there is no inertia."""
    held = {(name, part) for each in scene.absorbing for name in each.on for part in "xy"}
    return held | {(name, part) for support in scene.support for name in support.on for part in support.components}


def estimated(scene: Scene) -> float:
    """Error of leaving out the sides, by the lengths of fractures and their distances from the sides [1]."""
    lengths = list(_half_and_distance(scene))
    return _error(
        SHED * sum((half / max(away, ENDS * half)) ** 2 for half, away, _ in lengths),
        _pressed_back(scene, sum(half**2 for half, _, _ in lengths), _stated_area(scene)),
    )


def _error(reaches: float, back: float) -> float:
    """Error by the stress that reaches the sides, and by the one with which they answer a net volume, in any unit."""
    return max(ANSWER * reaches, reaches + back)


def _stated_area(scene: Scene) -> float:
    """Area of [geometry] [area]."""
    assert scene.geometry is not None
    return polygon_area(np.array(scene.geometry.outline, dtype=float))


def _pressed_back(scene: Scene, squares: float, area: float) -> float:
    """The stress with which held sides answer open fractures, over what these change [1]; none in a scene without a fluid.

    squares  sum of their squared half lengths [area]
    area     between the sides [area]
    """
    nu = _largest_nu(scene)
    return np.pi * squares / area * (1.0 - nu) / (1.0 - 2.0 * nu) if scene.has_flow else 0.0


def _largest_nu(scene: Scene) -> float:
    """The largest Poisson's ratio of the rocks that deform, below 0.5; 0 without any."""
    return max((rock.poissons_ratio or 0.0 for rock in scene.rock.values() if not rock.rigid), default=0.0)


def near_sides(model: Model) -> list[str]:
    """A line on what sides change most, if anything: rock that goes on would let fractures slip and open farther.

    Sides that absorb waves send back little before rest. Collective.
    """
    scene, blocks = model.scene, model.operators.blocks
    if scene.is_unbounded or (scene.absorbing and all(stage.kind == "dynamic" for stage in scene.stage)):
        return []
    if scene.geometry is not None:
        return _near(scene, list(_half_and_distance(scene)), _stated_area(scene), not _free_sides(scene))
    if blocks.sizes.dim != 2 or all(rock.rigid for rock in scene.rock.values()):
        return []
    hulls = blocks.comm.allgather(_hull(blocks.solid.points))
    start = _hull(np.concatenate(hulls))
    edge = np.roll(start, -1, axis=0) - start
    area = 0.5 * float(np.sum((start[:, 0] - start[0, 0]) * edge[:, 1] - (start[:, 1] - start[0, 1]) * edge[:, 0]))
    keeps_volume = _held_length(scene, blocks) > (1.0 - ENDS) * float(np.linalg.norm(edge, axis=1).sum())
    lengths = on_root(blocks.comm, lambda: None if model.mesh is None else _in_hull(model.mesh, start, edge))
    return blocks.comm.bcast(None if lengths is None else _near(scene, lengths, area, keeps_volume), root=0)


def _hull(points: Floats) -> Floats:
    """Corners (h, 2) of the convex hull of points (n, 2), counter-clockwise, by quickhull (Barber and others 1996)."""
    if not len(points) or not np.ptp(points, axis=0).any():
        return points[:1]
    left, right = points[points[:, 0].argmin()], points[points[:, 0].argmax()]
    least = 1e-9 * float(np.ptp(points, axis=0).max())  # beside a line: nodes along it are on it
    return np.array([left, *_beyond(points, left, right, least), right, *_beyond(points, right, left, least)])


def _beyond(points: Floats, start: Floats, end: Floats, least: float) -> list[Floats]:
    """Corners of the hull on the right of the way from ``start`` to ``end``, in its direction."""
    edge = end - start
    height = (points - start) @ np.array([edge[1], -edge[0]]) / max(float(np.linalg.norm(edge)), least)
    if height.max(initial=0.0) <= least:
        return []
    top, others = points[height.argmax()], points[height > least]
    return [*_beyond(others, start, top, least), top, *_beyond(others, top, end, least)]


def _near(scene: Scene, lengths: list[Reach], area: float, is_held: bool) -> list[str]:
    """The line on fractures of such ``lengths`` between sides around an area, which are held all round or not."""
    changed = [(ANSWERED * (half / away) ** 2, half, away, name) for half, away, name in lengths if away > ENDS * half]
    near = sorted((each for each in changed if each[0] > ALARMING), reverse=True)
    keeps_volume = is_held and _largest_nu(scene) > BULKY
    back = 0.0 if not keeps_volume else _pressed_back(scene, sum(half**2 for half, _, _ in lengths), area)
    is_drawn = scene.geometry is not None
    free = 'geometry.domain = "unbounded"' if is_drawn else '[geometry] with domain = "unbounded" in place of [mesh]'
    if back > max([ALARMING, *(each[0] for each in near)]):
        return [
            f"sides: held all round, they keep the volume of the rock. With poissons_ratio = {_largest_nu(scene):g} fractures"
            f" that open wide do so by up to {digits(100 * back / (1 + back))} % less than in rock that goes on there: put"
            f" the sides {(back / ALARMING) ** 0.5:.2g} times as far away for a tenth, or give {free}"
        ]
    if not near:
        return []
    change, half, away, name = near[0]
    unit, enough = scene.unit_system.behind(LENGTH), (ANSWERED / ALARMING) ** 0.5 * half
    others = f" (so near for their lengths: {len(near) - 1} more)" if len(near) > 1 else ""
    return [
        f"sides: {name}, {digits(2 * half, 3)}{unit} long, comes within {digits(away, 3)}{unit} of a side{others}: if the rock"
        f" goes on there in fact, slip and opening may be off by up to {digits(100 * change / (1 + change))} %; sides"
        f" {digits(enough)}{unit} away leave a tenth, and {free} has none"
    ]


def _in_hull(mesh: SplitMesh, start: Floats, edge: Floats) -> list[Reach]:
    """The same as ``_half_and_distance``, of a mesh in a convex hull with corners and edges (h, 2), counter-clockwise.

    A fracture that ends on a side is at 0. A domain that is not convex has sides nearer than those of its hull.
    """
    ends, count = mesh.points[mesh.joint_bottom], len(mesh.fractures)
    least, most = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for point in (ends[:, 0], ends[:, 1]):
        np.minimum.at(least, mesh.joint_fracture, point)
        np.maximum.at(most, mesh.joint_fracture, point)
    is_last = np.bincount(mesh.joint_flow.ravel(), minlength=len(mesh.flow_origin))[mesh.joint_flow] == 1
    is_open = np.any(is_last & (mesh.joint_bottom != mesh.joint_top), axis=1)  # at a tip in the rock walls share a node
    away = np.full(count, np.inf)
    inward = np.column_stack([-edge[:, 1], edge[:, 0]]) / np.linalg.norm(edge, axis=1)[:, None]
    for corner, normal in zip(start, inward, strict=True):
        np.minimum.at(away, mesh.joint_fracture, ((ends - corner) @ normal).min(axis=1))
    away[mesh.joint_fracture[is_open]] = 0.0
    half = 0.5 * np.linalg.norm(most - least, axis=1)
    meshed = np.unique(mesh.joint_fracture).tolist()
    return [(float(half[number]), float(away[number]), mesh.fractures[number]) for number in meshed]


def _held_length(scene: Scene, blocks: Blocks) -> float:
    """How long the named sides are together that are held in x and y [length]. Collective."""
    held, solid = _held(scene), blocks.solid
    chosen = np.array([{(side, "x"), (side, "y")} <= held for side in solid.sides], dtype=bool)[solid.side_of]
    ends = solid.points[solid.side_facets[chosen][:, :2]]
    return float(blocks.comm.allreduce(float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())))


def _half_and_distance(scene: Scene) -> Iterator[Reach]:
    """Half the extent of each fracture, how far the nearest side is [length], and its name."""
    assert scene.geometry is not None
    for trace in scene.geometry.fracture:
        points = _places(trace.points)
        half = 0.5 * float(np.linalg.norm(np.ptp(points, axis=0)))
        yield (
            half,
            min(float(np.linalg.norm(points - near, axis=1).min()) for near in _nearest(scene, points)),
            trace.name,
        )


def _along_sides(scene: Scene) -> Floats:
    """Places (m, 2) along the sides, evenly and where fractures are nearest to them."""
    assert scene.geometry is not None
    corners = np.array(scene.geometry.outline, dtype=float)
    share = ((np.arange(PLACES) + 0.5) / PLACES)[:, None, None]
    even = (corners + share * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    traces = [_places(trace.points) for trace in scene.geometry.fracture]
    return np.concatenate([even, *(near for points in traces for near in _nearest(scene, points))])


def _places(trace: Sequence[Sequence[float]]) -> Floats:
    """Places (n, 2) along a trace, its bends among them."""
    points = np.array(trace, dtype=float)
    share = (np.arange(PLACES) / PLACES)[:, None, None]
    return np.concatenate([(points[:-1] + share * np.diff(points, axis=0)).reshape(-1, 2), points[-1:]])


def _nearest(scene: Scene, points: Floats) -> Iterator[Floats]:
    """The places (n, 2) of each side that are nearest to the points (n, 2)."""
    assert scene.geometry is not None
    corners = np.array(scene.geometry.outline, dtype=float)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
        yield start + share[:, None] * along


def _cpu(scene: Scene) -> tuple[float, float]:
    """CPU s of an iteration of Newton's method with a mesh, and without. Levels of a study agree in it."""
    geometry = scene.geometry
    assert geometry is not None
    corners, lengths = np.array(geometry.outline, dtype=float), trace_lengths(geometry)
    size = geometry.size or float(np.ptp(corners, axis=0).min()) / ACROSS
    fine = geometry.size_at_fractures or geometry.size or min(size, typical_length(lengths) / PER_FRACTURE)
    growth, _ = growth_of(scene, size, geometry.outline)
    cells = graded_count(size, fine, polygon_area(corners), float(lengths.sum()), growth)
    joints = float(lengths.sum()) / fine + TIPPED * len(lengths)
    return direct(int(cells)).seconds, unmeshed(joints)


def assessed(scene: Scene) -> FarSides | None:
    """Whether a scene may do without its sides; None where it has none, or asks for the whole model."""
    if scene.geometry is None or scene.is_unbounded or not scene.geometry.fracture or scene.model != "default":
        return None
    if why := why_meshed(scene):
        return FarSides(why=why)
    error, (meshed, without) = estimated(scene), _cpu(scene)
    why = "" if error < tolerance_of(scene) else "the sides are too near"
    if not why and (meshed < LEAST or meshed < CLEARLY * without):
        why = f"an iteration takes some {meshed:.1g} CPU s with a mesh, and {without:.1g} s without"
    return FarSides(error, meshed / max(without, 1e-3), why)


def without_sides(scene: Scene) -> Scene:
    """The scene in rock without sides.

    Joints at tips that it states no size for are finer, which costs next to nothing, unless waves may have to pass them.
    """
    assert scene.geometry is not None
    keys: dict[str, object] = {"domain": "unbounded"}
    fine = scene.geometry.size_at_fractures or scene.geometry.size
    if scene.geometry.size_at_tips is None and fine is not None and not scene.has_dynamics:
        keys["size_at_tips"] = fine / AT_TIPS
    geometry = scene.geometry.model_copy(update=keys)
    return scene.model_copy(update={"geometry": geometry, "support": (), "absorbing": ()})


def is_left_out(found: FarSides | None, saved: Kept | None, undone: Mapping[str, str]) -> bool:
    """Whether sides are left out; the mesh of a run that goes on says so, as long as that is not undone."""
    if found is None or found.why or PART in undone:
        return False
    return saved is None or not saved.has_cells


def decide_sides(facts: ReductionInput) -> Iterator[Decision]:
    """Whether the rock has sides, and a mesh."""
    if (sides := facts.sides) is None:
        return
    value = sides.why if not sides.error else sides.error
    until = ", until an event needs inertia" if facts.scene.has_dynamics else ""
    saves = f"nothing: {sides.why}" if sides.why else f"the mesh: {sides.faster:.2g} times faster iterations{until}"
    error = (
        f"of jumps, tractions and pressures, relative to the largest: at most {facts.tolerance:g}, checked in each step"
    )
    yield Decision(PART, not sides.why, CRITERION, value, facts.tolerance, error, saves)


def watch_sides(model: Model, state: State) -> None:
    """Raise ReductionInvalid, on every rank, where sides that were left out would change jumps by the tolerance. Collective."""
    if model.bounded is None or model.of_event:
        return
    error, tolerance = error_of_sides(model, state), tolerance_of(model.bounded)
    if error > tolerance:
        raise ReductionInvalid(
            PART, state.time, f"sides would change results by up to {error:.2g}, above {tolerance:g}"
        )


def error_of_sides(model: Model, state: State) -> float:
    """Error of leaving out the sides, by the jumps of a state [1]. Collective."""
    ops = model.operators
    moved, force = state.motion.displacement, ops.layout.solid_vector()
    ops.rock_force(moved, force)
    work = float(force.dot(moved))
    force.destroy()
    motion = ops.gathered(moved)
    comm, found = ops.layout.comm, 0.0
    if motion is not None and work > ops.scales.energy_noise(int(ops.layout.solid_starts[-1])):
        assert model.mesh is not None and model.bounded is not None and model.bounded.geometry is not None
        mesh, (rock,) = model.mesh, model.scene.rock.values()
        ends, jumps = mesh.points[mesh.joint_bottom], motion[mesh.joint_top] - motion[mesh.joint_bottom]
        along = _along_sides(model.bounded)
        xx, yy, xy = dislocation.stresses(along, ends, jumps, rock.plane_strain_modulus).T
        most = float((np.abs(0.5 * (xx + yy)) + np.hypot(0.5 * (xx - yy), xy)).max())
        facing = (ends[:, 1] - ends[:, 0]) @ np.array([[0.0, 1.0], [-1.0, 0.0]])  # normals, as long as the joints
        opened = abs(float((facing * jumps.mean(axis=1)).sum()))
        area, nu = _stated_area(model.bounded), _largest_nu(model.scene)
        stiff = rock.plane_strain_modulus * (1.0 - nu) / (2.0 * (1.0 - 2.0 * nu))  # lambda + G
        length = np.linalg.norm(facing, axis=1)
        total = float(length @ np.linalg.norm(jumps, axis=2).mean(axis=1))
        found = _error(most, stiff * opened / area) * total / work
    return float(comm.bcast(found, root=0))
