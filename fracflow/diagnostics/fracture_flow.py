"""Numbers of fracture flow: the quality of its coupling and time stepping, and the limits of the cubic law."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.diagnostics.joints import CheckJoints
from fracflow.diagnostics.number import CheckInput, FlowStage, Number
from fracflow.mesh.data import Floats
from fracflow.scene.units import ACCELERATION, COMPRESSIBILITY, STRESS, TIME

GRAVITY = 9.80665  # m/s^2: the density of a fluid of which only the specific weight is given
WITHIN = 0.5  # an estimate by means along a fracture may be half of the factor
WATER = 2.2e9  # Pa, bulk modulus of water: shown where the scene states no compressibility
GAS = 1e-6  # 1/Pa, 1/p of an ideal gas at 10 bar; liquids have less than a hundredth of it
HELD = "pressure is prescribed everywhere"
EVENT_STEPS = 10  # the shortest event that the steps of a dynamic stage resolve
NARROWING = 1.25  # d1/d2 from which (3.14f) is wrong by 4 %
STEEPEST = {"lumped": 4.0, "consistent-lumped": 12.0, "consistent": 36.0, "averaging": 48.0, "report": 24.0}
"""kappa^2 h^2 of the shortest mode on a mesh, 4 sin^2(a/2) over the storage of a pair for a wave of angle a per element:
a = pi. Where (3.16) averages, which stores none of it, three elements a wave."""


def wall_stiffness(joints: CheckJoints, normal: Floats, wavenumber: Floats, stage: FlowStage) -> Floats:
    """k_tot (j,) = k_n + E' kappa/4 + inertia [stress/length], E' = 0 of rigid rock, which does not bend.

    inertia is the larger of two: alpha_1 rho c_p/2 where a step is long against the time of a wave through a cell, and
    alpha_0 rho h/4 of the walls' lumped masses where it is short.
    """
    inertia = np.maximum(stage.alpha_1 * joints.impedance, stage.alpha_0 * joints.mass) if stage.alpha_0 > 0.0 else 0.0
    result: Floats = normal + _soft(joints) * wavenumber / 4.0 + inertia
    return result


def _soft(joints: CheckJoints) -> Floats:
    return np.where(np.isfinite(joints.modulus), joints.modulus, 0.0)


def coupling_factor(
    alpha_1: float, conducting: Floats, wavenumber: Floats, stiffness: Floats, held: Floats | float = 0.0
) -> Floats:
    """rho_t (j,) = alpha_1/((C kappa^2 + alpha_1 c_f d) k_tot), C = d^3/(12 mu): factor of an error in a cycle of (4.5).

    held  c_f d, what a compressible fluid stores [length/stress]; without it rho_t is infinite at kappa = 0
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        result: Floats = alpha_1 / ((conducting * wavenumber**2 + alpha_1 * held) * stiffness)
    return result


def _modes(view: CheckInput) -> tuple[Floats, NDArray[Any]]:
    """Wave numbers (j,) of the slowest mode of each joint's component, 0 where nothing drains it; and whether it does."""
    reach = view.joints.reach
    moves = reach > 0.0
    return np.pi / (2.0 * np.where(moves, reach, 1.0)), moves


def slowest(view: CheckInput, stage: FlowStage) -> Floats:
    """rho_t (j,) of the slowest mode of each joint's component, by means of 1/C and 1/k_tot along it."""
    joints = view.joints
    kappa, moves = _modes(view)
    stiff = wall_stiffness(joints, joints.normal.mean(axis=1), kappa, stage)
    length = np.bincount(joints.component, joints.length)

    def mean(values: Floats) -> Floats:
        total = np.bincount(joints.component, joints.length * values)
        return np.asarray((total / np.where(length > 0.0, length, 1.0))[joints.component])

    conducting, held = 1.0 / mean((1.0 / joints.conducting).mean(axis=1)), mean(_held(view))
    with np.errstate(divide="ignore"):  # walls that cannot give way are infinitely stiff
        stiffness = 1.0 / mean(1.0 / stiff)
        return np.where(moves, coupling_factor(stage.alpha_1, conducting, kappa, stiffness, held), 0.0)


def _held(view: CheckInput) -> Floats:
    """c_f d (j,), what the fluid stores by its pressure [length/stress]."""
    stored = 0.0 if view.scene.fluid is None else view.scene.fluid.compressibility
    return np.asarray(stored * np.maximum(view.joints.aperture, 0.0).mean(axis=1))


def _cycles(view: CheckInput) -> tuple[float | None, str]:
    """The limit of a cycle's factor, where (4.5) is used as it is printed, and the coupling's name."""
    method = view.scene.method
    if method.coupling != "fixed-point":
        return None, method.coupling
    if method.on_divergence == "monolithic":
        return None, "handed over"
    return (1.0, "") if method.fixed_point == "plain" else (None, method.fixed_point)


