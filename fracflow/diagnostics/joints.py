"""Values of every joint that the pre-run checks need, gathered once from the scene and its split mesh, on one process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fracflow.elements import facet, joint
from fracflow.laws import JOINT_LAWS, JointLaw, keys_of, make_law, parameters_of
from fracflow.laws.elastic import p_wave_modulus, plane_strain_modulus, shear_modulus
from fracflow.mesh.data import Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.graph import components, distances
from fracflow.mesh.whole import block_areas, rock_areas
from fracflow.model.properties import initial_pressure, initial_stress
from fracflow.scene.profiles import sample
from fracflow.scene.scene import Scene
from fracflow.scene.tables import Fracture

Bools = np.ndarray
ROWS_AT_ONCE = (
    2**12
)  # cells or joints that are looked at together: what is found meanwhile takes several times their memory


@dataclass(frozen=True)
class CheckJoints:
    """Values of all joints (j,), or at their two ends (j, 2); NaN where the scene does not say.

    names, fracture  names of the fractures, and the one of each joint
    length           h [length]
    normal, shear    (j, 2) k_n and k_s at the initial state [stress/length]
    aperture         (j, 2) d at the initial state [length]
    conducting       (j, 2) flow per thickness and pressure gradient: d^3/(12 mu), or what is given
    is_cubic         (j,) whether the cubic law gives it
    laws             the law of each fracture
    drop             (j, 2) by how much strength falls with slip at the initial normal traction; 0 where it does not [stress]
    distance         (j, 2) slip over which it does: 0 where it falls at once, inf where it does not [length]
    direct, evolution  (j, 2) a sigma and b sigma of friction with a state at the initial normal traction; else 0 [stress]
    state_length     (j, 2) D_c of that friction; else inf [length]
    front_length     (j, 2) the slip over which the state evolves at a front; else inf [length]
    state, steady    (j, 2) its theta at the start [time], and V theta/D_c, 1 of steady slip; else NaN
    modulus          E' = E/(1 - nu^2) of the rock beside, two rocks in series; inf where both are rigid [stress]
    mode_2_modulus   mu* = G/(1 - nu) of slip in the plane, likewise [stress]
    layer            E' D, likewise, D the depth of each connected block: its area over the length of its joints
                     [stress length]
    shear_speed      (j, 2) c_s of the rock below and above; inf of a rigid one [length/time]
    softer           mu of the one of the lower c_s [stress]
    impedance        rho c_p of both sides in series, rho c_p/2 where they are equal [stress time/length]
    mass             m_rel, what of the walls' lumped masses moves against each other, per length of joint; rho h/4 between
                     equal cells of depth h [stress time^2/length]
    component        hydraulic component
    reach            of its component, the longest way along the network to a prescribed pressure; inf where none is [length]
    used             (j, 2) |f_s|/f_sy at the start, above 1 where it is past its strength; NaN of laws without one
    is_held          (j,) whether its fracture has a prescribed pressure, so that its flow has no equation
    """

    names: tuple[str, ...]
    fracture: Ints
    length: Floats
    normal: Floats
    shear: Floats
    aperture: Floats
    conducting: Floats
    is_cubic: Bools
    laws: tuple[type[JointLaw], ...]
    drop: Floats
    distance: Floats
    direct: Floats
    evolution: Floats
    state_length: Floats
    front_length: Floats
    state: Floats
    steady: Floats
    modulus: Floats
    mode_2_modulus: Floats
    layer: Floats
    shear_speed: Floats
    softer: Floats
    impedance: Floats
    mass: Floats
    component: Ints
    reach: Floats
    used: Floats
    is_held: Bools


def gather(scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> CheckJoints:
    """The joints of a mesh; ``wells`` name -> flow nodes."""
    length = np.linalg.norm(np.diff(mesh.points[mesh.joint_bottom], axis=1)[:, 0], axis=-1)
    tables = joints_of_tables(scene, mesh)

    def ends(key: str) -> Floats:
        return at_ends(mesh, tables, key)

    aperture, given = ends("aperture"), ends("conductance")
    viscosity = scene.fluid.viscosity if scene.fluid is not None and scene.has_flow else np.nan
    cubic = np.maximum(ends("hydraulic"), ends("minimum_hydraulic_aperture")) ** 3 / (12.0 * viscosity)
    sheared, normal = initial_tractions(scene, mesh)
    drop, distance, *states = _of_laws(mesh, tables, sheared, normal)
    laws = tuple(JOINT_LAWS[scene.fracture_named(name).law] for name in mesh.fractures)
    slides = np.array([bool(law.status) and law.slides for law in laws], dtype=bool)[mesh.joint_fracture]
    strength = np.nan_to_num(ends("cohesion")) + np.maximum(-normal, 0.0) * ends("friction")
    has_strength = slides[:, None] & (strength > 0.0)
    rock, sides = rock_values(scene, mesh.rocks), mesh.cell_rock[mesh.joint_cells]
    component, reach = _reaches(scene, mesh, wells, length)
    speed = rock["shear_speed"][sides]
    return CheckJoints(
        names=mesh.fractures, fracture=mesh.joint_fracture, length=length, normal=ends("normal_stiffness"),
        shear=ends("shear_stiffness"), aperture=aperture, conducting=np.where(np.isnan(given), cubic, given),
        is_cubic=np.isnan(given).all(axis=1), drop=drop, distance=distance,
        direct=states[0], evolution=states[1], state_length=states[2], state=states[3], steady=states[4],
        front_length=states[5],
        laws=laws, used=np.where(has_strength, np.abs(sheared) / np.where(has_strength, strength, 1.0), np.nan),
        modulus=2.0 * _in_series(rock["modulus"][sides]), mode_2_modulus=2.0 * _in_series(rock["mode_2_modulus"][sides]),
        layer=_in_series(rock["modulus"][sides] * _depths(mesh, length)),
        shear_speed=speed, softer=_of_slower(speed, rock["shear"][sides]), impedance=_in_series(rock["impedance"][sides]),
        mass=_in_series(_wall_masses(mesh, rock["density"], rock["rigid"], length)),
        component=component, reach=reach, is_held=_held(scene, mesh),
    )  # fmt: skip


def joints_of_tables(scene: Scene, mesh: SplitMesh) -> list[tuple[Fracture, Ints]]:
    """The tables of the fractures of a mesh, each with the joints (n,) that it is of, ascending."""
    tables = [scene.fracture_named(name) for name in mesh.fractures]
    known = {id(table): table for table in tables}  # most fractures of a network have one
    number = {key: row for row, key in enumerate(known)}
    of_joint = np.array([number[id(table)] for table in tables], dtype=np.int64)[mesh.joint_fracture]
    return [(table, np.flatnonzero(of_joint == row)) for row, table in enumerate(known.values())]


def at_ends(mesh: SplitMesh, tables: Sequence[tuple[Fracture, Ints]], key: str) -> Floats:
    """The value (j, 2) that a key has in the table of each joint, at its ends; NaN where it has none, or is not among them."""
    values = np.full(mesh.joint_along.shape, np.nan)
    for table, joints in tables:
        values[joints] = sample(getattr(table, key, None), mesh.joint_along[joints])
    return values


def initial_tractions(scene: Scene, mesh: SplitMesh) -> tuple[Floats, Floats]:
    """f_s0 and effective f_n0 (j, 2) at the joint ends, as given or else of the initial stress and pressure (2.14) [stress]."""
    places = mesh.points[mesh.joint_bottom]
    if not len(places):
        return np.zeros((0, 2)), np.zeros((0, 2))
    sigma = initial_stress(scene, places)[..., :2, :2]
    frame = np.repeat(facet.frame(places)[0], 2, axis=0)
    traction = joint.traction_from_stress(frame, sigma.reshape(-1, 2, 2)).reshape(*places.shape[:2], 2)
    tables = joints_of_tables(scene, mesh)
    shear, normal = (at_ends(mesh, tables, f"initial_{part}_traction") for part in ("shear", "normal"))
    shear = np.where(np.isnan(shear), traction[..., 0], shear)
    return shear, np.where(np.isnan(normal), traction[..., 1] + initial_pressure(scene, places), normal)


def _of_laws(
    mesh: SplitMesh, tables: Sequence[tuple[Fracture, Ints]], sheared: Floats, normal: Floats
) -> tuple[Floats, ...]:
    """Fall of strength (j, 2) under initial tractions f_s0 and f_n0 (j, 2), and the slip (j, 2) over which it comes.

    Then direct and evolution effect, slip of evolution, theta at the start and V theta/D_c of friction with a state, and
    slip of evolution at a front.
    """
    creeps, shape = any(JOINT_LAWS[table.law].creeps for table, _ in tables), normal.shape
    found = [np.full(shape, value) for value in (0.0, np.inf)]
    states = (0.0, 0.0, np.inf, np.nan, np.nan, np.inf)
    found += [np.full(shape, value) if creeps else np.broadcast_to(value, shape) for value in states]
    for table, joints in tables:
        for here in np.split(joints, range(ROWS_AT_ONCE, len(joints), ROWS_AT_ONCE)):
            values = _of_table(table, mesh.joint_along[here], sheared[here], normal[here])
            for into, each in zip(found if creeps else found[:2], values, strict=False):
                into[here] = each.reshape(-1, 2)
    return tuple(found)


def _of_table(table: Fracture, along: Floats, sheared: Floats, normal: Floats) -> list[Floats]:
    """The same (2 n,) of joints of one table, at distances (n, 2) along their fractures; fewer of friction without a state."""
    law = JOINT_LAWS[table.law]
    given = {
        each: sample(getattr(table, "friction" if each == "friction_coefficient" else each), along).ravel()
        for each in (*_numbers_of(table.law), "normal_stiffness", "shear_stiffness", "aperture")
        if each in {field.name for field in parameters_of(law)}
    }
    made, pressures, count = make_law(table.law, **given), np.maximum(-normal, 0.0).ravel(), normal.size
    values = [made.strength_drop(pressures), made.slip_length(count), *made.rate_effects(pressures)]
    if not law.creeps:
        return values
    evolves = made.state_length(made.initial_history(count, 2))
    tractions = dict(initial_normal_traction=normal.ravel(), initial_shear_traction=sheared.ravel())
    words = [key for key, meaning in keys_of(law).items() if meaning.choices]
    choices = {key: np.full(count, getattr(table, key, None) or "") for key in words}
    of_scene = make_law(table.law, **given, **tractions, **choices)
    start = of_scene.initial_history(count, 2)
    age = of_scene.contact_age(start)
    return [*values, evolves, age, of_scene.slip_rate(start) * age / evolves, of_scene.front_length(start)]


def _numbers_of(law: str) -> Iterator[str]:
    """Keys of a law whose values are numbers."""
    return (name for name, key in keys_of(JOINT_LAWS[law]).items() if not key.choices)


def _of_slower(speed: Floats, values: Floats) -> Floats:
    """The value (j,), of pairs (j, 2), on the side of the lower speed."""
    side = np.argmin(np.where(np.isnan(speed), np.inf, speed), axis=1) if len(speed) else np.zeros(0, dtype=int)
    return values[np.arange(len(values)), side]


def _in_series(sides: Floats) -> Floats:
    """1/(1/a + 1/b) of pairs (j, 2)."""
    with np.errstate(divide="ignore"):
        result: Floats = 1.0 / (1.0 / sides).sum(axis=1)
    return result


def rock_values(scene: Scene, rocks: Sequence[str]) -> dict[str, Floats]:
    """Properties (r,) of rocks by their names; a rigid one has infinite moduli."""
    tables = [scene.rock[name] for name in rocks]
    rigid = np.array([rock.rigid for rock in tables], dtype=float)
    young = np.array([np.inf if r.rigid or r.youngs_modulus is None else r.youngs_modulus for r in tables])
    nu = np.array([0.0 if r.rigid or r.poissons_ratio is None else r.poissons_ratio for r in tables])
    density = np.array([np.nan if r.density is None else r.density for r in tables])
    wave = np.sqrt(p_wave_modulus(young, nu) / density)
    shear = shear_modulus(young, nu)
    return {
        "modulus": plane_strain_modulus(young, nu),
        "mode_2_modulus": shear / (1.0 - nu),
        "shear": shear,
        "shear_speed": np.sqrt(shear / density),
        "impedance": density * wave,
        "density": density,
        "rigid": rigid,
    }


def _wall_masses(mesh: SplitMesh, density: Floats, rigid: Floats, length: Floats) -> Floats:
    """Lumped mass per length of joint of the bottom and the top wall (j, 2); of a rigid rock, that of all of it.

    density, rigid  (r,) of each rock
    """
    at_node = np.zeros(len(mesh.points))
    for first in range(0, len(mesh.cells), ROWS_AT_ONCE):
        cells, rocks = (each[first : first + ROWS_AT_ONCE] for each in (mesh.cells, mesh.cell_rock))
        is_node = cells >= 0
        corners = np.where(is_node, cells, cells[:, :1])
        share = (density[rocks] * _areas(mesh.points[corners]) / is_node.sum(axis=1))[:, None] * is_node
        np.add.at(at_node, corners.ravel(), share.ravel())
    faces = np.stack([mesh.joint_bottom, mesh.joint_top], axis=1)  # (j, side, end)
    wall = np.broadcast_to(0.5 * length[:, None, None], faces.shape)
    of_wall = np.bincount(faces.ravel(), wall.ravel(), len(at_node))
    per_length = np.divide(at_node, of_wall, out=np.zeros(len(at_node)), where=of_wall > 0.0)[faces].mean(axis=2)
    sides, areas = mesh.cell_rock[mesh.joint_cells], rock_areas(mesh)
    for number in np.unique(sides[rigid[sides] > 0.0]):
        is_of = sides == number
        per_length[is_of] = density[number] * areas[number] / max(float((length[:, None] * is_of).sum()), 1e-300)
    return per_length


def _areas(corners: Floats) -> Floats:
    """Areas (m,) of cells by their corners (m, c, 2); a pad is the first corner again: its edges add nothing."""
    x, y = np.moveaxis(corners, -1, 0)
    after = np.roll(np.arange(x.shape[1]), -1)
    return 0.5 * np.abs((x * y[:, after] - x[:, after] * y).sum(axis=1))


def _depths(mesh: SplitMesh, length: Floats) -> Floats:
    """Depth (j, 2) of the connected blocks beside joints: area over the length of their joints; inf without cells."""
    if is_unmeshed(mesh.cells):
        return np.full(mesh.joint_cells.shape, np.inf)
    block, area = block_areas(mesh)
    beside = block[mesh.joint_cells]
    along = np.bincount(beside.ravel(), np.repeat(length, 2), len(area))
    depth: Floats = area[beside] / along[beside]
    return depth


def _held(scene: Scene, mesh: SplitMesh) -> Bools:
    """Whether the pressure of each joint's fracture is prescribed (j,)."""
    kept = [scene.fracture_named(name).pressure is not None for name in mesh.fractures]
    return np.asarray(np.array(kept, dtype=bool)[mesh.joint_fracture])


def _reaches(
    scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]], length: Floats
) -> tuple[Ints, Floats]:
    """Hydraulic component of each joint, and the longest way in it to a prescribed pressure (j,)."""
    count, ends = len(mesh.flow_origin), mesh.joint_flow
    if not scene.has_flow or not count:
        return np.zeros(len(length), dtype=np.int64), np.full(len(length), np.inf)
    one, other = ends.T
    label = components(one, other, count)
    held = {node for well in scene.well if well.pressure is not None for node in wells[well.name]}
    held |= set(ends[_held(scene, mesh)].ravel().tolist())
    both, start = np.concatenate([one, other]), np.array(sorted(held), dtype=np.int64)
    away = distances(both, np.concatenate([other, one]), np.tile(length, 2), start, count)
    farthest = np.zeros(label.max() + 1)
    np.maximum.at(farthest, label, away)
    component = label[one]
    return component, farthest[component]
