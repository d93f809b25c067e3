"""Significant digits of flow between prescribed pressures, and the error where they are too few.

In a wide fracture in series with a narrow one, pressures differ by less than their round-off. The flow there, and the inflow
at a well with a pressure, are then round-off alone. A given flow rate needs no such difference. In a component that it feeds
few digits are reported but not refused, since the flow may have hardly begun.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc, sum_over_ranks
from fracflow.errors import SolveError
from fracflow.mesh.data import Floats, Ints
from fracflow.model.flow import Conduction
from fracflow.model.loads import Loads
from fracflow.model.network_parts import NetworkComponents, conducting
from fracflow.model.operators import Operators
from fracflow.model.state import State
from fracflow.scene.values import TimeTable
from fracflow.solve.residual import MOST_DIGITS, refuse_few, round_off_of_pressure, significant_digits
from fracflow.solve.sections import SectionProblem

BEYOND = 100.0  # times the round-off of what a well draws: what is more is not that alone
INSIDE = 3.0  # times the round-off at a well: nodes further along a wide fracture have as much
RESOLVED = 1e-4  # of the largest pressure: a smaller drop may remain in a network at rest


@dataclass(frozen=True)
class SignificantDigitsOfFlow:
    """Digits of what wells with a pressure draw: the wide fracture, its conductance, and the narrow one, its aperture."""

    digits: float
    wide: str
    conductance: float
    narrow: str
    aperture: float


def flow_power(
    operators: Operators, conduction: Conduction | None, pressure: PETSc.Vec, source: PETSc.Vec, given: Ints
) -> float:
    """Power of the flow beyond round-off: where pressure drops, and in wells [energy/time per thickness].

    source  rates that the nodes draw; given (n,) local numbers of nodes whose pressure is given. Collective.
    """
    network = operators.flow
    if conduction is None or network is None:
        return 0.0
    noise = operators.layout.flow_vector()
    network.taken_up(round_off_of_pressure(network, conduction), noise)
    driving = pressure.getArray(readonly=True) - network.resting.getArray(readonly=True)
    drawn, blurred = (each.getArray(readonly=True)[given] for each in (source, noise))
    work = np.where(np.abs(drawn) > BEYOND * blurred, np.abs(drawn * driving[given]), 0.0)
    here = np.array([_powers(operators, conduction).sum(), work.sum()])
    noise.destroy()
    return float(sum_over_ranks(here, operators.layout.comm).max())


def _powers(operators: Operators, conduction: Conduction) -> Floats:
    largest = max(operators.layout.comm.allgather(float(np.abs(conduction.pressure).max(initial=0.0))))
    drop = np.abs(conduction.pressure[:, 0] - conduction.pressure[:, 1])
    return conduction.conductance * np.where(drop > RESOLVED * largest, drop, 0.0) ** 2


def significant_digits_of_flow(
    operators: Operators, conduction: Conduction, given: Ints, power: float
) -> SignificantDigitsOfFlow:
    """Digits of the work of wells at this rank's nodes (n,) of given pressure, by the largest ``max_dissipation`` so far.

    Round-off of the pressures around such a node, times its conductances, is a flow that the node draws. Collective.
    """
    network, block, comm = operators.network, operators.blocks.joints, operators.layout.comm
    nodes, at_ends = operators.layout.flow_vector(), round_off_of_pressure(network, conduction)
    nodes.getArray()[given] = 1.0
    lost = network.at_ends(nodes) * at_ends * np.abs(conduction.pressure)
    nodes.destroy()
    total, powers = INSIDE * comm.allreduce(float(lost.sum())), _powers(operators, conduction)
    if not (total > 0.0 and power > 0.0):
        return SignificantDigitsOfFlow(MOST_DIGITS, "", 0.0, "", 0.0)

    def largest(values: Floats) -> tuple[float, str, float, float]:
        if not len(values):
            return -1.0, "", 0.0, 0.0
        worst = int(values.argmax())
        conductance = float(conduction.conductance[worst])
        aperture = (12.0 * network.viscosity * float(network.length[worst]) * conductance) ** (1.0 / 3.0)
        return float(values[worst]), block.fractures[block.fracture[worst]], conductance, aperture

    found = [max(comm.allgather(largest(values))) for values in (lost.sum(axis=1), powers)]
    (_, wide, conductance, _), (_, narrow, _, aperture) = found
    digits = min(MOST_DIGITS, float(-np.log10(total / power)))
    return SignificantDigitsOfFlow(digits, wide, conductance, narrow, aperture)


def nodes_fed(operators: Operators, conduction: Conduction, loads: Loads, time: float) -> np.ndarray:
    """Flow nodes (q,) of this rank in a component that a well feeds with a flow rate, now or later. Collective."""
    layout = operators.layout
    pumped = np.zeros(layout.flow_count, dtype=bool)
    for well in loads.wells:
        rate = well.value
        ahead = isinstance(rate, TimeTable) and np.any(np.array(rate.values)[np.array(rate.times) > time])
        if ahead or rate(time) != 0.0:
            pumped |= well.vector.getArray(readonly=True) != 0.0
    if not layout.comm.allreduce(bool(pumped.any()), op=MPI.LOR):
        return pumped
    parts = NetworkComponents(operators, conducting(operators, conduction.conductance))
    fed = parts.any_of(pumped)[parts.own]
    parts.destroy()
    return np.asarray(fed)


def refuse_few_of_flow(found: SignificantDigitsOfFlow, limit: int, time: float) -> None:
    """Raise SolveError, on every rank, where fewer digits are left than required, with sufficient values."""
    if limit == 0 or found.digits >= limit:
        return
    left = min(max(round(found.digits, 1), 0.0), limit - 0.1)
    enough = 1.1 * found.aperture * 10.0 ** ((limit - found.digits) / 3.0)
    raise SolveError(
        f"time {time:.6g}: what wells with a pressure draw keeps {left:.1f} digits, accuracy.digits asks for {limit}: in"
        f" {found.wide}, of conductance {found.conductance:.3g}, pressures differ by less than their round-off, for"
        f" {found.narrow}, of hydraulic aperture {found.aperture:.2g}, lets hardly anything through: give a flow_rate in place"
        f" of the pressure in {found.wide}, or in {found.narrow} a minimum_hydraulic_aperture of {enough:.2g}"
    )


def check_digits(problem: SectionProblem, new: State, limit: int, tell: Callable[[str], None]) -> float:
    """Fewest significant digits of tractions in the state of a solved problem.

    Raises SolveError, on every rank, where fewer than ``limit`` are left, and frees the state. So it does for the flow in a
    component that prescribed pressures alone drive. Elsewhere it reports so few digits of flow. Collective.
    """
    found, operators = significant_digits(problem.operators, new), problem.operators
    try:
        refuse_few(found, limit, new.time)
        if problem.conduction is not None and limit > 0:
            given, power = problem.loads.given_pressures, new.max_dissipation
            if problem.loads.faint is not None:
                given = given[~problem.loads.faint.known(given)]
            flow = significant_digits_of_flow(operators, problem.conduction, given, power)
            if flow.digits < limit:
                pumped = nodes_fed(operators, problem.conduction, problem.loads, new.time)
                unfed = significant_digits_of_flow(operators, problem.conduction, given[~pumped[given]], power)
                refuse_few_of_flow(unfed, limit, new.time)
                left = max(flow.digits, 0.0)
                tell(
                    f"time {new.time:.6g}: what wells with a pressure draw keeps {left:.1f} digits so far, in {flow.wide};"
                    " a well with a flow rate feeds it"
                )
    except SolveError:
        new.destroy()
        raise
    return found.digits
