"""How fast the cycle (4.5) contracts, from the blocks of the Jacobian, before it starts.

Where walls answer pressures, C = -J_pu J_uu^-1 J_up is the rate at which they take up volume, and the feedback of their
opening on the flow. A cycle multiplies an error of the pressures by -K^-1 C, K = J_pp. With storage S added to the flow, and
taken off again with the pressures of the last cycle, by (K + S)^-1 (S - C).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.integrators import Alphas
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import Layout, layout_of
from fracflow.model.operators import Operators
from fracflow.model.undrained import SummedBalances, add_diagonal
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.linear import UNSOLVED, check_solution, set_up, true_residual
from fracflow.solve.options import solver_of
from fracflow.solve.problem import StepProblem

POWER_ITERATIONS = 60
SETTLED = 1e-5  # relative change of the estimate, twice in a row, that ends the power iteration
DOUBLINGS = 8
TRIALS = 8
NEAR = 0.02  # of 1, where the limit of the time step is searched
FARTHEST = 1e9


@dataclass
class RockBlock:
    """J_uu as a matrix of its own, what stands of it without the joints, and its unknowns; ``fixed`` is as of ``System``."""

    matrix: PETSc.Mat
    stands: PETSc.Mat
    operators: Operators
    layout: Layout
    fixed: Ints
    alphas: Alphas | None
    stood: tuple[Any, ...]

    @classmethod
    def of(cls, whole: JoinedMatrix, block: PETSc.Mat) -> RockBlock:
        """That of the whole, whose solid ``block`` it is."""
        layout, alone = whole.layout, layout_of(whole.operators.blocks, with_flow=False)
        starts = layout.solid_starts + layout.flow_starts
        rank = owner_of(starts, whole.fixed)
        numbers = whole.fixed - layout.flow_starts[rank]
        solid, flow = layout.index_sets()
        with whole.standing() as stands:
            part = stands.createSubMatrix(solid, solid)
        destroy(solid, flow)
        held = numbers[numbers < layout.solid_starts[rank + 1]]
        return cls(block, part, whole.operators, alone, held, whole.alphas, whole.stood)

    def standing(self) -> AbstractContextManager[PETSc.Mat]:
        """The block without the joints. Not collective."""
        return nullcontext(self.stands)


class Cycle:
    """The cycle linearised at the trial of a step. Whoever makes it destroys it."""

    def __init__(self, matrix: JoinedMatrix, problem: StepProblem, alphas: Alphas | None = None) -> None:
        """Fill ``matrix`` and take its blocks; ``alphas`` in place of the step's own. Collective."""
        sections, conduction = problem.sections, problem.conduction
        self.scale, self.time = problem.flow_scale() / matrix.operators.scales.pressure, problem.time
        self.summed, self.rate = problem.loads.summed, (alphas or problem.alphas).a1 / problem.flow_scale()
        matrix.fill(alphas or problem.alphas, sections.tangent, conduction, problem.flow_scale())
        splits = matrix.layout.index_sets()
        self.blocks = [[matrix.matrix.createSubMatrix(row, col) for col in splits] for row in splits]
        self.solid = solver_of(self.blocks[0][0], "solid_")
        self.rock = RockBlock.of(matrix, self.blocks[0][0])
        set_up(self.solid, self.rock)
        self.wall, self.force = self.blocks[0][0].createVecs()
        self.held = np.isin(matrix.layout.start + matrix.layout.solid_count + _here(self.blocks[1][1]), matrix.fixed)
        destroy(*splits)

    def uptake(self, pressure: PETSc.Vec, result: PETSc.Vec) -> None:
        """``result`` = C p. Collective."""
        self.blocks[0][1].mult(pressure, self.force)
        self.solid.solve(self.force, self.wall)
        check_solution(self.solid, self.wall, self.force, f"time {self.time:.6g}: the walls under the fluid")
        self.blocks[1][0].mult(self.wall, result)
        result.scale(-1.0)

    def uniform_uptake(self) -> Floats:
        """|C 1| (n,) at this rank's nodes: uptake of the walls by a uniform pressure [scaled]; 0 where held. Collective."""
        ones, result = self.blocks[1][1].createVecs()
        ones.setArray(np.where(self.held, 0.0, 1.0))
        self.uptake(ones, result)
        rows = result.getArray()
        values = np.abs(rows if self.summed is None else self.summed.without_sums(rows, self.rate))
        destroy(ones, result)
        return np.where(self.held, 0.0, values)

    def radius(self, storage: Floats | None = None) -> tuple[float, Floats]:
        """Largest factor of an error, and the pressures of that mode (n,); infinite where the flow is singular. Collective."""
        matrix = self.blocks[1][1]
        if storage is not None:
            matrix = matrix.copy()
            add_storage(matrix, storage, self.summed, self.rate)
        flow = solver_of(matrix, "flow_fieldsplit_flow_")
        pressure, rate = matrix.createVecs()
        # no mode may be missing in the start, whatever the symmetry of the network
        pressure.setArray(np.where(self.held, 0.0, 1.0 + 0.3 * np.cos(1.0 + 2.0 * _here(matrix))))
        estimates = [0.0]
        for _ in range(POWER_ITERATIONS):
            size = pressure.norm()
            if size == 0.0:
                break
            pressure.scale(1.0 / size)
            self.uptake(pressure, rate)
            if storage is not None:
                stored = storage * pressure.getArray(readonly=True)
                stored = stored if self.summed is None else self.summed.with_sums(stored, self.rate)
                rate.setArray(rate.getArray() - stored)
            flow.solve(rate, pressure)
            estimates.append(pressure.norm() if is_solved(matrix, pressure, rate) else np.inf)
            is_settled = all(abs(b - a) <= SETTLED * b for a, b in pairwise(estimates[-3:]))
            if not np.isfinite(estimates[-1]) or (len(estimates) > 3 and is_settled):
                break
        mode = pressure.getArray().copy()
        destroy(flow, pressure, rate, None if storage is None else matrix)
        return estimates[-1], mode

    def destroy(self) -> None:
        """Free matrices and solver. Collective."""
        if self.solid.getPC().getType() == "python":
            self.solid.getPC().setType("none")
        destroy(self.solid, self.rock.stands, self.wall, self.force, *self.blocks[0], *self.blocks[1])


