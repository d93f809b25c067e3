"""Numbers of slip and stiffness: what a mesh and a step resolve, and where rock on both sides makes slip unstable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fracflow.diagnostics.joints import gather
from fracflow.diagnostics.number import CheckInput, Number
from fracflow.laws import JOINT_LAWS
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH, STIFFNESS

RESOLVED = 0.25  # h over the length E'/k_s that a joint gives to the edge of slip
RESOLVES = 0.99  # a size over the one asked for: cells differ a little from the size given to Gmsh
MOST_NAMES = 8  # fractures that are listed
COHESIVE = 9.0 * np.pi / 32.0  # Lambda_0 over mu* D_c/(tau_p - tau_r): Day et al. (2005)
ZONE = 4.0  # joints in Lambda_0
UNSTABLE = 1.158  # L_c over mu* D_c/(tau_p - tau_r): Uenishi and Rice (2003)
PATCH = 5.0  # joints in L_c
STATE = 3.0  # joints in L_b
NUCLEUS = 10.0  # joints in h*
JUST_SLIPPED = 1e-6  # V theta/D_c at the start, of a fault that has not rested
STEADY = 1e-3  # of |ln(V theta/D_c)|: slip that is steady, to the digits that a check shows
FASTEST_GROWTH = 0.096
"""Largest rate of growth over k_n c_s/mu, at friction 0.84. Without a joint between them waves grow below a contrast
of 1.4 only. Along a joint that yields the slower rock's own surface wave runs, and grows at any contrast."""
PAST = 1.01  # of the strength at the start
STIFF = {"gauss2": 1.0, "one-point": 0.5}
"""Where tractions begin to oscillate, as measured (scripts/figures stability --only S5); nodal ones do not."""


def _slip_scale(view: CheckInput) -> Floats:
    """Sizes h k_s/E', in a thin layer h sqrt(k_s/(E' D)) (j, 2), where strength drops if it does anywhere."""
    joints, length = view.joints, view.joints.length[:, None]
    with np.errstate(divide="ignore"):
        in_layer = length * np.sqrt(joints.shear / joints.layer[:, None])
        each = np.maximum(length * joints.shear / joints.modulus[:, None], in_layer)
    return np.where(view.drops, each, np.nan) if view.drops.any() else each


def length_scale(view: CheckInput) -> Number:
    """Joint length over E'/k_s, or sqrt(E' D/k_s) in a layer of depth D: with a drop of strength, joints must resolve it."""
    name, formula, joints = "joint length scale", "h k_s/E'", view.joints
    value, joint, where = view.worst(_slip_scale(view))
    note = _thin(view, joint, joints.shear.max(axis=1, initial=0.0))
    if not view.drops.any():
        return Number(name, formula, value, None, False, where, note="no abrupt drop of strength")
    if value is None or value <= RESOLVED:
        return Number(name, formula, value, RESOLVED, False, where, note=note)
    share = RESOLVED / value
    softer = share**2 if note else share
    remedy = (
        f"how far slip runs is a choice of the mesh: joints shorter than {joints.length[joint] * share:.3g}{view.unit(LENGTH)},"
        f" or shear_stiffness below {joints.shear[joint].max() * softer:.3g}{view.unit(STIFFNESS)}{_weakening(view, joint)}"
    )
    return Number(name, formula, value, RESOLVED, True, where, remedy, note)


def _thin(view: CheckInput, joint: int, stiffness: Floats) -> str:
    """Note of a joint beside a layer so thin that it bends as a bar: E' D below E'^2/stiffness."""
    joints = view.joints
    if joint < 0 or not np.isfinite(joints.modulus[joint]):
        return ""
    return "thin layer" if joints.layer[joint] * stiffness[joint] < joints.modulus[joint] ** 2 else ""


