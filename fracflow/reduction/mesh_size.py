"""A mesh no finer than a scene needs: sizes where the scene states none, and what a stated mesh does not resolve."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fracflow.diagnostics import slip
from fracflow.diagnostics.fracture_flow import EVENT_STEPS
from fracflow.diagnostics.joints import gather, rock_values
from fracflow.diagnostics.number import CheckInput, spans
from fracflow.mesh.data import Floats, SplitMesh, is_unmeshed
from fracflow.mesh.places import extent_of, place_text
from fracflow.mesh.plane.traces import natural_snap, polygon_area
from fracflow.mesh.read import GROWTH as USUAL
from fracflow.mesh.rock_cells import RockCells
from fracflow.mesh.whole import rock_areas
from fracflow.reduction.cell_growth import growth_beside, has_tip, of_stated, weakens
from fracflow.remarks import note
from fracflow.scene.advice import GENTLE
from fracflow.scene.method import Geometry, Points
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import LENGTH

PER_LENGTH = 16  # joints along a fracture that ends in the rock
PER_SPACING = 4  # joints, in the mean distance of fractures
PER_FRONT = 8  # joints, in the reach of a pressure
PER_WAVE = 10  # cells: lumped mass and trapezoid are 4.6 % slow there (where each wave takes one step through a cell)
PER_TIP = 128  # joints at tips
GROWTH, THRIFTY = 0.12, 0.3  # of sizes per length, and where that takes too many cells; errors go with its square
ACROSS = 20  # cells across the domain, far from all fractures
MOST_CELLS = 100_000
PROPOSED_JOINTS = 2000  # that are proposed in rock that is not meshed: an iteration takes as long as with so many cells
PROPOSED = "{}, the most that are proposed,"
ROUNDS = 5  # of meshing and measuring
FEWEST = 4  # joints along a fracture of the first mesh
PER_TRIANGLE = 4.0 / 3.0**0.5  # cells of size h in an area h^2
SAME = 0.99  # sizes that differ by less need no new mesh
MARGIN = 0.95  # cells of a size asked for differ from it

Build = Callable[[Scene], tuple[SplitMesh, Mapping[str, tuple[int, ...]]]]
"""scene -> its mesh, and the flow nodes of its wells by name"""


def typical_length(lengths: Floats) -> float:
    """Mean of the lengths (n,) of fractures, each weighted by itself: of the ones that matter; inf of none [length]."""
    return float(np.sum(lengths**2) / np.sum(lengths)) if np.sum(lengths) > 0.0 else np.inf


def mean_spacing(area: float, length: float) -> float:
    """1/P21, area over the length of all fractures in it; inf without any (Dershowitz and Herda 1992) [length]."""
    return area / length if length > 0.0 else np.inf


def front_length(conducting: Floats, normal: Floats, held: Floats | float, time: float) -> Floats:
    """sqrt(D t), the reach of a pressure along a fracture: D = C/(1/k_n + c_f d), C = d^3/(12 mu) [length].

    The diffusivity of (3.9) with walls that move by k_n alone, which gives the shortest reach. All arrays are (n,).
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(conducting / (1.0 / normal + held) * time))


def corner_period(length: float, speed: float) -> float:
    """1/f_c of the waves that slip along a length sends out, f_c = 2.34 c_s/(2 pi r) for a radius r = L/2 (Brune 1970) [time].

    Their displacements have little of what is faster.
    """
    return np.pi * length / (2.34 * speed)


def shortest_period(tables: Iterable[TimeTable], start: float, end: float) -> float:
    """Period of the fastest swing of any table between two times; inf where all stand still, 0 where one jumps [time].

    Half of it is the time of a swing over the whole range at the steepest mean slope of a stretch that rises or falls.
    It is exact for a sine, and twice the length of a ramp. Small fast ripples count by their share of the range.
    """
    found = np.inf
    for table in tables:
        times, values = np.array(table.times), np.array(table.values)
        jumps = table.jumps[0]
        if np.any((jumps >= start) & (jumps < end)):
            return 0.0
        if table.interpolation == "step" or not np.ptp(values) > 0.0:
            continue
        turns = np.sign(np.diff(values))
        first = np.flatnonzero(np.append(True, turns[1:] != turns[:-1]))
        last = np.append(first[1:], len(turns))
        change, lasts = np.abs(values[last] - values[first]), times[last] - times[first]
        here = (change > 0.0) & (lasts > 0.0) & (times[first] < end) & (times[last] > start)
        found = min(found, (2.0 * np.ptp(values) * lasts[here] / change[here]).min(initial=np.inf))
    return float(found)


