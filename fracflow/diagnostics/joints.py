"""Values of every joint that the pre-run checks need, gathered once from the scene and its split mesh, on one process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.elements import facet, joint
from fracflow.laws import JOINT_LAWS, JointLaw, keys_of, make_law, parameters_of
from fracflow.laws.elastic import p_wave_modulus, plane_strain_modulus, shear_modulus
from fracflow.mesh.data import Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.graph import components, distances
from fracflow.mesh.whole import block_areas, rock_areas
from fracflow.model.properties import initial_pressure, initial_stress
from fracflow.scene.profiles import sample
from fracflow.scene.scene import Scene

Bools = np.ndarray


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

    def ends(key: str) -> Floats:
        values = np.full((len(length), 2), np.nan)
        for number, name in enumerate(mesh.fractures):
            here = mesh.joint_fracture == number
            values[here] = sample(getattr(scene.fracture_named(name), key), mesh.joint_along[here])
        return values

    aperture, given = ends("aperture"), ends("conductance")
    viscosity = scene.fluid.viscosity if scene.fluid is not None and scene.has_flow else np.nan
    cubic = np.maximum(ends("hydraulic"), ends("minimum_hydraulic_aperture")) ** 3 / (12.0 * viscosity)
    sheared, normal = initial_tractions(scene, mesh)
    drop, distance, *states = _of_laws(scene, mesh, ends, sheared, normal)
    laws = tuple(JOINT_LAWS[scene.fracture_named(name).law] for name in mesh.fractures)
    slides = np.array([bool(law.status) and law.slides for law in laws], dtype=bool)[mesh.joint_fracture]
    strength = np.nan_to_num(ends("cohesion")) + np.maximum(-normal, 0.0) * ends("friction")
    has_strength = slides[:, None] & (strength > 0.0)
    rock = cell_rocks(scene, mesh)
    component, reach = _reaches(scene, mesh, wells, length)
    beside = {key: values[mesh.joint_cells] for key, values in rock.items()}
    return CheckJoints(
        names=mesh.fractures, fracture=mesh.joint_fracture, length=length, normal=ends("normal_stiffness"),
        shear=ends("shear_stiffness"), aperture=aperture, conducting=np.where(np.isnan(given), cubic, given),
        is_cubic=np.isnan(given).all(axis=1), drop=drop, distance=distance,
        direct=states[0], evolution=states[1], state_length=states[2], state=states[3], steady=states[4],
        front_length=states[5],
        laws=laws, used=np.where(has_strength, np.abs(sheared) / np.where(has_strength, strength, 1.0), np.nan),
        modulus=2.0 * _in_series(beside["modulus"]), mode_2_modulus=2.0 * _in_series(beside["mode_2_modulus"]),
        layer=_in_series((rock["modulus"] * _depths(mesh, length))[mesh.joint_cells]),
        shear_speed=beside["shear_speed"], softer=_of_slower(beside["shear_speed"], beside["shear"]),
        impedance=_in_series(beside["impedance"]),
        mass=_in_series(_wall_masses(mesh, rock["density"], rock["rigid"], length)),
        component=component, reach=reach, is_held=_held(scene, mesh),
    )  # fmt: skip


def initial_tractions(scene: Scene, mesh: SplitMesh) -> tuple[Floats, Floats]:
    """f_s0 and effective f_n0 (j, 2) at the joint ends, as given or else of the initial stress and pressure (2.14) [stress]."""
    places = mesh.points[mesh.joint_bottom]
    if not len(places):
        return np.zeros((0, 2)), np.zeros((0, 2))
    sigma = initial_stress(scene, places)[..., :2, :2]
    frame = np.repeat(facet.frame(places)[0], 2, axis=0)
    traction = joint.traction_from_stress(frame, sigma.reshape(-1, 2, 2)).reshape(*places.shape[:2], 2)
    found = []
    for key, own in (
        ("initial_shear_traction", traction[..., 0]),
        ("initial_normal_traction", traction[..., 1] + initial_pressure(scene, places)),
    ):
        given = np.full(own.shape, np.nan)
        for number, name in enumerate(mesh.fractures):
            here = mesh.joint_fracture == number
            given[here] = sample(getattr(scene.fracture_named(name), key), mesh.joint_along[here])
        found.append(np.where(np.isnan(given), own, given))
    return found[0], found[1]


def _of_laws(
    scene: Scene, mesh: SplitMesh, ends: Callable[[str], Floats], sheared: Floats, normal: Floats
) -> tuple[Floats, ...]:
    """Fall of strength (j, 2) under initial tractions f_s0 and f_n0 (j, 2), and the slip (j, 2) over which it comes.

    Then direct and evolution effect, slip of evolution, theta at the start and V theta/D_c of friction with a state, and
    slip of evolution at a front.
    """
    pressed = np.maximum(-normal, 0.0)
    found = tuple(np.full_like(pressed, value) for value in (0.0, np.inf, 0.0, 0.0, np.inf, np.nan, np.nan, np.inf))
    of_fracture = [scene.fracture_named(name).law for name in mesh.fractures]
    for name in sorted(set(of_fracture)):
        here = np.isin(mesh.joint_fracture, np.flatnonzero([law == name for law in of_fracture]))
        given = {
            each: ends("friction" if each == "friction_coefficient" else each)[here].ravel()
            for each in (*_numbers_of(name), "normal_stiffness", "shear_stiffness", "aperture")
            if each in {field.name for field in parameters_of(JOINT_LAWS[name])}
        }
        law, pressures = make_law(name, **given), pressed[here].ravel()
        count = len(pressures)
        past = law.initial_history(count, 2)
        values = law.strength_drop(pressures), law.slip_length(count), *law.rate_effects(pressures)
        evolves = law.state_length(past) if law.creeps else np.full(count, np.inf)
        for into, each in zip(found, (*values, evolves), strict=False):
            into[here] = each.reshape(-1, 2)
        if law.creeps:
            tractions = dict(initial_normal_traction=normal[here].ravel(), initial_shear_traction=sheared[here].ravel())
            of_scene = make_law(name, **given, **tractions, **_choices(scene, mesh, name, here))
            start = of_scene.initial_history(count, 2)
            rate, age = of_scene.slip_rate(start), of_scene.contact_age(start)
            found[5][here], found[6][here] = age.reshape(-1, 2), (rate * age / evolves).reshape(-1, 2)
            found[7][here] = of_scene.front_length(start).reshape(-1, 2)
    return found


def _numbers_of(law: str) -> Iterator[str]:
    """Keys of a law whose values are numbers."""
    return (name for name, key in keys_of(JOINT_LAWS[law]).items() if not key.choices)


def _choices(scene: Scene, mesh: SplitMesh, law: str, here: Bools) -> dict[str, NDArray[Any]]:
    """Words of the scene for the keys of a law that are no numbers, at both ends of joints ``here`` (j,)."""
    names = [key for key, meaning in keys_of(JOINT_LAWS[law]).items() if meaning.choices]
    tables = [scene.fracture_named(name) for name in mesh.fractures]
    of_joints = np.repeat(mesh.joint_fracture[here], 2)
    return {key: np.array([getattr(table, key, None) or "" for table in tables])[of_joints] for key in names}


def _of_slower(speed: Floats, values: Floats) -> Floats:
    """The value (j,), of pairs (j, 2), on the side of the lower speed."""
    side = np.argmin(np.where(np.isnan(speed), np.inf, speed), axis=1) if len(speed) else np.zeros(0, dtype=int)
    return values[np.arange(len(values)), side]


def _in_series(sides: Floats) -> Floats:
    """1/(1/a + 1/b) of pairs (j, 2)."""
    with np.errstate(divide="ignore"):
        result: Floats = 1.0 / (1.0 / sides).sum(axis=1)
    return result


def cell_rocks(scene: Scene, mesh: SplitMesh) -> dict[str, Floats]:
    """Properties (m,) of the rock of each cell, as of ``rock_values``."""
    return {key: values[mesh.cell_rock] for key, values in rock_values(scene, mesh.rocks).items()}


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
    """Lumped mass per length of joint of the bottom and the top wall (j, 2); of a rigid rock, that of all of it."""
    is_node = mesh.cells >= 0
    volume = density * _areas(mesh)
    count = len(mesh.points)
    share = (volume / is_node.sum(axis=1))[:, None] * is_node
    corners = np.where(is_node, mesh.cells, mesh.cells[:, :1])
    at_node = np.bincount(corners.ravel(), share.ravel(), count)
    faces = np.stack([mesh.joint_bottom, mesh.joint_top], axis=1)  # (j, side, end)
    wall = np.broadcast_to(0.5 * length[:, None, None], faces.shape)
    of_wall = np.bincount(faces.ravel(), wall.ravel(), count)
    per_length = np.divide(at_node, of_wall, out=np.zeros(count), where=of_wall > 0.0)[faces].mean(axis=2)
    rock_area = rock_areas(mesh)
    for number in range(len(mesh.rocks)):
        inside = mesh.cell_rock == number
        if inside.any() and rigid[inside].all():
            sides = mesh.cell_rock[mesh.joint_cells] == number
            whole = density[inside][0] * rock_area[number]
            per_length[sides] = whole / max(float((length[:, None] * sides).sum()), 1e-300)
    return per_length


def _areas(mesh: SplitMesh) -> Floats:
    """Areas (m,) of the cells; a pad is the first node again: its edges add nothing."""
    x, y = np.moveaxis(mesh.points[np.where(mesh.cells >= 0, mesh.cells, mesh.cells[:, :1])], -1, 0)
    after = np.roll(np.arange(x.shape[1]), -1)
    return 0.5 * np.abs((x * y[:, after] - x[:, after] * y).sum(axis=1))


def _depths(mesh: SplitMesh, length: Floats) -> Floats:
    """Depth (m,) of the connected block of each cell: its area over the length of its joints; inf without any, or no cells."""
    if is_unmeshed(mesh.cells):
        return np.full(len(mesh.cells), np.inf)
    block, area = block_areas(mesh)
    along = np.bincount(block[mesh.joint_cells].ravel(), np.repeat(length, 2), len(area))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth: Floats = (area / along)[block]
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