def _weakening(view: CheckInput, joint: int) -> str:
    """The D_c with which the mesh as it is would resolve the same drop."""
    joints, drop = view.joints, view.joints.drop[joint].max()
    if not drop > 0.0:
        return ""
    length = joints.length[joint]
    rigid = max(ZONE / COHESIVE, PATCH / UNSTABLE) * length * drop / joints.mode_2_modulus[joint]
    distance = max(rigid, (ZONE * length) ** 2 * drop / joints.layer[joint])
    keys = [law.weakens_over for law in JOINT_LAWS.values() if law.weakens_over]
    return f", or a law that weakens with slip, {' or '.join(keys)} above {distance:.2g}{view.unit(LENGTH)}"


def _lengths(view: CheckInput, factor: float, of_layer: float) -> Floats:
    """The smaller of factor mu* D_c/dtau and, in a layer, of_layer sqrt(E' D D_c/dtau) (j, 2); NaN where nothing weakens."""
    joints = view.joints
    ratio = joints.distance / np.where(view.weakens, joints.drop, 1.0)
    each = np.minimum(
        factor * joints.mode_2_modulus[:, None] * ratio, of_layer * np.sqrt(joints.layer[:, None] * ratio)
    )
    return np.where(view.weakens, each, np.nan)


def critical_length(shear_modulus: float, layer: float, fall: float) -> float:
    """L_c of slip whose strength falls by ``fall`` [stress/length]: 1.158 mu*/fall, or pi sqrt(E' D/fall) in a thin layer."""
    return float(min(UNSTABLE * shear_modulus / fall, np.pi * np.sqrt(layer / fall))) if fall > 0.0 else np.inf


def nucleation_lengths(view: CheckInput) -> Floats:
    """L_c (j, 2) at the joint ends under their initial normal traction; NaN where nothing weakens [length]."""
    return _lengths(view, UNSTABLE, np.pi)


def longest_joints(view: CheckInput) -> dict[str, Floats]:
    """The longest joints (j,) that resolve each length of slip, as the pre-run checks demand; inf where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        drops = np.where(view.drops, RESOLVED * view.joints.length[:, None] / _slip_scale(view), np.nan)
        evolves, nucleates = _state_lengths(view)
        limits = {
            f"E'/k_s / {1.0 / RESOLVED:g}": drops,
            f"nucleation length / {PATCH:g}": nucleation_lengths(view) / PATCH,
            f"cohesive zone / {ZONE:g}": _lengths(view, COHESIVE, 1.0) / ZONE,
            f"L_b of rate-and-state friction / {STATE:g}": evolves / STATE,
            f"h* of rate-and-state friction / {NUCLEUS:g}": nucleates / NUCLEUS,
        }
    return {name: np.where(np.isnan(sizes), np.inf, sizes).min(axis=1) for name, sizes in limits.items()}


def nucleation(view: CheckInput) -> Number:
    """L_c = 1.158 mu* D_c/dtau: none where strength drops at once, and then only E'/k_s gives slip a length."""
    name, formula, joints = "nucleation length", "L_c = 1.158 mu* D_c/dtau", view.joints
    if view.drops.any():
        coarse, joint, where = view.worst(_slip_scale(view))
        if coarse is None or coarse <= RESOLVED:
            return Number(name, formula, 0.0, None, False, where, note="D_c = 0")
        own = joints.length[joint] / coarse
        remedy = (
            f"strength drops at once, so slip has no length but the joint's own, {own:.3g}{view.unit(LENGTH)}, which"
            f" the mesh does not resolve: refine, or set {view.law(joint).no_drop}"
        )
        return Number(name, formula, 0.0, None, True, where, remedy, "D_c = 0")
    if not view.weakens.any():
        return Number(name, formula, note="no abrupt drop of strength")
    ratio, joint, where = view.worst(joints.length[:, None] / nucleation_lengths(view))
    if not ratio:  # rigid rock: slip has no length at all
        return Number(name, formula, note="rigid rock")
    length, limit = float(joints.length[joint]) / ratio, PATCH * float(joints.length[joint])
    if length >= limit:
        return Number(name, formula, length, limit, False, where, note="5 h")
    return Number(name, formula, length, limit, True, where, _finer(view, joint, length / limit), "5 h")


