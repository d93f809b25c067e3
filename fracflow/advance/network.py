"""Finds the connected components of the network, and closes those that nothing drains."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.advance.outcome import Log
from fracflow.errors import MOST_NAMED, SolveError
from fracflow.integrators import Alphas
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.flow import Conduction
from fracflow.model.loads import Limit, Loads
from fracflow.model.network_parts import CONDUCTS, FIRM, NetworkComponent, NetworkComponents, beside, holding, leaving
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.model.terms.term import TermStep
from fracflow.model.undrained import FaintParts, change_volume, close, sum_balances
from fracflow.remarks import marked, note
from fracflow.scene.time_table import JUST_AFTER, JUST_BEFORE
from fracflow.scene.units import AREA, FLOW_RATE
from fracflow.solve.initial_rates import EnclosedComponent
from fracflow.solve.problem import StepProblem

BALANCED = 1e-12  # of the sum of the flow rates' sizes
AGREES = 1e-6  # of the sizes of flow rates and wall motions: the balance that the last stage ended with has few digits


FAINT = 1e-6
"""Of what a node conducts: where all that a part stores is less, sums of its balances keep fewer than ten digits."""
STRONG = 1e-3
"""Of what the node that conducts most does: a sum takes the place of the balance at such a node, which others imply."""


@dataclass(frozen=True)
class _Closed:
    """Loads with the undrained components closed, and the wells of each.

    gives   (k,) firm parts whose walls change their volume
    stores  (k,) firm parts in which nothing but storage settles a level
    given   (k,) prescribed pressures of each firm part that stores
    is_any  whether there is a part of either kind, on any rank
    """

    loads: Loads
    parts: tuple[tuple[NetworkComponent, tuple[str, ...], bool], ...]
    gives: Bools
    stores: Bools
    given: Floats
    is_any: bool


@dataclass(frozen=True, eq=False)
class StepBegin:
    """A step that a rule, with its coefficients, begins at a state: a part may store next to nothing in it."""

    state: State
    alphas: Alphas


class FlowNetwork:
    """The present components of a model's network."""

    def __init__(self, model: Model, log: Log = lambda line: None) -> None:
        """Start without components, which the first step finds. Collective."""
        self.model, self.log = model, log
        self._conducts: Bools | None = None
        self._holds = np.zeros(0, dtype=bool)
        self._leaves, self._leaks_off = (leaving(model.operators, by_memory) for by_memory in (False, True))
        self._logged: Bools | None = None
        self._has_logged_digits = False
        self._parts: NetworkComponents | None = None
        self._firm: tuple[Bools, NetworkComponents] | None = None  # elements, and parts that they join
        self._closed: dict[tuple[Loads, bool, bool], _Closed] = {}
        self._summed: dict[tuple[Loads, bool, bool], _Closed] = {}
        self._little: dict[tuple[Loads, bool, bool], tuple[weakref.ref[StepBegin], Bools, Ints]] = {}
        self.version = 0
        # weak: a state that is done with is freed, and a new one may have its id
        self._found_at: tuple[weakref.ref[State] | None, int, Conduction | None] = (None, 0, None)

    def log_digits(self, line: str) -> None:
        """Write down that the flow has few digits, the first time only."""
        if not self._has_logged_digits:
            self.log(marked(line))
        self._has_logged_digits = True

    def close(self, loads: Loads, stores: bool, begin: StepBegin | None = None) -> Loads:
        """The same loads with the undrained components closed, where nothing is stored. Collective.

        stores  the walls' motion takes part in the balance, so that it settles the pressures of a part
        begin   of the step, in which a part may store less than the round-off of what it conducts
        """
        if self.model.operators.flow is None:
            return loads
        found = self._found(loads, stores)
        if begin is None or not found.is_any or min(begin.alphas.a1, begin.alphas.b1) <= 0.0:
            return found.loads
        return self._by_storage((loads, stores, False), found, begin).loads

    def level(self, loads: Loads, state: State) -> Loads:
        """The same loads for the first instant of a stage with inertia: undrained components keep their mean pressure.

        The walls have their velocities then, and leave the level open. Raises SolveError, on every rank, naming a part
        into which wells pump from that instant what its walls do not take up. Collective.
        """
        found, depth = self._found(loads, True, at_start=True), self.model.scene.flow_depth
        if not found.parts:
            return found.loads
        conduction = self._conduction(state)
        lost, carried = self._lost(conduction), conduction.conductance * np.ptp(conduction.pressure, axis=1)
        # no balance was held closer than to this share of the largest flow
        comm = self.model.operators.layout.comm
        largest = comm.allreduce(float(carried.max(initial=0.0)), op=MPI.MAX)
        least = self.model.scene.accuracy.residual * depth * largest
        for part, wells, _ in found.parts:
            rates = [loads.demanded(well, state.time, state.controls, state.adjacent_steps) for well in wells]
            rates.append(-depth * self._sum(lost, part))
            taken, moved = self._taken(part, state)
            if abs(sum(rates) - depth * taken) > AGREES * (sum(map(abs, rates)) + depth * moved) + least:
                raise SolveError(
                    f"time {state.time:.6g}: no initial pressures: {self._sum_of(wells, rates)} from the first instant in"
                    f" {part}, which no pressure drains, and its walls, as they move, take up {depth * taken:.6g}"
                    f"{self._unit}: let flow rates start at what the stage before ends with, or at 0, or give a [[well]] with"
                    " a pressure there"
                )
        return found.loads

    def _taken(self, part: NetworkComponent, state: State) -> tuple[float, float]:
        """Rate of volume that the walls of a component open, and the sum of its absolute values [area/time]. Collective."""
        assert self._parts is not None
        closure = close(self.model.operators, self._parts, part, part.count > 1)
        if closure.by != "walls":
            return 0.0, 0.0
        moved = closure.weights.times(state.motion.velocity)
        taken, size = self.model.operators.layout.comm.allreduce(np.array([moved.sum(), np.abs(moved).sum()])).tolist()
        return taken, size

    def enclosed(self, loads: Loads, state: State, dt: float) -> list[EnclosedComponent]:
        """The parts whose level the walls settle, with what wells begin to pump in the first ``dt``. Collective."""
        depth, found = self.model.scene.flow_depth, list[EnclosedComponent]()
        for part, wells, moves in self._found(loads, True, at_start=True).parts:
            assert self._parts is not None
            if not moves or part.count == 1:
                continue
            rate = 0.0
            ends = (state.time + dt, 1.0, JUST_BEFORE), (state.time, -1.0, JUST_AFTER)
            for time, sign, side in ends if dt > 0.0 else ():
                rate += sign * sum(loads.demanded(well, time, state.controls, side) for well in wells) / (dt * depth)
            weights = close(self.model.operators, self._parts, part, True).weights
            found.append(EnclosedComponent(part.nodes - self._first, weights, rate))
        return found

    def overfull(self, loads: Loads, stores: bool, problem: StepProblem) -> frozenset[Limit]:
        """Limits that wells come to because what they pump, at a solved or failed trial, has nowhere to go. Collective.

        Raises SolveError, on every rank, naming a closed part into which more flows than out, and no well has a limit.
        """
        found: set[Limit] = set()
        parts = self._found(loads, stores).parts if self.model.operators.flow is not None else ()
        swept, moved = _swept(problem) if parts else (np.zeros(0), 0.0)
        lost = self._lost(problem.conduction) if parts else np.zeros(0)
        depth, comm = self.model.scene.flow_depth, self.model.operators.layout.comm
        for part, wells, gives in parts:
            asked = replace(problem.request, loads=loads)
            rates = [problem.rule.demanded(asked, well) for well in wells]
            rates.append(-depth * self._sum(lost, part))
            total = sum(rates)
            if abs(total) > BALANCED * sum(map(abs, rates)):
                limits = [
                    each
                    for each in loads.limits
                    if each.well in wells and each.sign * total > 0.0 and problem.rule.pushes(asked, each)
                ]
                if not limits:
                    self._refuse(part, wells, rates, gives, problem.time)
                found.add(min(limits, key=lambda limit: limit.sign * limit.pressure))
            here = part.nodes - self._first
            if comm.allreduce(bool(self._holds[here].any()), op=MPI.LOR):
                continue
            room, size = comm.allreduce(np.array([swept[here].sum(), np.abs(swept[here]).sum()])).tolist()
            slack = BALANCED * (size + self.model.operators.scales.length * moved * part.count)
            if not gives and abs(room) > slack and (stores or part.count > 1):
                other = "fluid.compressibility" if problem.fluid_before is None else "minimum_hydraulic_aperture"
                unit = self.model.scene.unit_system.behind(AREA)
                raise SolveError(
                    f"time {problem.time:.6g}: the walls that are moved change the volume of {part}, which no pressure drains,"
                    f" by {room:.3g}{unit} per thickness in a step, and no wall gives way: give a [[well]] with a pressure"
                    f" there, or let a wall move{f', or give {other}' if stores else ''}"
                )
        return frozenset(found)

    def _found(self, loads: Loads, stores: bool, at_start: bool = False) -> _Closed:
        key = (loads, stores, at_start)
        if key not in self._closed:
            self._closed[key] = self._make(loads, stores, at_start)
        return self._closed[key]

    def _by_storage(self, key: tuple[Loads, bool, bool], found: _Closed, begin: StepBegin) -> _Closed:
        """The same with the balances of the parts summed that store next to nothing in a step. Collective."""
        comm, last = self.model.operators.layout.comm, self._summed.get(key)
        known, little, roots = self._little.get(key, (lambda: None, found.gives, found.gives.astype(np.int64)))
        if known() is not begin:
            little, roots = self._store_little(found.gives, begin)
            little &= found.stores | (found.given > 0.0)
            roots = np.where(little & found.stores, roots, -1)
            self._little[key] = weakref.ref(begin), little, roots
        if not comm.allreduce(bool(little.any()), op=MPI.LOR):
            return found
        faint = None if last is None else last.loads.faint
        is_same = faint is not None and np.array_equal(faint.faint, little) and np.array_equal(faint.roots, roots)
        if last is None or not comm.allreduce(is_same, op=MPI.LAND):
            if last is not None:
                destroy(last.loads.summed)
                self.version += 1
            last = self._summed[key] = self._with_sums(found, little, roots)
        return last

    def _with_sums(self, found: _Closed, little: Bools, roots: Ints) -> _Closed:
        """The same by which of its firm parts (k,) store next to nothing, and the roots (k,) of sums. Collective."""
        summed, parts = None, self._firm_parts
        if self.model.operators.layout.comm.allreduce(bool((roots >= 0).any()), op=MPI.LOR):
            summed = sum_balances(self.model.operators, parts, roots, found.gives)
        faint = FaintParts(parts, little, found.given, roots)
        return replace(found, loads=replace(found.loads, summed=summed, faint=faint))

    def _store_little(self, gives: Bools, begin: StepBegin) -> tuple[Bools, Ints]:
        """Firm parts (k,) that store less in a step than the round-off of what they conduct, and roots (k,). Collective.

        Walls give at least as much as one joint and the rock beside it do, each L wide, between walls that are held.
        """
        state, alphas = begin.state, begin.alphas
        last, _, known = self._found_at
        conduction = known if known is not None and last is not None and last() is state else self._conduction(state)
        ops, parts = self.model.operators, self._firm_parts
        network, ends, count = ops.network, parts.ends, len(parts.roots)
        normal = state.sections.tangent[:, -1, -1].reshape(-1, ops.joints.points).max(axis=1, initial=0.0)
        resists = normal * network.length + ops.scales.stiffness
        opened = 0.5 * network.length**2 / np.where(resists > 0.0, resists, np.inf)
        stored = alphas.a1 * gives[ends] * opened[:, None]
        if conduction.compression is not None:
            stored = stored + alphas.b1 * conduction.compression.weight
        stores = parts.summed(np.bincount(ends.ravel(), stored.ravel(), count))
        sent, largest = network.at_nodes(np.repeat(conduction.conductance[:, None], 2, axis=1)), np.zeros(count)
        np.maximum.at(largest, parts.own, sent)
        largest = parts.largest(largest)
        strong, roots = np.flatnonzero(sent >= STRONG * largest[parts.own]), np.full(count, -np.inf)
        np.maximum.at(roots, parts.own[strong], -(self._first + strong.astype(float)))
        return np.asarray(stores < FAINT * largest), -parts.largest(roots).astype(np.int64)

    def update(self, state: State) -> None:
        """Find the components at a state, if they are not those that were found last. Collective."""
        last, version, _ = self._found_at
        if last is None or last() is not state or version != self.version:
            conduction = self._conduction(state)
            self.check(conduction)
            self._found_at = weakref.ref(state), self.version, conduction

    def _conduction(self, state: State) -> Conduction:
        ops = self.model.operators
        assert ops.flow is not None
        walls = ops.joints.walls(state.sections, ops.flow.law)
        return ops.flow.conduct(state.motion.displacement, state.pressure, walls, TermStep(state.memory))

    def check(self, conduction: Conduction) -> None:
        """Find the parts anew where elements have begun or ceased to conduct, or nodes to hold fluid. Collective."""
        operators, before = self.model.operators, self._conducts
        size, holds = beside(operators, conduction.conductance), holding(operators, conduction.compression)
        now, firm = (conduction.conductance > least * size for least in (CONDUCTS, FIRM))
        is_firm = self._firm is not None and np.array_equal(self._firm[0], firm)
        same = before is not None and np.array_equal(before, now), is_firm, np.array_equal(self._holds, holds)
        conduct, is_firm, hold = (operators.layout.comm.allreduce(each, op=MPI.LAND) for each in same)
        if conduct and is_firm and hold:
            return
        self._forget()
        self.version += 1
        self._conducts, self._holds = now, holds
        if not conduct or not is_firm:
            self._free_parts()
            self._parts = NetworkComponents(operators, now)
            is_one = operators.layout.comm.allreduce(np.array_equal(now, firm), op=MPI.LAND)
            self._firm = firm, self._parts if is_one else NetworkComponents(operators, firm)

    @property
    def _firm_parts(self) -> NetworkComponents:
        assert self._firm is not None
        return self._firm[1]

    def log_changes(self, time: float) -> None:
        """Log elements that have begun or ceased to conduct since the last time, and undrained components. Collective."""
        before, now = self._logged, self._conducts
        if now is None or self._parts is None:
            return
        parts = self._parts
        self._logged = now
        if before is not None:
            if self.model.operators.layout.comm.allreduce(np.array_equal(before, now), op=MPI.LAND):
                return
            pinched, opened = _names(self.model, before & ~now), _names(self.model, now & ~before)
            found = (pinched, "pinched shut"), (opened, "conducts again")
            what = [f"{names} {word}" for names, word in found if names]
            self.log(note(f"time {time:.6g}: {'; '.join(what)}; the network has {parts.count} parts"))
        cut_off = ~parts.any_of(self._drained(self.model.loads))
        gives = change_volume(self.model.operators, parts, self.model.loads.held)
        fluid = self.model.scene.fluid
        stores = fluid is not None and fluid.compressibility > 0.0
        largest, count = parts.listed(cut_off, MOST_NAMED)
        for part in parts.named(largest):
            moves = parts.at_root(gives, part)
            by = "by its walls" if moves else "by compression" if stores else "by nothing: its mean pressure stays"
            both = " and by compression" if moves and stores else ""
            line = f"time {time:.6g}: no pressure is prescribed in {part}, whose level is settled {by}{both}"
            self.log(note(line) if moves or stores else marked(line))
        if count > MOST_NAMED:
            self.log(note(f"time {time:.6g}: nor in {count - MOST_NAMED} more parts"))

    @property
    def _first(self) -> int:
        """Number of this rank's first flow node."""
        layout = self.model.operators.layout
        return int(layout.flow_starts[layout.comm.rank])

    def _sum(self, values: Floats, part: NetworkComponent) -> float:
        """Of values (q,) at this rank's flow nodes, over those of a component on all ranks. Collective."""
        return float(self.model.operators.layout.comm.allreduce(float(values[part.nodes - self._first].sum())))

    def _drained(self, loads: Loads) -> Bools:
        """Whether something settles the pressure of each flow node (q,) of this rank."""
        drained = self._leaves.copy()
        drained[loads.given_pressures] = True
        return drained

    def _make(self, loads: Loads, stores: bool, at_start: bool) -> _Closed:
        operators, fluid = self.model.operators, self.model.scene.fluid
        assert fluid is not None
        assert self._parts is not None
        parts, drained = self._parts, self._drained(loads)
        gives = change_volume(operators, parts, loads.held)
        if stores and not at_start:  # a rate by a memory settles no pressure at an instant
            drained = drained | self._leaks_off
        holds = parts.any_of(self._holds) & (stores | (parts.sizes > 1))
        settled = parts.any_of(drained) | (stores & (holds | (gives & (not at_start))))
        roots = {pattern.well: parts.root_at(self._node(pattern.vector)) for pattern in loads.wells if pattern.well}
        closed, closures = list[tuple[NetworkComponent, tuple[str, ...], bool]](), []
        for part in parts.named(parts.listed(~settled)[0]):
            wells, moves = tuple(name for name, root in roots.items() if root == part.root), parts.at_root(gives, part)
            closed.append((part, wells, moves))
            closures.append(close(operators, parts, part, moves and not at_start, parts.at_root(holds, part)))
        closes = replace(loads, closures=tuple(closures)) if closed else loads
        if not stores or at_start:
            nothing = np.zeros(len(gives))
            return _Closed(closes, tuple(closed), gives, nothing > 0.0, nothing, False)
        firm, at_nodes = self._firm_parts, settled[parts.own]
        gives = gives if firm is parts else change_volume(operators, firm, loads.held)
        has = gives | firm.any_of(self._holds)
        by_storage, given = has & firm.any_of(at_nodes) & ~firm.any_of(drained), self._given(loads) * has
        is_any = operators.layout.comm.allreduce(bool(by_storage.any() or given.any()), op=MPI.LOR)
        return _Closed(closes, tuple(closed), gives, by_storage, given, is_any)

    def _given(self, loads: Loads) -> Floats:
        """Prescribed pressures in each firm part (k,). Collective."""
        parts = self._firm_parts
        return parts.summed(np.bincount(parts.own[np.unique(loads.given_pressures)], minlength=len(parts.roots)))

    def _node(self, vector: PETSc.Vec) -> int:
        local = vector.getArray(readonly=True)
        here = np.flatnonzero(local) + vector.getOwnershipRange()[0]
        return int(np.concatenate(self.model.operators.layout.comm.allgather(here))[0])

    def _refuse(
        self, part: NetworkComponent, wells: tuple[str, ...], rates: list[float], moves: bool, time: float
    ) -> None:
        why = "in a steady stage its walls store nothing" if moves else "its walls cannot move"
        other = 'use kind = "quasi-static", whose walls store the fluid' if moves else "give fluid.compressibility"
        raise SolveError(
            f"time {time:.6g}: {self._sum_of(wells, rates)} in {part}, which no pressure drains, and {why}: give a [[well]]"
            f" with a pressure there, let the flow rates add up to zero, or {other}"
        )

    def _sum_of(self, wells: tuple[str, ...], rates: list[float]) -> str:
        """Rates of wells and, last, of all terms, in words."""
        flow = self.model.operators.flow
        names = (*wells, *(term.name for term in flow.terms)) if flow is not None and rates[-1] else wells
        return f"flow rates of {', '.join(names)} add up to {sum(rates):.6g}{self._unit}"

    @property
    def _unit(self) -> str:
        return self.model.scene.unit_system.behind(FLOW_RATE)

    def _lost(self, conduction: Conduction | None) -> Floats:
        """Rates by which fluid leaves by terms at this rank's flow nodes (q,) [volume rate per thickness]. Collective."""
        layout, network = self.model.operators.layout, self.model.operators.flow
        assert network is not None
        leaving = conduction.leaving if conduction is not None else None
        return np.zeros(layout.flow_count) if leaving is None else network.at_nodes(leaving.rate)

    def destroy(self) -> None:
        """Free the closed loads and the components. Collective."""
        self._forget()
        self._free_parts()
        self._conducts = None

    def _free_parts(self) -> None:
        firm = None if self._firm is None or self._firm[1] is self._parts else self._firm[1]
        destroy(self._parts, firm)
        self._parts = self._firm = None

    def _forget(self) -> None:
        destroy(*(found.loads.summed for found in self._summed.values()))
        for kept in (self._closed, self._summed, self._little):
            kept.clear()


def _swept(problem: StepProblem) -> tuple[Floats, float]:
    """Volume that the walls have opened in a step at this rank's flow nodes (q,), and their largest motion. Collective."""
    network, fluid = problem.operators.flow, problem.fluid_before
    assert network is not None
    opened = None if fluid is None else -fluid.weight / network.compressibility
    here = network.swept(problem.increment) if opened is None else network.at_nodes(opened)
    moved = float(problem.increment.norm(PETSc.NormType.INFINITY))
    return here, moved


def _names(model: Model, chosen: np.ndarray) -> str:
    """Fractures, over all ranks, that have one of the chosen elements (j,). Collective."""
    joints = model.operators.blocks.joints
    here = {joints.fractures[f] for f in joints.fracture[chosen]}
    return ", ".join(sorted(set().union(*model.operators.layout.comm.allgather(here))))
