"""How fast a compressible fluid is taken up, by the rule of a step, and what of it a closed part must keep."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas, first_rate
from fracflow.mesh.data import Floats
from fracflow.model.compressibility import taken_up
from fracflow.model.flow import Compression, Conduction
from fracflow.model.network_parts import Closure
from fracflow.model.operators import Operators
from fracflow.model.state import State

DENSEST = 100.0  # exponent of a density: beyond it a trial overflows somewhere


def uptake_rate(state: State, alphas: Alphas, taken: Floats) -> Floats | None:
    """Rates (n,) of what was ``taken`` (n,) since ``state``, by the rule of the walls; None in a step without storage."""
    if alphas.b1 == alphas.b4 == 0.0:
        return None
    old, mean = (0.0 if each is None else each.getArray(readonly=True) for each in (state.uptake, state.memory.uptake))
    rate: Floats = first_rate(alphas, taken, 0.0, old, mean)
    return rate


def uptake_at(
    operators: Operators, state: State, alphas: Alphas, before: Compression | None, after: Compression | None
) -> Floats | None:
    """The same of what compression has taken up since ``state``; None of a fluid that is incompressible. Collective."""
    if before is None or after is None:
        return None
    taken = taken_up(operators, before, after)
    rate = uptake_rate(state, alphas, taken.getArray())
    taken.destroy()
    return rate


def taken_by(operators: Operators, closure: Closure, before: Compression | None, after: Compression | None) -> float:
    """Fluid that compression has taken up in a part that must keep it [volume per thickness]. Collective."""
    if closure.by != "fluid" or before is None or after is None:
        return 0.0
    inside = np.isin(operators.blocks.joints.flow, closure.nodes)
    return float(operators.layout.comm.allreduce(float((after.held - before.held)[inside].sum())))


def lost(
    operators: Operators,
    closure: Closure,
    moved: PETSc.Vec,
    pressure_change: Floats,
    before: Compression | None,
    after: Compression | None,
) -> float:
    """What a part has lost of what it must keep, over its natural size: its fluid, or its level. Collective."""
    if closure.by != "level":
        taken = taken_by(operators, closure, before, after)
        return float((closure.weights.dot(moved) + taken) / closure.size)
    weights = closure.weights.getArray(readonly=True)
    here = float(weights @ pressure_change)
    return float(operators.layout.comm.allreduce(here)) / operators.scales.pressure


def why_not_finite(operators: Operators, conduction: Conduction | None) -> str:
    """What has no finite value at a trial: the density of the fluid in a fracture that is named, or tractions. Collective."""
    comm, block, network = operators.layout.comm, operators.blocks.joints, operators.flow
    pressed = ("", 0.0)
    if network is not None and conduction is not None and len(conduction.pressure):
        size = np.where(np.isfinite(conduction.pressure), conduction.pressure, np.inf).max(axis=1)
        pressed = (block.fractures[block.fracture[int(size.argmax())]], float(size.max()))
    name, pressure = max(comm.allgather(pressed), key=lambda found: found[1])
    compressibility = 0.0 if network is None else network.compressibility
    if compressibility * pressure <= DENSEST:
        return "the joint laws gave no finite traction (a joint closed beyond its aperture)"
    return (
        f"fluid in {name} would come under {pressure:.3g}, {compressibility * pressure:.3g}/compressibility, which must be at"
        f" most {DENSEST:g}: give it a way out, such as a wider minimum_hydraulic_aperture, or pump and close it less"
    )
