"""Suction: a fluid pressure below zero, which the model computes and no fluid holds."""

from __future__ import annotations

import numpy as np

from fracflow.model.properties import initial_pressure
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.scene.units import LENGTH, STRESS

LEAST = 1e-6  # of the initial pressure: less is round-off of a well that draws a fracture down to nothing


def suction_line(model: Model, state: State) -> str:
    """A line on the lowest pressure where it is below zero; empty where none is, or pressures are above an unknown datum.

    A scene with an initial pressure means pressures of its fluid; one without (zero) means changes, which may have any sign.
    So, with a gradient, do its fractures above the level at which the initial pressure is zero. Collective.
    """
    scene, flow, blocks = model.scene, model.operators.flow, model.operators.blocks
    if flow is None or scene.fluid is None or scene.fluid.initial_pressure <= 0.0:
        return ""
    limit = -LEAST * scene.fluid.initial_pressure
    if state.pressure.min()[1] >= limit:
        return ""
    joints = blocks.joints
    pressure, ends = flow.at_ends(state.pressure), blocks.solid.points[joints.bottom]
    pressure = np.where(initial_pressure(scene, ends) > 0.0, pressure, np.inf)
    here = (np.inf, "", 0.0, 0.0)
    if pressure.size and pressure.min() < limit:
        joint, end = np.unravel_index(int(pressure.argmin()), pressure.shape)
        x, y = ends[joint, end]
        here = (float(pressure.min()), joints.fractures[joints.fracture[joint]], float(x), float(y))
    lowest, name, x, y = min(blocks.comm.allgather(here))
    if not name:
        return ""
    system = scene.unit_system
    pressures, lengths = (f" {system.unit(kind)}" if scene.units != "none" else "" for kind in (STRESS, LENGTH))
    time = f"time {state.time:.6g} {system.time}".rstrip()
    return (
        f"{time}: the pressure in {name} at ({x:.6g}, {y:.6g}){lengths} falls to {lowest:.3g}{pressures}, below zero: a fluid"
        " boils or lets air in there, which the model leaves out, and pulls the walls together in it: give a"
        " minimum_pressure to the wells that draw, or a higher fluid.initial_pressure if pressures are above another datum"
    )
