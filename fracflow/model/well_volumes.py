"""Volumes that pass through wells, and the balance of fluid of the whole network, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, sum_over_ranks
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats
from fracflow.model.compressibility import room_between
from fracflow.model.energy_motion import Scheme
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import FRACTURES, FluidVolumes, State


@dataclass(frozen=True)
class WellStep:
    """Wells in a step.

    loads     those of the step, wells at limits among the prescribed pressures
    alphas    of its rule
    demanded  rates of wells with a flow rate, as the balance at the end of the step takes them [volume rate]
    means     the means over the step of what their tables ask for; ``demanded`` in a step without storage [volume rate]
    through   means over the step, by a multistep rule, of wells with limits [volume rate]
    depth     flow_depth [length]
    """

    loads: Loads
    alphas: Alphas
    demanded: Mapping[str, float]
    means: Mapping[str, float]
    through: Mapping[str, float]
    depth: float


def volumes_after(
    ops: Operators, wells: WellStep, old: State, new: State, room: Floats, dt: float, scheme: Scheme
) -> tuple[FluidVolumes, dict[str, float]]:
    """Volumes at the end of a step, and means over it that a multistep rule needs in the next one. Collective.

    room  (n,) ``room_between`` both states

    A well with a flow rate brings what enters the balance (3.20) of its node. A well with a pressure brings the reaction:
    outflow into its elements, and what walls and compression take up there. The outflow is that where the balance holds.
    Wells with pressures at one node share alike what flow rates leave of it. A multistep rule makes a rate q at the end of
    means over steps, q = alpha_1 dt q_mean - alpha_6 q_mean_before. The sum of all volumes is what the network stores.
    """
    if ops.flow is None:
        return old.volumes, {}
    takes_time, is_multistep = dt > 0.0, wells.alphas.a6 > 0.0
    instants = (new,) if scheme.balance == "end" or not takes_time else (old, new)
    source, conduction = (
        sum(getattr(state.forces, name).getArray(readonly=True) for state in instants) / len(instants)
        for name in ("source", "conduction")
    )
    taken = room / dt if takes_time and scheme.storage else np.zeros(len(source))
    reaction = conduction + taken if takes_time else source
    by_source = takes_time and not is_multistep
    asked = wells.means if takes_time else wells.demanded
    found = _sums(ops, wells, asked, source if by_source else None, reaction)
    stored = dt * wells.depth * float(ops.layout.comm.allreduce(float(taken.sum()), op=MPI.SUM))
    means: dict[str, float] = {}
    if is_multistep or (takes_time and scheme.storage):
        at_end = _sums(ops, wells, wells.demanded, None, new.forces.source.getArray(readonly=True))
        before = old.previous_step.through
        for name in {part.well for part in wells.loads.pressures} - wells.through.keys():
            if not is_multistep or name in before:
                means[name] = (at_end[name] + wells.alphas.a6 * before.get(name, 0.0)) / (wells.alphas.a1 * dt)
    if is_multistep:
        found |= means | dict(wells.through)
    return old.volumes.after(found, stored, dt), means


def volumes_at_jump(ops: Operators, loads: Loads, old: State, new: State, depth: float) -> FluidVolumes:
    """Volumes where prescribed pressures of a compressible fluid jump, as a stage begins. Collective."""
    taken = room_between(ops, old, new)
    wells = WellStep(loads, Alphas(), {}, {}, {}, depth)
    found = _sums(ops, wells, dict.fromkeys((str(each.well) for each in loads.wells), 0.0), None, taken)
    stored = depth * float(ops.layout.comm.allreduce(float(taken.sum()), op=MPI.SUM))
    return old.volumes.after(found, stored, 1.0).with_rates(old.volumes.rates)


def _sums(
    ops: Operators, wells: WellStep, asked: Mapping[str, float], source: Floats | None, reaction: Floats
) -> dict[str, float]:
    """Rates of all wells, and of fractures with prescribed pressures, from nodal values (n,) [volume rate]. Collective.

    asked     of wells with flow rates [volume rate]
    source    rates of flow rates together [volume rate per thickness]; None where ``asked`` is exact
    reaction  what prescribed pressures and flow rates bring together [volume rate per thickness]
    """
    rated = [(str(each.well), np.flatnonzero(each.vector.getArray(readonly=True))) for each in wells.loads.wells]
    kept = [part for part in wells.loads.pressures if part.well]
    by_rate, by_pressure, given = (np.zeros(len(reaction)) for _ in range(3))
    for name, nodes in rated:
        by_rate[nodes] += 1.0
        given[nodes] += asked[name] / wells.depth
    for part in kept:
        by_pressure[part.numbers] += 1.0
    beyond = np.zeros(len(reaction))
    if source is not None:
        beyond = np.where(by_pressure > 0.0, 0.0, (source - given) / np.maximum(by_rate, 1.0))
    rest = (reaction - given) / np.maximum(by_pressure, 1.0)
    here = [
        *(float(beyond[nodes].sum()) for _, nodes in rated),
        *(float(rest[part.numbers].sum()) for part in wells.loads.pressures),
    ]
    whole = wells.depth * sum_over_ranks(np.array(here), ops.layout.comm)
    found = dict.fromkeys(
        [*(name for name, _ in rated), *(part.well or FRACTURES for part in wells.loads.pressures)], 0.0
    )
    for (name, _), value in zip(rated, whole, strict=False):
        found[name] += asked[name] + float(value)
    for part, value in zip(wells.loads.pressures, whole[len(rated) :], strict=True):
        found[part.well or FRACTURES] += float(value)
    return found