def cell_count(size: float, fine: float, area: float, length: float, growth: float) -> float:
    """Triangles of a mesh of ``size`` that is ``fine`` along fractures of a length, and grows from there to both sides.

    Around a line, 2 L times the integral of 1/(h + g r)^2 is 2 L/(g h).
    """
    graded = area / size**2 + 2.0 * length / (growth * fine)
    return PER_TRIANGLE * min(graded, area / fine**2)


def graded_count(size: float, fine: float, area: float, length: float, growth: float) -> float:
    """The same about fractures that are short beside the domain: around them cells grow in a ring as from one place.

    Around a place, 2 pi times the integral of r/(h + g r)^2 is 2 pi/g^2 (log(H/h) + h/H - 1), to cells of H.
    """
    ring = 2.0 * np.pi / growth**2 * (np.log(size / fine) + fine / size - 1.0) if fine < size else 0.0
    return min(cell_count(size, fine, area, length, growth) + PER_TRIANGLE * ring, PER_TRIANGLE * area / fine**2)


def growth_of(scene: Scene, size: float, corners: Points) -> tuple[float, str]:
    """Growth of cells of ``size`` in an outline, as the scene states it or as its mesh has it, and a line on it, or none.

    A mesh whose sizes follow from the scene has that of its joints. Else it is the usual one, or less where the error would
    exceed that of the joints and not too many cells follow.
    """
    geometry = scene.geometry
    assert geometry is not None
    is_sized = geometry.size is not None or (scene.is_unbounded and geometry.size_at_fractures is not None)
    if geometry.growth is not None or not is_sized:
        return _growth(scene, geometry), ""
    domain, lengths = np.array(corners, dtype=float), trace_lengths(geometry)
    growth, reason = growth_beside(scene, typical_length(lengths[has_tip(geometry, domain)]))
    if growth == USUAL:
        return USUAL, ""
    fine = geometry.size_at_fractures or size
    if cell_count(size, fine, polygon_area(domain), float(lengths.sum()), growth) <= MOST_CELLS:
        return growth, note(f"geometry.growth = {growth:g}: {reason}")
    return USUAL, note(f"geometry.growth = {USUAL:g}: {growth:g} would take over {MOST_CELLS} cells; {reason}")


def affordable(size: float, fine: float, area: float, length: float, growth: float, most: float) -> tuple[float, float]:
    """Sizes that are at least so large that neither part of ``cell_count`` is over half of ``most``."""
    if cell_count(size, fine, area, length, growth) <= most:
        return size, fine
    share = 0.5 * most / PER_TRIANGLE
    fine = max(fine, min(2.0 * length / (growth * share), (area / share) ** 0.5))
    return max(size, (area / share) ** 0.5, fine), fine


@dataclass(frozen=True)
class Need:
    """A length that a mesh must resolve, where the mesh is worst at it.

    what     the length and the number of cells in it
    size     the largest joint or cell that resolves it there [length]
    found    the one there [length]
    along    whether it is joints that must be so short, else cells
    is_listed  whether ``unresolved`` lists it: the pre-run checks list others, or no stated mesh need be like that
    where    fracture or rock, and place
    """

    what: str
    size: float
    found: float
    along: bool
    is_listed: bool = True
    where: str = ""


@dataclass(frozen=True)
class WorstCell:
    """The cell that carries waves worst: its size [length], rock, middle (dim,) and shear speed; the lowest shear speed."""

    size: float
    rock: str
    middle: Floats
    speed: float
    lowest: float