def start_past_strength(view: CheckInput) -> Number:
    """|f_s|/f_sy at the start: what is above 1 is let go at once, and slip of a law without a slip length has no scale then."""
    name, formula, joints = "start over strength", "|f_s0|/(C - f_n0 tan phi)", view.joints
    value, _, where = view.worst(np.where(view.weakens, np.nan, joints.used))
    if value is None or value <= PAST or not view.dynamic:
        return Number(name, formula, value, PAST, False, where)
    remedy = (
        "the excess is let go at once: how far slip runs from there depends on cells and damping, by tens of per cent, however"
        " fine they are: begin below the strength, or give a law that weakens over a slip which joints resolve, such as"
        ' law = "slip-weakening"'
    )
    return Number(name, formula, value, PAST, True, where, remedy)


def cohesive_zone(view: CheckInput) -> Number:
    """Joints in the zone at the edge of slip where strength falls, of a rupture that has not picked up speed."""
    name, formula, joints = "cohesive zone", "Lambda_0/h = (9 pi/32) mu* D_c/(dtau h)", view.joints
    if not view.weakens.any():
        return Number(name, formula, note="no weakening")
    inverse, joint, where = view.worst(joints.length[:, None] / _lengths(view, COHESIVE, 1.0))
    if not inverse:
        return Number(name, formula, note="rigid rock")
    value = 1.0 / inverse
    if value >= ZONE:
        return Number(name, formula, value, ZONE, False, where)
    return Number(name, formula, value, ZONE, True, where, _finer(view, joint, value / ZONE))


def _finer(view: CheckInput, joint: int, share: float) -> str:
    joints = view.joints
    over = np.where(joints.distance > 0.0, joints.distance, 1.0).min(axis=1)
    thin = _thin(view, joint, joints.drop.max(axis=1) / over)
    return (
        "how far slip runs, and how fast, is a choice of the mesh: joints shorter than"
        f" {joints.length[joint] * share:.3g}{view.unit(LENGTH)}, or {view.law(joint).weakens_over} above"
        f" {joints.distance[joint].min() / (share**2 if thin else share):.3g}{view.unit(LENGTH)}"
    )


def _state_lengths(view: CheckInput) -> tuple[Floats, Floats]:
    """L_b = mu* D_c/(b sigma), and h* = 2 mu* b D_c/(pi (b - a)^2 sigma) where b > a (j, 2); NaN elsewhere [length].

    By the slip law theta falls over D_c/ln(V0 theta/D_c) at a front, and that stands for D_c in L_b.
    """
    joints = view.joints
    b, weakens = joints.evolution, joints.evolution > joints.direct
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = joints.mode_2_modulus[:, None] / np.where(b > 0.0, b, np.nan)
        longest = np.where(weakens, 2.0 / np.pi * ratio * joints.state_length * (b / (b - joints.direct)) ** 2, np.nan)
        each = ratio * joints.front_length
    return np.where(np.isfinite(each), each, np.nan), np.where(np.isfinite(longest), longest, np.nan)


def state_zone(view: CheckInput) -> Number:
    """L_b = mu* D_c/(b sigma): joints must resolve the zone 9 pi/32 L_b in which the state evolves (Rubin and Ampuero 2005)."""
    name, formula, joints = "state evolution length", "L_b/h = mu* D_c/(b sigma h)", view.joints
    inverse, joint, where = view.worst(joints.length[:, None] / _state_lengths(view)[0])
    if not inverse:
        return Number(name, formula, note="no friction with a state")
    value, shorter = 1.0 / inverse, float((joints.state_length[joint] / joints.front_length[joint]).max())
    note = f"slip law: D_c/{shorter:.3g} at fronts" if shorter > 1.0 else ""
    if value >= STATE:
        return Number(name, formula, value, STATE, False, where, note=note)
    remedy = (
        f"fronts of slip run too slowly, and slip stops joint by joint: joints shorter than"
        f" {joints.length[joint] * value / STATE:.3g}{view.unit(LENGTH)}, or characteristic_slip above"
        f" {joints.state_length[joint].max() * STATE / value:.3g}{view.unit(LENGTH)}"
    )
    return Number(name, formula, value, STATE, True, where, remedy, note)


