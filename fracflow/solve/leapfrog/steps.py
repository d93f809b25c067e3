"""Equal explicit steps in a row, from state to state: motion, joints, sides and energies, each on its own nodes."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, sum_over_ranks
from fracflow.errors import SolveError
from fracflow.integrators.explicit import joint_share, scheme_energy, scheme_work
from fracflow.laws import LawStep
from fracflow.mesh.data import Floats, Ints
from fracflow.model.energy import added, joint_parts
from fracflow.model.loads import Loads
from fracflow.model.state import Forces, Motion, PreviousStep, Sections, State
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import AT_ONCE, Around
from fracflow.solve.explicit import ExplicitModel
from fracflow.solve.leapfrog.ahead import StepsAhead, SupportsAt
from fracflow.solve.leapfrog.in_a_row import Held, Row, steps_in_a_row
from fracflow.solve.leapfrog.joint_nodes import Pushed, joint_nodes
from fracflow.solve.leapfrog.joints import JointSolver, Solved
from fracflow.solve.leapfrog.nodes import Nodes
from fracflow.solve.leapfrog.rock import Sums
from fracflow.solve.leapfrog.section_work import taken_over
from fracflow.solve.request import StepRequest
from fracflow.solve.residual import Largest

SAME = 1e-14  # of the largest load: a difference by the order of sums


class Leapfrog:
    """Explicit steps of rock and joints; those of a fluid are made of the same parts by ``advance.explicit_flow``.

    Velocities go from the middle of a step to that of the next. They meet displacements at the instants of states alone, so
    that steps between states need a single sweep. Energies of the rock are known at those instants. The work of joints, sides,
    damping and loads is summed over all steps, on their own nodes.
    """

    def __init__(self, explicit: ExplicitModel, scene: Scene, loads: Loads) -> None:
        """Find the nodes of everything. Collective."""
        self.nodes = Nodes(explicit.operators, scene, loads, explicit.damping)
        self.joints = JointSolver(explicit.operators, explicit.sections.clusters, scene.accuracy.max_iterations)
        self.run = Run(self.nodes)
        matrices = [each.matrix for each in explicit.damping.values()]
        self._row = steps_in_a_row(self.nodes, self.run.passes, self.joints.guess, matrices)

    def in_a_row(self, ahead: StepsAhead) -> Row | None:
        """Some steps from the run's, the last of all up to an instant; None where loops take none. Collective.

        A request that holds statuses is not for the loops.
        """
        run = self.run
        row = None if self._row is None or ahead.request.hold else self._row.take(run.held, run.base, run.beside, ahead)
        if row is not None:
            self.run.go_on(row)
        return row

    def joints_at_end(self, free: Floats, request: StepRequest) -> Solved:
        """Joints without a fluid at the end of a step, from their free motion (s, dim). Raises NotConverged. Collective."""
        before, law_step = self.run.sections, LawStep(request.time, self.run.dt, True, request.hold)
        return self.joints.solve(before, free, joint_share(self.run.dt), law_step)

    def destroy(self) -> None:
        """Free matrices. Collective."""
        destroy(self.nodes, self._row)


@dataclass
class BalanceSums:
    """Sums over the steps between two states, of this rank [energy per thickness].

    scheme, boundaries   see ``integrators.explicit.scheme_energy``, and the work of what is held and of loads that change
    taken, brought       of terms by their names
    joints               (5,) see ``model.energy.joint_work``
    """

    scheme: float
    boundaries: float
    taken: dict[str, float]
    brought: dict[str, float]
    joints: Floats


@dataclass(frozen=True)
class RockSums:
    """Sums over the rock at one instant, of this rank.

    strain    strain energy;  ``springs`` that of the K of terms
    moving    v M v;  ``pushed`` m a^2 where it is free, but for rigid bodies
    prestress, constant  work of the initial stress on displacements, and of loads where none changes
    largest   displacement and force of inertia; None where masses are no diagonal, as those of rigid bodies
    """

    strain: float
    springs: dict[str, float]
    moving: float
    pushed: float
    prestress: float
    constant: float
    largest: Largest | None


class Run:
    """Steps from a state to the next: arrays of the rock, and of ``Nodes.every``."""

    def __init__(self, nodes: Nodes) -> None:
        """No state yet."""
        self.nodes, self.rock, self.passes = nodes, nodes.rock, joint_nodes(nodes)
        self.last: State | None = None
        self.damping_waits = False
        self.constant = np.zeros(self.rock.e.shape)
        self.loaded = np.zeros(0, dtype=np.int64)
        self.sums: RockSums | None = None

    def begin(self, state: State, dt: float) -> None:
        """Take over a state. Raises SolveError, on every rank, where loads act that it has not. Collective."""
        nodes, rock, forces = self.nodes, self.rock, state.forces
        self.dt, is_new = dt, self.last is not state
        if is_new:
            self._take_loads(state)
        self.last = None
        if is_new:
            for vector, values in zip(state.motion.vectors, (rock.u, rock.v, rock.a), strict=True):
                rock.begin(vector, values)
            rock.step(0.0, 0.0)
            self.sums = self._rock_sums(rock.sums(nodes.prestress))
            self.damping_waits = bool(nodes.damping) and not self._has_slid(state.sections)
        self.old_sums = self.sums
        self.sections, self.friction = state.sections, state.friction
        self.total = state.sections.traction
        if nodes.operators.flow is not None:
            self.total = self.total.copy()
            self.total[:, -1] -= nodes.operators.flow.at_ends(state.pressure).ravel()
        self.load = forces.load.getArray(readonly=True)[nodes.changing.numbers]
        self.support = forces.support.getArray(readonly=True)[nodes.held]
        zero = np.zeros(len(nodes.own))
        self.resisting = {
            term.name: forces.of_terms[term.name].getArray(readonly=True)[nodes.own]
            if term.name in forces.of_terms
            else zero
            for term in nodes.acting
        }
        self.damped = {
            name: forces.of_terms[name].getArray(readonly=True)[each.numbers]
            if name in forces.of_terms
            else np.zeros(len(each.numbers))
            for name, each in nodes.damping.items()
        }
        self.powers = dict(forces.powers)
        self.a, self.own_a = rock.a[nodes.places_pushed], rock.a[nodes.places_own]
        self.held_at = rock.u[nodes.places[nodes.at_held]]
        self.own_speed = rock.v[nodes.places_own]
        self.balance = BalanceSums(0.0, 0.0, {}, {}, np.zeros(5))
        rock.start(dt)

    def _take_loads(self, state: State) -> None:
        """Loads that stay, in the order of the rock. Raises SolveError, on every rank, where a state lacks them. Collective."""
        nodes, changing, layout = self.nodes, self.nodes.changing, self.nodes.operators.layout
        anchor = state.forces.anchor if nodes.acting else None
        constant = changing.constant(state.time, state.controls, AT_ONCE, anchor)
        values, had = constant.getArray(readonly=True), state.forces.load.getArray(readonly=True)
        apart = np.abs(had - values)
        apart[changing.numbers] = 0.0
        sizes = np.array([apart.max(initial=0.0), np.abs(values).max(initial=0.0)])
        worst, largest = (max(each) for each in zip(*layout.comm.allgather(sizes.tolist()), strict=True))
        if worst > SAME * largest:
            constant.destroy()
            raise SolveError(
                f"time {state.time:.6g}: loads that do not change are off by {worst:.3g} as explicit steps begin: a fault of"
                ' the program; use stepper = "newmark"'
            )
        self.rock.begin(constant, self.constant)
        changes = nodes.places[nodes.at_loads]
        self.beside = self.constant[changes]
        self.loaded = np.setdiff1d(np.flatnonzero(self.constant), changes)
        np.subtract(self.constant, nodes.prestress, out=self.rock.e)
        self.base = self.rock.e[nodes.places_forced]
        self.rock.keep(nodes.places_forced)
        constant.destroy()

    def _rock_sums(self, sums: Sums) -> RockSums:
        """Those of the present instant, of whose displacements the last sweep was."""
        nodes, rock = self.nodes, self.rock
        springs = {}
        for name, matrix in nodes.springs.items():
            u = rock.u[nodes.places[nodes.at_springs[name]]]
            springs[name] = 0.5 * float(u @ matrix.times(u))
        moving, pushed, prestress, inertia, displacement = sums
        apart = nodes.is_held | nodes.on_body
        pushed -= float(nodes.mass[nodes.every[apart]] @ rock.a[nodes.places[apart]] ** 2)
        if len(nodes.bodies):
            speed = rock.v[nodes.places_own]
            moving += float(speed @ (nodes.inertia.times(speed) - nodes.mass[nodes.own] * speed))
        constant = float(self.constant[self.loaded] @ rock.u[self.loaded])
        ops = nodes.operators
        largest = Largest(displacement, inertia) if ops.expand is None and ops.inward is None else None
        return RockSums(rock.energy, springs, moving, pushed, prestress, constant, largest)

    def predict(self, time: float, controls: Mapping[str, float], around: Around) -> None:
        """Motion of all nodes in a step without what joints change in it. Collective."""
        nodes, dt, count = self.nodes, self.dt, len(self.nodes.pushed)
        moved = self.passes.predicted(self.rock.v, dt)
        load = self.beside + nodes.changing.changing(time, controls, around)
        force, added = np.zeros(count), np.zeros(count)
        if nodes.changing.is_any:
            force[nodes.by_loads] += load - self.load
            added = joint_share(dt) * nodes.accelerated(force)  # to displacements, beside dt v
            moved[nodes.pushed] += added
        self.old_load, self.load = self.load, load
        self.step = Pushed(force, added, moved)
        if len(nodes.held):
            self.old_held_at, self.held_at = self.held_at, nodes.prescribed(lambda part: part.value(time, AT_ONCE))
            moved[nodes.at_held] = self.held_at - self.old_held_at

    @property
    def held(self) -> Held:
        """Values of the last step with which the next one begins, where no body is rigid."""
        of_own = self.nodes.held_of_own
        supports = SupportsAt(self.held_at, self.own_speed[of_own], self.own_a[of_own])
        ended = self.sections, self.friction, self.a, self.resisting, self.damped
        return Held(*ended, self.load, self.support, supports, self.powers, self.damping_waits)

    def go_on(self, row: Row) -> None:
        """Take over steps in a row."""
        balance, of_own, new = self.balance, self.nodes.held_of_own, row.held
        self.sections, self.friction, self.total = new.sections, new.friction, new.sections.traction
        self.a, self.load, self.support, self.held_at = new.acceleration, new.load, new.support, new.supports.at
        self.damping_waits = new.damping_waits
        self.own_speed, self.own_a = self.own_speed.copy(), self.own_a.copy()
        self.own_speed[of_own], self.own_a[of_own] = new.supports.speed, new.supports.acceleration
        self.resisting, self.damped, self.powers = dict(new.resisting), dict(new.damped), dict(new.powers)
        self.rock.energy = row.energy
        balance.scheme += row.scheme
        balance.boundaries += row.boundaries
        balance.joints += row.joints
        for name, work in row.taken.items():
            self._take(name, work)
        for name, work in row.brought.items():
            balance.brought[name] = balance.brought.get(name, 0.0) + work

    def free_strain(self) -> Floats:
        """Changes of the strains (s, dim) of the joints by that. Collective."""
        return self.passes.jump(self.step.moved)

    def pull(self, found: Sections, pressed: Floats | None = None) -> None:
        """Take the response of the joints at the end of the step. Collective.

        pressed  pressures (s,) of a fluid at their sections; None without one
        """
        before, total = self.sections, found.traction
        if pressed is not None:
            total = total.copy()
            total[:, -1] -= pressed
        moved = self.passes.pull(self.step, self.total, total, joint_share(self.dt))
        self.total = total
        weights = self.nodes.operators.joints.weights
        self.sections, self.friction, work = taken_over(weights, before, found, moved, self.friction)
        self.balance.joints += work

    def move(self, time: float, around: Around, is_last: bool) -> None:
        """Forces at the end of a step, and the motion of all nodes on to the middle of the next. Collective."""
        nodes, rock, dt, places = self.nodes, self.rock, self.dt, self.nodes.places
        moved, own = self.step.moved, nodes.places_own
        self.passes.shift(self.step.added)
        rock.u[places[nodes.at_held]] = self.held_at
        force = self.base.copy()
        if len(nodes.at_loads):
            force[nodes.at_loads] = self.load - nodes.prestress[places[nodes.at_loads]]
        self.passes.resist(self.total, force)
        self._damp(force)
        for name, matrix in nodes.springs.items():
            at = nodes.at_springs[name]
            force[at] -= matrix.times(rock.u[places[at]])
        self.passes.place(force)
        u, v = rock.u[own], rock.v[own]
        kick, drift = (0.5 * dt, 0.0) if is_last else (dt, dt)
        rock.step(kick, drift)
        a, old_a = self.passes.accelerated(), self.a
        at_own, resisting = self._own_nodes(rock.f[own], v, time, around)
        a[nodes.pushed_own] = at_own[nodes.own_pushed]
        self.a, self.own_a = a, at_own
        held_speed = self.own_speed[nodes.held_of_own]
        v = v + kick * at_own
        if not is_last:
            v[nodes.held_of_own] = held_speed + 0.5 * dt * at_own[nodes.held_of_own]
            rock.u[own] = u + drift * v
        else:
            v[nodes.held_of_own] = held_speed
            rock.a[own] = at_own
        rock.v[own] = v
        balance = self.balance
        balance.scheme += scheme_work(dt, self.passes.gain(self.step.force, old_a, a))
        balance.boundaries += 0.5 * float((self.old_load + self.load) @ moved[nodes.at_loads])
        for name, each in resisting.items():
            self._take(name, 0.5 * float((self.resisting[name] + each) @ moved[nodes.at_own]))
        self.resisting = resisting

    def _has_slid(self, sections: Sections) -> bool:
        """Whether any section of all ranks has slid, or is open. Collective."""
        is_here = bool(sections.inelastic.any() or sections.is_open.any())
        return bool(self.nodes.operators.layout.comm.allreduce(is_here, op=MPI.LOR))

    def _damp(self, force: Floats) -> None:
        """Take what damps the mean velocity of the step off forces (m,), and add its work. Collective.

        Nothing before the first section slides, that of this step included.
        """
        self.damping_waits = self.damping_waits and not self._has_slid(self.sections)
        if self.damping_waits:
            return
        for name, each in self.nodes.damping.items():
            at = self.nodes.at_damped[name]
            here = force[at]
            self.damped[name], work = each.damp(self.step.moved[at], self.dt, self.damped[name], here)
            force[at] = here
            self._take(name, work)

    def _take(self, name: str, work: float) -> None:
        self.balance.taken[name] = self.balance.taken.get(name, 0.0) + work

    def _own_nodes(self, force: Floats, v: Floats, time: float, around: Around) -> tuple[Floats, dict[str, Floats]]:
        """Accelerations (n,) of nodes with supports or dashpots, and the forces of terms there at the end of the step.

        force  (n,) of all but these terms; v (n,) velocities at the middle of the step
        """
        nodes, dt = self.nodes, self.dt
        incoming = self._incoming(time, around)
        resists = np.zeros(len(v))
        dashpots = nodes.dashpots.items()
        for name, blocks in dashpots:
            resists += blocks.times(v)
            if name in incoming:
                resists -= incoming[name]
        a = nodes.inverse_with_dashpots(dt).times(force - resists)
        speed = v + 0.5 * dt * a
        held, at = nodes.held_of_own, nodes.at_held
        old_speed, old_a = self.own_speed, self.own_a
        if len(held):
            a[held] = nodes.prescribed(lambda part: part.acceleration(time, around))
            speed[held] = nodes.prescribed(lambda part: part.speed(time, around))
        self.own_speed = speed
        found = {name: blocks.times(speed) - incoming.get(name, 0.0) for name, blocks in dashpots}
        if len(held) or len(nodes.bodies):
            of_end, both, gain = (nodes.inertia.times(each) for each in (a, old_a + a, speed - old_speed))
            gained = 0.5 * (old_speed + speed) * gain
        if len(held):
            support = of_end[held] - force[held]
            for each in found.values():
                support += each[held]
            work = 0.5 * (self.support + support) - 0.5 * both[held]
            self.balance.boundaries += float(work @ self.step.moved[at] + gained[held].sum())
            self.support = support
        if len(nodes.bodies):
            left = 0.5 * self.step.moved[nodes.at_own] * both - gained
            self.balance.scheme += float(left[nodes.free_bodies].sum())
        return a, found

    def _incoming(self, time: float, around: Around) -> dict[str, Floats]:
        """Forces (n,) that waves bring in at ``Nodes.own``, by the names of terms."""
        nodes, found = self.nodes, {}
        for term in nodes.waves:
            force = nodes.operators.layout.solid_vector()
            power = term.incoming(time, around, force)
            assert power is not None
            found[term.name] = force.getArray(readonly=True)[nodes.own].copy()
            brought = 0.5 * self.dt * (self.powers.get(term.name, 0.0) + power)
            self.balance.brought[term.name] = self.balance.brought.get(term.name, 0.0) + brought
            self.powers[term.name] = power
            force.destroy()
        return found

    def end(
        self, state: State, request: StepRequest, around: Around, fluid: Mapping[str, float] = MappingProxyType({})
    ) -> State:
        """The state after the last step. Collective.

        state  that at its beginning, but for what a fluid has changed since
        fluid  entries that this has added to the energy balance
        """
        nodes, rock, layout = self.nodes, self.rock, self.nodes.operators.layout
        motion = Motion(*(layout.solid_vector() for _ in range(3)))
        self.sums = self._rock_sums(rock.stop(motion.vectors, nodes.prestress))

        def at(numbers: Ints, values: Floats) -> PETSc.Vec:
            result = layout.solid_vector()
            result.getArray()[numbers] = values
            return result

        old = state.forces
        load = copy(old.load)
        if nodes.changing.is_any:  # on all ranks alike: they agree on whether the size of a vector is known
            load = old.load.copy()
            load.getArray()[nodes.changing.numbers] = self.load
        of_terms = {name: at(nodes.own, values) for name, values in self.resisting.items()}
        of_terms |= {name: at(nodes.damping[name].numbers, values) for name, values in self.damped.items()}
        support = at(nodes.held, self.support) if nodes.no_support is None else copy(nodes.no_support)
        anchor = None if old.anchor is None else copy(old.anchor)
        forces = Forces(load, support, old.conduction.copy(), old.source.copy(), of_terms, self.powers, anchor)
        self.last = replace(
            state,
            time=request.time,
            motion=motion,
            pressure=state.pressure.copy(),
            sections=self.sections,
            forces=forces,
            controls=dict(request.controls),
            energy=added(state.energy, self._parts(fluid)),
            friction=self.friction,
            previous_step=PreviousStep(),
            uptake=None if state.uptake is None else state.uptake.copy(),
            adjacent_steps=around,
        )
        return self.last

    def _parts(self, fluid: Mapping[str, float]) -> dict[str, float]:
        """Entries that the steps add to the energy balance, and those of a fluid. Collective."""
        nodes, balance, before, after = self.nodes, self.balance, self.old_sums, self.sums
        assert before is not None and after is not None
        here = {f"taken {term.name}": balance.taken.get(term.name, 0.0) for term in nodes.operators.terms}
        for name, energy in after.springs.items():
            here[f"taken {name}"] += energy - before.springs[name]
        here |= {
            "kinetic": 0.5 * (after.moving - before.moving),
            "rock_strain": after.strain - before.strain + after.prestress - before.prestress,
            "scheme": balance.scheme + scheme_energy(self.dt, before.pushed, after.pushed),
            "work_boundaries": balance.boundaries + after.constant - before.constant,
        }
        values = sum_over_ranks(np.concatenate([list(here.values()), balance.joints]), nodes.operators.layout.comm)
        total = dict(zip(here, values.tolist(), strict=False))
        parts = {name: value for name, value in total.items() if not name.startswith("taken ")}
        parts |= joint_parts(values[len(here) :])
        for term in nodes.operators.terms:
            parts |= term.energy(total[f"taken {term.name}"], balance.brought.get(term.name, 0.0))
        return {name: parts.get(name, 0.0) + fluid.get(name, 0.0) for name in {**parts, **fluid}}
