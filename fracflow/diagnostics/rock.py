"""Numbers of joints between rocks: stiffness, time step."""

from __future__ import annotations

import numpy as np

from fracflow.diagnostics.number import CheckInput, Number
from fracflow.scene.units import LENGTH, TIME

STIFF = {"gauss2": 1.0, "one-point": 0.5}
"""Where tractions begin to oscillate, as measured (scripts/figures stability --only S5); nodal ones do not."""


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
    if not view.dynamic:
        return Number(name, formula, note="no inertia")
    method = view.scene.method
    if method.stepper == "explicit" or method.contact == "redistributed":
        why = "explicit: joints are solved" if method.stepper == "explicit" else "walls carry no inertia"
        return Number(name, formula, note=why)
    film = max(view.dynamic, key=lambda each: each.time_step)
    value, _, where = view.worst(film.time_step * np.sqrt(joints.normal / joints.mass[:, None]))
    where = f"{where}, {film.name}"
    if value is None or value <= 1.0:
        return Number(name, formula, value, 1.0, False, where)
    remedy = f"joints that open and close gain energy: time_step below {film.time_step / value:.3g}{view.unit(TIME)}"
    return Number(name, formula, value, 1.0, True, where, f"{remedy} in {film.name}, or see that none opens")