def state_nucleation(view: CheckInput) -> Number:
    """H* = 2 mu* b D_c/(pi (b - a)^2 sigma): joints that are not far shorter slip one by one (Rice 1993, Rubin and Ampuero)."""
    name, formula, joints = "creep nucleation", "h* = 2 mu* b D_c/(pi (b - a)^2 sigma)", view.joints
    ratio, joint, where = view.worst(joints.length[:, None] / _state_lengths(view)[1])
    if not ratio:
        return Number(name, formula, note="b > a nowhere")
    along = joints.length[joints.fracture == joints.fracture[joint]].sum()
    length, limit = float(joints.length[joint]) / ratio, NUCLEUS * float(joints.length[joint])
    note = f"{NUCLEUS:g} h" if length <= along else f"{NUCLEUS:g} h; above the fracture's length, which slips slowly"
    if length >= limit:
        return Number(name, formula, length, limit, False, where, note=note)
    remedy = (
        f"joints slip by themselves: joints shorter than {length / NUCLEUS:.3g}{view.unit(LENGTH)}, or characteristic_slip"
        f" above {joints.state_length[joint].max() * limit / length:.3g}{view.unit(LENGTH)}"
    )
    return Number(name, formula, length, limit, True, where, remedy, note)


def rate_dependence(view: CheckInput) -> Number:
    """(a - b) sigma: below 0 friction falls with the rate of steady slip, which may run away on patches longer than h*."""
    name, formula, joints = "rate dependence", "(a - b) sigma", view.joints
    each = np.where(joints.evolution + joints.direct > 0.0, joints.evolution - joints.direct, np.nan)
    value, joint, where = view.worst(each)
    if value is None:
        return Number(name, formula, note="no friction with a state")
    does = "unstable beyond h*" if value > 0.0 else "stable"
    note = f"D_c {joints.state_length[joint].min():.3g}{view.unit(LENGTH)}; {does}"
    return Number(name, formula, -value, None, False, where, note=note)


def state_at_start(view: CheckInput) -> Number:
    """V theta/D_c at the start, where it is farthest from 1, of steady slip: above it slip speeds up, below it slows down."""
    name, formula, joints = "state at the start", "V theta/D_c", view.joints
    with np.errstate(divide="ignore"):
        away, joint, where = view.worst(np.abs(np.log(joints.steady)))
    if away is None:
        return Number(name, formula, note="no friction with a state")
    end = int(np.nanargmax(np.abs(np.log(joints.steady[joint]))))
    value, theta = float(joints.steady[joint, end]), float(joints.state[joint, end])
    slows = "slows down" if value >= JUST_SLIPPED else "just slipped"
    does = "steady" if away < STEADY else "speeds up" if value > 1.0 else slows
    return Number(name, formula, value, None, False, where, note=f"theta {view.scene.time_text(theta, 3)}; {does}")