def transient(view: CheckInput) -> Number:
    """rho_t of the slowest mode, pi/2L with L the longest way to a prescribed pressure; the fixed point needs less than 1."""
    name, formula = "coupling, transient", "rho_t = 12 mu alpha_1/(d^3 kappa^2 k_tot)"
    if not view.flows or not view.stages:
        return Number(name, formula, note="no fracture flow that moves")
    limit, note = _cycles(view)
    found = [(view.worst(slowest(view, stage)), stage) for stage in view.stages]
    (value, _, where), stage = max(found, key=lambda each: -1.0 if each[0][0] is None else each[0][0])
    where = f"{where}, {stage.name}"
    limit = limit and WITHIN  # of 1: the run predicts the factor itself, this is an estimate of it
    if limit is None or value is None or value < limit:
        return Number(name, formula, value, limit, False, where, note=note)
    if not np.isfinite(value):
        remedy = "no pressure is prescribed there, so the fixed point (4.5) has none while the walls are held: give a [[well]]"
        remedy += ' with a pressure, or set method.fixed_point = "added-storage" or method.coupling = "monolithic"'
        return Number(name, formula, value, limit, True, where, remedy)
    remedy, longer = "the fixed point (4.5) may diverge, and smaller steps make it worse: ", value / limit
    rings, _, ringing_stage = _worst_ringing(view)
    if ringing_stage is not None and ringing_stage.is_trapezoid and rings * longer > 1.0:
        remedy += 'steps long enough for it would make pressures ring: set method.coupling = "monolithic"'
    else:
        needed = view.scene.time_text(stage.time_step * longer, 2)
        remedy += f'take time_step above {needed} there, or set method.coupling = "monolithic"'
    return Number(name, formula, value, limit, True, where, remedy)


def steady(view: CheckInput) -> Number:
    """3p/(k_tot d) with the largest pressure that the scene states: what pumping adds is not known before the run."""
    name, formula, joints = "coupling, steady", "rho_s = 3p/(k_tot d)", view.joints
    if not view.flows:
        return Number(name, formula, note="no flow")
    kappa, _ = _modes(view)
    stiff = joints.normal + (_soft(joints) * kappa / 4.0)[:, None]
    open_to = np.where(joints.is_cubic[:, None], joints.aperture, np.nan)
    value, _, where = view.worst(3.0 * _largest_pressure(view) / (stiff * open_to))
    limit, note = _cycles(view)
    if all(stage.kind != "steady" for stage in view.scene.stage):
        limit, note = None, "no steady stage"
    if limit is None or value is None or value < limit:
        return Number(name, formula, value, limit, False, where, note=note)
    remedy = 'the fixed point (4.5) diverges: set method.coupling = "monolithic"'
    return Number(name, formula, value, limit, True, where, remedy)


def _largest_pressure(view: CheckInput) -> float:
    fluid = view.scene.fluid
    stated = [0.0 if fluid is None else fluid.initial_pressure]
    for well in view.scene.well:
        if well.pressure is not None and not isinstance(well.pressure, str):
            stated += well.pressure.values
    for table in view.scene.fracture.values():
        if table.pressure is not None:
            stated += [value for row in table.pressure.values for value in row]
    return max(map(abs, stated))


def ringing(view: CheckInput) -> Number:
    """dt/(2 tau_d) of the shortest mode on the mesh, the first to ring."""
    name, formula = "pressure ringing", "dt/(2 tau_d)"
    value, where, stage = _worst_ringing(view)
    if stage is None:
        return Number(name, formula, note=HELD if view.flows and view.stages else "no fracture flow that moves")
    where = f"{where}, {stage.name}"
    if not stage.is_trapezoid:
        return Number(name, formula, value, None, False, where, note="no trapezoid")
    if value <= 1.0:
        return Number(name, formula, value, 1.0, False, where)
    remedy = (
        f"pressures change sign from step to step: time_step below {view.scene.time_text(stage.time_step / value, 3)}"
    )
    remedy += f" in {stage.name}" + ("" if stage.alpha_0 else ', or method.flow_integrator = "backward-euler"')
    return Number(name, formula, value, 1.0, True, where, remedy)