def worst_of(scene: Scene, cells: RockCells) -> WorstCell:
    """Collective."""
    speed = rock_values(scene, cells.rocks)["shear_speed"]
    speed = np.where(np.isnan(speed), np.inf, speed)
    size, rock, middle = cells.largest(speed)
    return WorstCell(size, cells.rocks[rock], middle, float(speed[rock]), float(speed[cells.used()].min()))


def needs(view: CheckInput, mesh: SplitMesh, worst: WorstCell) -> list[Need]:
    """All lengths of a scene, each where its mesh is worst at it."""
    return [*_along_fractures(view, mesh), *_in_rock(view, worst, extent_of(mesh.points))]


def _along_fractures(view: CheckInput, mesh: SplitMesh) -> Iterator[Need]:
    joints = view.joints
    if not len(joints.length):
        return
    middle, extent = mesh.points[mesh.joint_bottom].mean(axis=1), extent_of(mesh.points)

    def need(what: str, size: Floats, is_listed: bool = True) -> Iterator[Need]:
        worst = int(np.argmax(joints.length / size))
        if np.isfinite(size[worst]):
            where = f"{joints.names[joints.fracture[worst]]} at {place_text(middle[worst], extent)}"
            yield Need(what, float(size[worst]), float(joints.length[worst]), True, is_listed, where)

    for what, size in slip.longest_joints(view).items():
        yield from need(what, size, is_listed=False)
    each = np.bincount(joints.fracture, joints.length, len(joints.names))
    tipped = np.unique(joints.fracture[np.any(mesh.joint_bottom == mesh.joint_top, axis=1)])
    typical = np.where(np.isin(joints.fracture, tipped), typical_length(each[tipped]), np.inf)
    yield from need(f"length of fractures / {PER_LENGTH}", typical / PER_LENGTH)
    area = np.inf if is_unmeshed(mesh.cells) else float(rock_areas(mesh).sum())
    spacing = mean_spacing(area, float(joints.length.sum()))
    apart = np.full_like(joints.length, spacing / PER_SPACING)
    yield from need(f"spacing of fractures / {PER_SPACING}", apart, len(tipped) > 0)
    lasts = [end - start for stage, start, end in spans(view.scene) if stage.kind in ("quasi-static", "auto")]
    if view.flows and max(lasts, default=0.0) > 0.0:
        assert view.scene.fluid is not None
        time = min(each for each in lasts if each > 0.0)
        gap = np.nan_to_num(joints.aperture)
        reach = front_length(joints.conducting, joints.normal, view.scene.fluid.compressibility * gap, time).min(axis=1)
        what = f"reach of a pressure in {view.scene.time_text(time, 3)} / {PER_FRONT}"
        # where it comes less far than the gap is wide, nothing is meant to run
        yield from need(what, np.where(reach > gap.max(axis=1), reach, np.inf) / PER_FRONT)


def _in_rock(view: CheckInput, worst: WorstCell, extent: float) -> Iterator[Need]:
    for what, period, is_listed in _periods(view, worst.lowest):
        wave = f"wave of {view.scene.time_text(period, 3)}, {what}, / {PER_WAVE}"
        size = period * worst.speed / PER_WAVE
        if np.isfinite(size):
            yield Need(wave, size, worst.size, False, is_listed, f"{worst.rock} at {place_text(worst.middle, extent)}")


def _periods(view: CheckInput, speed: float) -> Iterator[tuple[str, float, bool]]:
    """Periods of waves in each stage with inertia, none under ten of its steps: of loads, of slip; of jumps if of neither.

    speed  the lowest shear speed
    """
    joints, scene = view.joints, view.scene
    of_slip = np.inf
    if view.drops.any() or view.weakens.any():
        of_slip = corner_period(typical_length(np.bincount(joints.fracture, joints.length).astype(float)), speed)
    for stage, start, end in spans(scene):
        if stage.kind in ("dynamic", "auto"):
            step = stage.time_step if stage.kind == "dynamic" else stage.dynamic_time_step
            of_steps, of_loads = EVENT_STEPS * (step or 0.0), shortest_period(scene.driving_tables, start, end)
            name = f"stage {stage.title}"
            if of_steps < of_loads < np.inf:
                yield f"a load in {name}", of_loads, True
            if of_steps < of_slip < np.inf:
                yield f"of slip in {name}", of_slip, False
            if of_steps > 0.0 and (min(of_loads, of_slip) <= of_steps or (of_loads == of_slip == np.inf)):
                yield f"{EVENT_STEPS} steps of {name}", of_steps, False


