"""An explicit step: the rock by central differences, joints and flow at its end by themselves (``integrators.explicit``)."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.errors import SolveError
from fracflow.integrators.explicit import joint_share, predicted, velocity_after
from fracflow.mesh.data import Floats
from fracflow.model.balance import static_balance
from fracflow.model.loads import Loads
from fracflow.model.mass import Solve, damped_mass, inverse_mass, longest_step
from fracflow.model.operators import Operators
from fracflow.model.state import Forces, Motion, MotionValues, StepReport
from fracflow.scene.scene import Scene
from fracflow.solve.clusters import find_clusters
from fracflow.solve.problem import StepProblem
from fracflow.solve.residual import Residual
from fracflow.solve.sections import SectionSolver

MOST_KEPT = 4  # lengths of steps whose damped masses are kept


class ExplicitProblem(StepProblem):
    """A step whose velocities and accelerations are those of central differences; its coupling leaves ``end`` here."""

    end: tuple[Floats, Floats, Forces]

    def velocity(self) -> PETSc.Vec:
        """Velocity at the end of the step, in a new vector."""
        return self._vector(self.end[0])

    def acceleration(self) -> PETSc.Vec:
        """Acceleration at the end of the step, in a new vector."""
        return self._vector(self.end[1])

    def _vector(self, values: Floats) -> PETSc.Vec:
        result = self.displacement.duplicate()
        result.setArray(values)
        return result

    def forces(self, motion: Motion) -> Forces:
        """Terms of both balances at the end of the step; the caller owns them."""
        return self.end[2]


class ExplicitCoupling:
    """Makes explicit steps of one scene, whatever its wells do; supports stay those it is made with.

    Where terms have a C, M + dt/2 C takes the place of M for accelerations: C acts on the velocity at the end of the step, and
    does not limit the step. Their D acts on the mean velocity of the step, and does limit it.

    critical  the longest stable time step, by the rock and its terms alone [time]
    notes     lines of the log on D
    """

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Find inverse mass, clusters and critical time step. Raises InputError, on every rank. Collective."""
        self.operators = operators
        self._damped: dict[float, Solve] = {}
        self.held = loads.held
        self.inverse = inverse_mass(operators, self.held)
        made = {term.name: term.mean_damping() for term in operators.terms}
        self.damping = {name: damping for name, damping in made.items() if damping is not None}
        self.notes = tuple(damping.note for damping in self.damping.values())
        self.critical = longest_step(operators, scene, self.inverse, list(self.damping.values()))
        clusters = find_clusters(operators.joints, self.inverse, operators.layout.comm)
        self.sections = SectionSolver(scene, operators, clusters)

    def solve(self, problem: StepProblem) -> StepReport:
        """Bring an ``ExplicitProblem`` to the end of its step. Raises SolveError, on every rank. Collective."""
        assert isinstance(problem, ExplicitProblem)
        if problem.loads.closures:
            raise SolveError(
                f'time {problem.time:.6g}: method.stepper = "explicit" needs walls that move in each part of the network that'
                ' no pressure drains: give a [[well]] with a pressure there, fluid.compressibility, or stepper = "newmark"'
            )
        ops, state, dt = self.operators, problem.state, 2.0 / problem.alphas.a1
        joints, old = ops.joints, state.motion.values()
        force, moved = problem.load.copy(), ops.layout.solid_vector()
        force.axpy(-1.0, state.forces.load)
        self.inverse.mult(force, moved)
        problem.move(predicted(old, dt) + joint_share(dt) * moved.getArray())
        unforced = joints.strain(problem.increment)
        _, report = self.sections.solve(problem, unforced, joint_share(dt))
        pull = self.sections.total_traction(problem.sections.traction, problem.pressure)
        pulled = self.sections.total_traction(state.sections.traction, state.pressure)
        force.set(0.0)
        joints.force(pulled - pull, force)
        self.inverse.mult(force, moved)
        problem.move(problem.increment.getArray() + joint_share(dt) * moved.getArray())
        problem.accept(problem.sections)
        destroy(force, moved)
        problem.end = self._end(problem, old, dt)
        problem.residual = Residual(report.motion, report.flow, 0.0)
        fills = report.iterations if ops.flow is not None else 0
        return StepReport(report.iterations, 0, 1, fills, report.motion, report.flow)

    def _end(self, problem: ExplicitProblem, old: MotionValues, dt: float) -> tuple[Floats, Floats, Forces]:
        """Velocity, acceleration and terms of the balances at the end of a step."""
        ops, held = self.operators, self.held
        force = static_balance(ops, problem.displacement, problem.sections.traction, problem.pressure, problem.load)
        force.scale(-1.0)
        damped = {name: damping.force(problem.increment, dt) for name, damping in self.damping.items()}
        for each in damped.values():
            force.axpy(-1.0, each)
        new = self._accelerated(problem, force, old.velocity + 0.5 * dt * old.acceleration, dt)
        speed = velocity_after(old, new, dt)
        # what is held moves as in an implicit step
        for values, given in ((new, StepProblem.acceleration(problem)), (speed, StepProblem.velocity(problem))):
            values[held] = given.getArray(readonly=True)[held]
            given.destroy()
        term, support = force.duplicate(), force.duplicate()
        term.setArray(new)
        ops.mass.mult(term, support)
        support.axpy(-1.0, force)
        term.setArray(speed)
        of_terms, anchor = problem.terms.forces(term), problem.terms.anchor
        destroy(force, term)
        for each in of_terms.values():
            support.axpy(1.0, each)
        is_held = np.zeros(len(new), dtype=bool)
        is_held[held] = True
        support.getArray()[~is_held] = 0.0
        conduction, source = self._flow_terms(problem)
        kept, of_terms = None if anchor is None else anchor.copy(), of_terms | damped
        powers = problem.terms.powers
        return speed, new, Forces(problem.load.copy(), support, conduction, source, of_terms, powers, kept)

    def _accelerated(self, problem: ExplicitProblem, force: PETSc.Vec, speed: Floats, dt: float) -> Floats:
        """Accelerations (n,) by a force and by C; ``speed`` is without what they add to it. Collective."""
        result = force.duplicate()
        result.setArray(speed)
        resisting = problem.terms.forces(result)
        if not resisting:
            self.inverse.mult(force, result)
            new: Floats = result.getArray().copy()
        else:
            if dt not in self._damped:
                if len(self._damped) == MOST_KEPT:
                    self._damped.clear()
                self._damped[dt] = damped_mass(self.operators, self.held, 0.5 * dt)
            force.copy(result)
            for each in resisting.values():
                result.axpy(-1.0, each)
                each.destroy()
            new = self._damped[dt](result.getArray())
        result.destroy()
        return new

    def _flow_terms(self, problem: ExplicitProblem) -> tuple[PETSc.Vec, PETSc.Vec]:
        """K_F p, and Q with what prescribed pressures draw in."""
        network, solver = self.operators.flow, self.sections.flow
        conduction, source = self.operators.layout.flow_vector(), problem.source.copy()
        if network is None or solver is None:
            return conduction, source
        assert problem.conduction is not None
        network.outflow(problem.conduction, conduction)
        drawn, given = self.operators.layout.flow_vector(), solver.given(problem)
        network.storage_coupling.multTranspose(problem.increment, drawn)
        drawn.scale(problem.alphas.a1)
        drawn.axpy(1.0, conduction)
        if (uptake := problem.uptake()) is not None:
            drawn.axpy(1.0, uptake)
            uptake.destroy()
        given.axpy(-1.0, problem.source)
        drawn.axpy(-1.0, given)
        for part in problem.loads.pressures:
            source.getArray()[part.numbers] = drawn.getArray()[part.numbers]
        destroy(drawn, given)
        return conduction, source

    def destroy(self) -> None:
        """Free matrices and solver. Collective."""
        destroy(self.sections, self.inverse)