@dataclass(frozen=True)
class Prediction:
    """Prediction of the linearised cycle.

    factor    rho, by which a plain cycle multiplies the error; infinite where the flow is singular
    fracture  where that error is largest
    storage   (n,) volume rate per pressure to be added at this rank's flow nodes; None where none is
    stored    the factor with it
    """

    factor: float
    fracture: str
    storage: Floats | None = None
    stored: float = np.nan

    @property
    def own(self) -> float:
        """The factor of the cycle as it is made: with added storage where there is some."""
        return self.factor if self.storage is None else self.stored


def predict(matrix: JoinedMatrix, problem: StepProblem, with_storage: bool) -> Prediction:
    """Linearise at the trial, which has been evaluated. Collective."""
    cycle = Cycle(matrix, problem)
    try:
        factor, mode = cycle.radius()
        found = Prediction(factor, worst_fracture(matrix.operators, mode))
        if with_storage:
            storage, stored = added_storage(cycle)
            found = replace(found, storage=storage * cycle.scale, stored=stored)
        return found
    finally:
        cycle.destroy()


def factor_with(matrix: JoinedMatrix, problem: StepProblem, storage: Floats) -> float:
    """The factor of cycles with that storage (n,), linearised at the trial, which has been evaluated. Collective."""
    cycle = Cycle(matrix, problem)
    try:
        return cycle.radius(storage / cycle.scale)[0]
    finally:
        cycle.destroy()