def dissimilar_rock(view: CheckInput) -> Number:
    """N = 0.096 (k_n c_s/mu) T: e-folds in the dynamic stages of a wave along a joint that slides between unlike rocks."""
    name, formula, joints = "dissimilar rock", "N = 0.096 (k_n c_s/mu) T", view.joints
    speeds, slips = joints.shear_speed, np.array([bool(law.status) for law in joints.laws], dtype=bool)[joints.fracture]
    with np.errstate(invalid="ignore"):
        contrast = speeds.max(axis=1, initial=0.0) / speeds.min(axis=1, initial=np.inf)
        unlike = slips & (contrast > 1.0 + 1e-9)
    if not unlike.any():
        return Number(name, formula, note="like rocks")
    if not view.dynamic:
        return Number(name, formula, note="no inertia")
    rate = FASTEST_GROWTH * joints.normal * (speeds.min(axis=1) / joints.softer)[:, None]
    value, joint, where = view.worst(np.where(unlike[:, None], rate * view.dynamic_time(), np.nan))
    if value is None or value <= 1.0:
        return Number(name, formula, value, 1.0, False, where)
    unlike_by = f"differ by {contrast[joint]:.3g} times" if np.isfinite(contrast[joint]) else "differ, one is rigid"
    remedy = (
        f"shear speeds of the rocks beside it {unlike_by}: while it slides, waves along it grow by"
        f" themselves, up to e^{value:.3g} times in the dynamic stages: normal_stiffness below"
        f" {joints.normal[joint].max() / value:.2g}{view.unit(STIFFNESS)}, shorter stages, or the same rock on both sides"
    )
    return Number(name, formula, value, 1.0, True, where, remedy, f"contrast {contrast[joint]:.3g}")


def coarse_of_slip(scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[str, ...]]:
    """Each length of slip that a mesh does not resolve -> the fractures where it does not, the worst first. On one process."""
    joints = (view := CheckInput(scene, gather(scene, mesh, wells))).joints
    found = {}
    for what, size in longest_joints(view).items():
        worst = np.zeros(len(joints.names))
        np.maximum.at(worst, joints.fracture, joints.length / size)
        order = np.argsort(-worst, kind="stable")
        if named := tuple(joints.names[f] for f in order if RESOLVES * worst[f] > 1.0):
            found[what] = named
    return found


def of_fractures(names: Sequence[str]) -> str:
    """The first of some names of fractures, and how many more there are."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} more fractures" if more > 0 else "")


def stiffness(view: CheckInput) -> Number:
    """k_n h/E': above a limit of the quadrature tractions oscillate from joint to joint."""
    name, formula, joints = "joint/rock stiffness", "k_n h/E'", view.joints
    value, joint, where = view.worst(joints.normal * (joints.length / joints.modulus)[:, None])
    rule = view.scene.method.quadrature
    limit = STIFF.get(rule)
    if limit is None or value is None or value <= limit:
        return Number(name, formula, value, limit, False, where, note=rule)
    remedy = (
        f'tractions of quadrature "{rule}" oscillate, and sections that slip fail to lock: set method.quadrature = "nodal",'
        f" or have joints shorter than {joints.length[joint] * limit / value:.3g}{view.unit(LENGTH)}"
    )
    return Number(name, formula, value, limit, True, where, remedy, rule)


def joint_step(view: CheckInput) -> Number:
    """Time step dt sqrt(k_n/m_rel), m_rel = rho h/4 of the walls: above 1 joints that open and close gain energy."""
    name, formula, joints = "joint time step", "dt omega = dt sqrt(k_n/m_rel)", view.joints
    if not view.dynamic or view.scene.is_unbounded:
        return Number(name, formula, note="no inertia")
    method = view.scene.method
    if method.stepper == "explicit" or method.contact == "redistributed":
        why = "explicit: joints are solved" if method.stepper == "explicit" else "walls carry no inertia"
        return Number(name, formula, note=why)
    stage = max(view.dynamic, key=lambda each: each.time_step)
    value, _, where = view.worst(stage.time_step * np.sqrt(joints.normal / joints.mass[:, None]))
    where = f"{where}, {stage.name}"
    if value is None or value <= 1.0:
        return Number(name, formula, value, 1.0, False, where)
    remedy = (
        f"joints that open and close gain energy: time_step below {view.scene.time_text(stage.time_step / value, 3)}"
    )
    return Number(name, formula, value, 1.0, True, where, f"{remedy} in {stage.name}, or see that none opens")
