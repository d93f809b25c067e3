"""Numbers of joints between rocks: stiffness, length scales, time step."""

from __future__ import annotations

import numpy as np

from fracflow.card.number import Number, View
from fracflow.mesh.data import Floats
from fracflow.units import LENGTH, STIFFNESS, TIME

STIFF = {"gauss2": 1.0, "one-point": 0.5}
"""Where tractions begin to oscillate, as measured (scripts/figures stability --only S5); nodal ones do not."""

RESOLVED = 0.25  # h over the length E'/k_s that a joint gives to the edge of slip


def stiffness(view: View) -> Number:
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


def _slip_scale(view: View) -> Floats:
    """Sizes h k_s/E' (j, 2), where strength drops if it does anywhere."""
    each = view.joints.shear * (view.joints.length / view.joints.modulus)[:, None]
    return np.where(view.drops, each, np.nan) if view.drops.any() else each


def length_scale(view: View) -> Number:
    """Joint length over E'/k_s: with a drop of strength, joints must resolve that length."""
    name, formula, joints = "joint length scale", "h k_s/E'", view.joints
    value, joint, where = view.worst(_slip_scale(view))
    if not view.drops.any():
        return Number(name, formula, value, None, False, where, note="no drop of strength")
    if value is None or value <= RESOLVED:
        return Number(name, formula, value, RESOLVED, False, where)
    share = RESOLVED / value
    remedy = (
        f"how far slip runs is a choice of the mesh: joints shorter than {joints.length[joint] * share:.3g}{view.unit(LENGTH)},"
        f" or shear_stiffness below {joints.shear[joint].max() * share:.3g}{view.unit(STIFFNESS)}"
    )
    return Number(name, formula, value, RESOLVED, True, where, remedy)


def nucleation(view: View) -> Number:
    """L_c = 1.158 mu* D_c/dtau: none where strength drops at once, and then only E'/k_s gives slip a length."""
    name, formula, joints = "nucleation length", "L_c = 1.158 mu* D_c/dtau", view.joints
    if not view.drops.any():
        return Number(name, formula, note="no drop of strength")
    coarse, joint, where = view.worst(_slip_scale(view))
    if coarse is None or coarse <= RESOLVED:
        return Number(name, formula, 0.0, None, False, where, note="D_c = 0")
    own = joints.modulus[joint] / joints.shear[joint].max()
    remedy = (
        f"strength drops at once, so slip has no length but the joint's own E'/k_s = {own:.3g}{view.unit(LENGTH)}, which the"
        " mesh does not resolve: refine, or set stick_slip_ratio = 1"
    )
    return Number(name, formula, 0.0, None, True, where, remedy, "D_c = 0")


def joint_step(view: View) -> Number:
    """Time step dt sqrt(k_n/m_rel), m_rel = rho h/4 of the walls: above 1 joints that open and close gain energy."""
    name, formula, joints = "joint time step", "dt omega = dt sqrt(k_n/m_rel)", view.joints
    if not view.dynamic:
        return Number(name, formula, note="no inertia")
    film = max(view.dynamic, key=lambda each: each.time_step)
    value, _, where = view.worst(film.time_step * np.sqrt(joints.normal / joints.mass[:, None]))
    where = f"{where}, {film.name}"
    if value is None or value <= 1.0:
        return Number(name, formula, value, 1.0, False, where)
    remedy = f"joints that open and close gain energy: time_step below {film.time_step / value:.3g}{view.unit(TIME)}"
    return Number(name, formula, value, 1.0, True, where, f"{remedy} in {film.name}, or see that none opens")