def added_storage(cycle: Cycle) -> tuple[Floats, float]:
    """Storage S (n,), scaled, with which the cycle converges, and its factor. Collective.

    alpha_1 A / K_s converges if K_s <= 2 min k_tot, and K_s = k_tot of a uniform pressure is as good as any
    (where-methods-fail 2). The normal stiffness of the joint would serve for closed joints only. Once a joint is open its
    walls are held by the rock alone, the more weakly the longer the fracture is, E' kappa / 4. So the walls are asked: what
    they take up under a uniform pressure holds all of this, inertia too, node by node. It is doubled while the linearised
    cycle does not converge.
    """
    storage = cycle.uniform_uptake()
    factor = np.inf
    for _ in range(DOUBLINGS):
        factor, _ = cycle.radius(storage)
        if factor < 1.0:
            break
        storage = 2.0 * storage
    return storage, factor


def worst_fracture(operators: Operators, mode: Floats) -> str:
    """Name of the fracture in which a mode (n,) of the pressures is largest. Collective."""
    comm, block, nodes = operators.layout.comm, operators.blocks.joints, operators.layout.flow_vector()
    nodes.setArray(np.abs(np.where(np.isfinite(mode), mode, 0.0)))
    values = operators.network.at_ends(nodes).ravel()
    nodes.destroy()
    here = int(values.argmax()) if len(values) else -1
    value = float(values[here]) if here >= 0 else -1.0
    name = block.fractures[block.fracture[here // 2]] if here >= 0 else ""
    return str(max(comm.allgather((value, name)))[1])


def limits_of_time_step(
    radius: Callable[[float], float], factor: float, dt: float
) -> tuple[float | None, float | None]:
    """Time steps (below, above) between which plain cycles diverge; None where none is found.

    radius  factor at a time step, ``factor`` at ``dt``; it falls about as 1/dt above, and as dt below once the inertia
            of the walls resists. Each call factorises.
    """
    found = []
    for power in (-1.0, 1.0):
        step, value = dt, factor
        for _ in range(TRIALS):
            if not np.isfinite(value) or value <= 0.0 or abs(value - 1.0) <= NEAR:
                break
            step *= value ** (-power)
            if not 1.0 / FARTHEST < step / dt < FARTHEST:
                break
            value = radius(step)
        found.append(step if abs(value - 1.0) <= NEAR else None)
    return found[1], found[0]


def scaled(alphas: Alphas, ratio: float) -> Alphas:
    """(4.3) The coefficients of a time step ``ratio`` times as long."""
    a0, a1, a2 = alphas.a0 / ratio**2, alphas.a1 / ratio, alphas.a2 / ratio
    return replace(alphas, a0=a0, a1=a1, a2=a2, a5=alphas.a5 * ratio)


def is_solved(matrix: PETSc.Mat, solution: PETSc.Vec, source: PETSc.Vec) -> bool:
    """Whether A x = b holds at all: a direct solver calls garbage converged where A is singular. Collective."""
    relative, left = true_residual(matrix, solution, source)
    left.destroy()
    return relative <= UNSOLVED


def add_storage(matrix: PETSc.Mat, values: Floats, summed: SummedBalances | None, rate: float) -> None:
    """Add storage (n,) at this rank's flow nodes to a matrix of pressures, where some rows may be sums. Collective."""
    if summed is None:
        add_diagonal(matrix, values)
    else:
        summed.add_diagonal(matrix, values, rate)


def change_of(old: Floats, new: Floats, comm: MPI.Comm) -> float:
    """Largest relative change of positive values (n,) of all ranks; infinite where one was nil. Collective."""
    change = np.abs(new - old)
    relative = np.divide(change, np.abs(old), out=np.where(change > 0.0, np.inf, 0.0), where=old != 0.0)
    return float(comm.allreduce(float(relative.max(initial=0.0)), op=MPI.MAX))


def _here(matrix: PETSc.Mat) -> np.ndarray:
    return np.arange(*matrix.getOwnershipRange()) - matrix.getOwnershipRange()[0]