def _worst_ringing(view: CheckInput) -> tuple[float, str, FlowStage | None]:
    """dt/(2 tau_d) where it is largest, the fracture, and the stage; None where no fracture flow moves walls."""
    joints = view.joints
    stages = [stage for stage in view.stages if stage.is_trapezoid] or view.stages
    if not view.flows or not stages or joints.is_held.all():
        return 0.0, "", None
    kappa = np.sqrt(STEEPEST[view.scene.method.storage]) / joints.length

    def worst(stage: FlowStage) -> tuple[float, str]:
        stiff = wall_stiffness(joints, joints.normal.max(axis=1), kappa, stage)
        conducting, yields = joints.conducting.max(axis=1), 1.0 / stiff + _held(view)
        with np.errstate(divide="ignore"):  # as long as walls cannot give way, and the fluid neither
            rings = conducting * kappa**2 * stage.time_step / (2.0 * yields)
            value, _, where = view.worst(np.where(joints.is_held, np.nan, rings))
        return value or 0.0, where

    stage = max(stages, key=lambda each: worst(each)[0])
    return *worst(stage), stage


def fluid_inertia(view: CheckInput) -> Number:
    """t_v against the shortest event that is resolved, ten steps of a stage with inertia."""
    name, formula = "fluid inertia", "t_v = rho_f d^2/(12 mu)"
    density = _fluid_density(view)
    if not view.flows or density is None:
        return Number(name, formula, note="density not stated" if view.flows else "no flow")
    if view.joints.is_held.all():
        return Number(name, formula, note=HELD)
    assert view.scene.fluid is not None
    slow = density * view.joints.aperture**2 / (12.0 * view.scene.fluid.viscosity)
    value, _, where = view.worst(np.where(view.joints.is_held[:, None], np.nan, slow))
    if not view.dynamic:
        return Number(name, formula, value, None, False, where, note="no inertia")
    stage = min(view.dynamic, key=lambda each: each.time_step)
    limit, where = EVENT_STEPS * stage.time_step, f"{where}, {stage.name}"
    if value is None or value <= limit:
        return Number(name, formula, value, limit, False, where, note="10 dt")
    remedy = (
        "the cubic law leaves out the inertia of the fluid itself: pressures in events shorter than"
        f" {value:.2g}{view.unit(TIME)} (ten steps are {limit:.2g}) are not to be trusted; slower events, narrower fractures"
    )
    return Number(name, formula, value, limit, True, where, remedy, "10 dt")


def _fluid_density(view: CheckInput) -> float | None:
    fluid, force = view.scene.fluid, view.scene.body_force
    if fluid is None or fluid.density is not None or fluid.specific_weight is None:
        return None if fluid is None else fluid.density
    if force is not None and force.gravity > 0.0:
        return fluid.specific_weight / force.gravity
    known = view.scene.units != "none"
    return fluid.specific_weight * view.scene.unit_system.to_si(ACCELERATION) / GRAVITY if known else None


def compressibility(view: CheckInput) -> Number:
    """k_n d/K_f, what the fluid gives against what the joint gives; of water where the scene states none."""
    name, formula = "fluid compressibility", "k_n d/K_f"
    if not view.flows:
        return Number(name, formula, note="no flow")
    given = view.scene.fluid.compressibility if view.scene.fluid is not None else 0.0
    if not given and view.scene.units == "none":
        return Number(name, formula, note="not stated")
    share = given or view.scene.unit_system.to_si(STRESS) / WATER
    value, _, where = view.worst(view.joints.normal * view.joints.aperture * share)
    in_si = given * view.scene.unit_system.to_si(COMPRESSIBILITY) if given and view.scene.units != "none" else 0.0
    if value is None or in_si <= GAS:
        return Number(name, formula, value, None, False, where, note="modelled" if given else "not stated; water")
    remedy = (
        f"fluid.compressibility is {in_si:.2g} 1/Pa, that of a gas below 10 bar, whose density the model does not follow:"
        " give 1/K_f of a liquid (4.5e-10 1/Pa for water), not K_f"
    )
    return Number(name, formula, value, value * GAS / in_si, True, where, remedy, "modelled")


def contrast(view: CheckInput) -> Number:
    """Largest d1/d2 in one element, hydraulic apertures at the start; the exact mean is right at any."""
    name, formula, joints = "aperture contrast", "max(d1/d2)", view.joints
    if not view.flows:
        return Number(name, formula, note="no flow")
    sides = np.where(joints.is_cubic[:, None], np.cbrt(joints.conducting), np.nan)
    value, _, where = view.worst(sides.max(axis=1) / sides.min(axis=1))
    if view.scene.method.conductance != "report":
        return Number(name, formula, value, None, False, where, note="exact mean")
    out = value is not None and value > NARROWING
    remedy = '(3.14f) lets too much through: 4 % at 1.25, 40 % at 2: set method.conductance = "exact", or refine there'
    return Number(name, formula, value, NARROWING, out, where, remedy if out else "")