def proposed(scene: Scene, build: Build) -> tuple[dict[str, float], list[str]]:
    """Keys of [geometry] that a scene leaves open, as its lengths ask, and why; of a mesh file none.

    The snap follows from the traces, and the growth from what fractures do. Where no ``size`` is stated, meshes the scene by
    ``build``, finer each time, until it resolves all lengths or has MOST_CELLS. On one process.
    """
    geometry = scene.geometry
    if geometry is None:
        return {}, []
    snap, why = _snap(scene, geometry)
    if geometry.is_unbounded:
        keys, reasons = _of_joints(scene, geometry, build, snap)
        return keys, [*why, *reasons]
    domain, traces = np.array(geometry.outline), trace_lengths(geometry)
    area, total, typical = polygon_area(domain), float(traces.sum()), typical_length(traces)
    if geometry.size is not None:
        if not len(traces):
            return snap, why
        if geometry.growth is not None:
            alike, _ = growth_beside(scene, typical_length(traces[has_tip(geometry, domain)]))
            return snap, [*why, *of_stated(geometry.growth, alike)]
        growth, line = growth_of(scene, geometry.size, geometry.outline)
        return snap | {"growth": growth}, [*why, *([line] if line else [])]
    size = float(np.ptp(domain, axis=0).min()) / ACROSS
    width = Need(f"width of the domain / {ACROSS}", size, size, False, is_listed=False)
    fine = min(size, typical / FEWEST, mean_spacing(area, total) / PER_SPACING)
    at_tips, growth = typical / PER_TIP, _growth(scene, geometry)
    size, fine = _with_stated(geometry, size, fine)
    for _ in range(ROUNDS):
        keys = snap | _keys(geometry, size, fine, at_tips, growth, traces)
        trial = scene.with_geometry({**keys, "refine": 0})
        mesh, wells = build(trial)
        view = CheckInput(trial, gather(trial, mesh, wells))
        found = [width, *needs(view, mesh, worst_of(trial, RockCells.of(mesh)))]
        crowding = len(mesh.cells) / cell_count(size, fine, area, total, growth)
        finer = _finer(size, found, along=False), _finer(fine, found, along=True)
        is_dear = crowding * cell_count(*finer, area, total, growth) > MOST_CELLS and np.isfinite(at_tips)
        if is_dear:
            at_tips, growth, crowding = np.inf, max(growth, THRIFTY), 1.0
        finer = _with_stated(geometry, *affordable(*finer, area, total, growth, MOST_CELLS / crowding))
        if not is_dear and finer[0] >= SAME * size and finer[1] >= SAME * fine:
            break
        size, fine = finer
    if not np.any(mesh.joint_bottom == mesh.joint_top):
        keys.pop("size_at_tips", None)  # no tip is in the rock: the same mesh
    unit = {key: view.unit(LENGTH) for key in keys} | {"growth": ""}
    sizes = {key: value for key, value in keys.items() if key not in snap}
    most = PROPOSED.format(f"{MOST_CELLS} cells")
    return keys, [
        *why,
        *(note(f"geometry.{key} = {value:g}{unit[key]}: {_why(key, found, most)}") for key, value in sizes.items()),
    ]


def _of_joints(
    scene: Scene, geometry: Geometry, build: Build, snap: dict[str, float]
) -> tuple[dict[str, float], list[str]]:
    """The same of fractures in rock that is not meshed."""
    if geometry.size_at_fractures or geometry.size:
        return snap, []
    traces = trace_lengths(geometry)
    typical = typical_length(traces)
    least = max(float(traces.sum()) / PROPOSED_JOINTS, geometry.size_at_tips or 0.0)
    fine = max(_three_digits(typical / PER_LENGTH), geometry.size_at_tips or 0.0)
    for _ in range(ROUNDS):
        keys = snap | _keys(geometry, fine, fine, typical / PER_TIP, _growth(scene, geometry), traces)
        del keys["size"]
        trial = scene.with_geometry({**keys, "refine": 0})
        mesh, wells = build(trial)
        view = CheckInput(trial, gather(trial, mesh, wells))
        found = list(_along_fractures(view, mesh))
        finer = _three_digits(max(_finer(fine, found, along=True), least))
        if finer >= SAME * fine:
            break
        fine = finer
    told = [key for key in ("size_at_fractures", "size_at_tips") if key in keys]
    is_as_tips = fine == geometry.size_at_tips
    most = "joints as long as geometry.size_at_tips" if is_as_tips else PROPOSED.format(f"{PROPOSED_JOINTS} joints")
    return keys, [note(f"geometry.{key} = {keys[key]:g}{view.unit(LENGTH)}: {_why(key, found, most)}") for key in told]


def _snap(scene: Scene, geometry: Geometry) -> tuple[dict[str, float], list[str]]:
    """The snap of traces that state none, and why it is so."""
    if geometry.snap is not None or not geometry.fracture:
        return {}, []
    traces = [(trace.name, np.array(trace.points, dtype=float)) for trace in geometry.fracture]
    snap, why = natural_snap(np.array(geometry.outline, dtype=float), traces)
    unit = scene.unit_system.behind(LENGTH)
    return {"snap": snap}, [note(f"geometry.snap = {snap:g}{unit}: {why}")]


def _growth(scene: Scene, geometry: Geometry) -> float:
    if geometry.growth is not None:
        return geometry.growth
    return GENTLE if weakens(scene) else GROWTH


def trace_lengths(geometry: Geometry) -> Floats:
    """Length (t,) of each trace [length]."""
    points = [np.array(trace.points, dtype=float) for trace in geometry.fracture]
    return np.array([np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each in points])


def _with_stated(geometry: Geometry, size: float, fine: float) -> tuple[float, float]:
    """Sizes of three digits that do not contradict what the scene does state."""
    size, fine = _three_digits(size), _three_digits(fine)
    stated = geometry.size_at_fractures
    fine = stated or max(min(fine, size), geometry.size_at_tips or 0.0, 2.0 * (geometry.snap or 0.0))
    return max(size, fine), fine


def _three_digits(size: float) -> float:
    """A size no larger."""
    unit = 10.0 ** (np.floor(np.log10(size)) - 2.0)
    return float(f"{np.floor(size / unit + 1e-9) * unit:.3g}")


def _keys(
    geometry: Geometry, size: float, fine: float, at_tips: float, growth: float, traces: Floats
) -> dict[str, float]:
    keys = {"size": size}
    if not len(traces):
        return keys
    if geometry.size_at_fractures is None:
        keys["size_at_fractures"] = fine
        if geometry.size_at_tips is None and at_tips < fine:
            keys["size_at_tips"] = _three_digits(at_tips)
    if growth != geometry.growth:
        keys["growth"] = growth
    return keys


def _finer(size: float, found: list[Need], along: bool) -> float:
    """The least size asked for, or less where cells of that size are too large all the same."""
    needed = [need for need in found if need.along == along]
    asked = min([size, *(need.size for need in needed)])
    return min([asked, *(MARGIN * size * need.size / need.found for need in needed if need.found > need.size >= size)])


def _why(key: str, found: list[Need], most: str) -> str:
    if key == "size_at_tips":
        return f"length of fractures / {PER_TIP}"
    if key == "growth":
        return "rock far from a tip is as coarse as its strains are smooth"
    least = min((need for need in found if key == "size_at_fractures" or not need.along), key=lambda need: need.size)
    short = f"; {most} do not reach it" if least.found > least.size else ""
    return f"{least.what} = {least.size:.3g}{least.where and f', {least.where}'}{short}"
