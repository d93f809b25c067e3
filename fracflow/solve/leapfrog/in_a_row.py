"""Explicit steps in a row by ``steps.c``, without a call of Python between them, where all that acts has compiled loops.

They have plain rock, joints whose law has a compiled answer, and one term that damps. Dashpots, waves that come in at these,
supports, and loads that change may act. Where a step needs the laws themselves, the loops stop before it. On several ranks a
step is a few calls, between which values travel.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc
from fracflow.integrators.explicit import joint_share
from fracflow.laws.compiled import Answers, in_parts, parts_of_answer
from fracflow.mesh.data import Floats
from fracflow.model.state import Sections
from fracflow.solve.leapfrog.ahead import MOST_KEPT, StepsAhead, SupportsAt, is_tabled, loads_at, supports_at, waves_at
from fracflow.solve.leapfrog.compiled import address, library, members_of_steps, pieces_of_step, steps_struct
from fracflow.solve.leapfrog.guess import JointGuess
from fracflow.solve.leapfrog.joint_nodes import JointNodes
from fracflow.solve.leapfrog.nodes import Nodes
from fracflow.solve.leapfrog.on_ranks import Beyond, beyond
from fracflow.solve.leapfrog.rock import Cells

MOST_AT_ONCE = 1e7  # unknowns times steps between two looks at signals: .1 to .4 s
OF_A_ROW = {
    "most_pressed", "dt", "share", "base", "inverse_own", "friction", "of_terms", "of_joints", "resisting", "values", "strain",
    "record", "blur", "accelerations", "damped_forces", "statuses", "scheme", "boundaries", "of_damping", "energy", "left",
    "iterations", "row", "damping_waits", "loads", "held_at", "held_speed", "held_acceleration", "support", "incoming",
}  # fmt: skip
"""Members of ``steps`` that each row sets anew."""


class Held(NamedTuple):
    """Values at the end of a step that the next one begins with.

    sections      of all joints, and the work of friction (s,) there [energy/area]
    acceleration  (p,) at ``Nodes.pushed`` [length/time^2]
    resisting     (o,) forces of dashpots at ``Nodes.own``, by terms, and ``damped`` (n,) of what damps [force per thickness]
    load          (m,) at ``Nodes.changing``, and ``support`` (h,) forces of supports [force per thickness]
    supports      how these move;  ``powers`` of waves, by terms [energy/time per thickness]
    damping_waits  for the first section that slides or opens: the loops leave that step to others
    """

    sections: Sections
    friction: Floats
    acceleration: Floats
    resisting: Mapping[str, Floats]
    damped: Mapping[str, Floats]
    load: Floats
    support: Floats
    supports: SupportsAt
    powers: Mapping[str, float]
    damping_waits: bool


class Row(NamedTuple):
    """Steps that were taken, how many, and their sums.

    energy          strain energy of the rock at the last one;  others are as of ``steps.BalanceSums``
    iterations      of joints, and the most that was left of their motion, over the largest
    """

    done: int
    held: Held
    energy: float
    scheme: float
    boundaries: float
    taken: Mapping[str, float]
    brought: Mapping[str, float]
    joints: Floats
    iterations: int
    left: float


class _Arrays(NamedTuple):
    """Arrays of one row, alive as long as it is taken.

    pairs      those before a step and after it, by their names in ``steps.c``: they change places;  ``answers`` likewise
    resisting  (o,) forces of dashpots, by terms
    singles    those that stay where they are, by their names
    """

    pairs: Mapping[str, tuple[Floats, Floats]]
    answers: tuple[Answers, Answers]
    resisting: Mapping[str, Floats]
    singles: Mapping[str, NDArray[Any]]


class _Outer(NamedTuple):
    """Loads (m,), supports and powers of waves at the last step that was taken, and what waves have brought, by terms."""

    load: Floats
    supports: SupportsAt
    powers: Mapping[str, float]
    brought: Mapping[str, float]


class StepsInARow:
    """The loops with their arrays."""

    def __init__(self, nodes: Nodes, given: Mapping[str, int], others: Beyond | None) -> None:
        """Keep the addresses of all that stays; ``others`` is what of other ranks is needed."""
        self.nodes, joints = nodes, nodes.operators.joints
        self._friction, self._others = joints.copy_of_law if len(joints.weights) else None, others
        self._count, own = len(joints.weights), len(nodes.own)
        sections, every, pushed = given["sections_all"], given["first_ghost"] + given["ghosts"], given["pushed_all"]
        self._places, self._agreed = every, np.zeros(4)
        shared = np.stack([nodes.pushed_own, nodes.own_pushed], axis=1)
        counts = {"own": own, "both": len(shared), "terms": len(nodes.dashpots)}
        counts |= {"loaded": len(nodes.at_loads), "held": len(nodes.held), "waves": len(nodes.waves)}
        self._arrays: dict[str, np.ndarray] = {
            name: np.zeros(size)
            for name, size in {
                "free": 2 * sections, "sizes": 2 * sections, "force": pushed, "added": pushed,
                "scratch": pushed, "forces": every, "u_own": own, "a_own": own,
            }.items()
        }  # fmt: skip
        self._arrays["moved"] = np.zeros(every) if others is None else others.moved
        self._arrays |= {
            "agreed": self._agreed,
            "mass_own": nodes.mass[nodes.own],
            "prestress": nodes.prestress[nodes.places[nodes.at_loads]],
        }
        held_of_own = np.full(own, -1)
        held_of_own[nodes.held_of_own] = np.arange(len(nodes.held))
        numbers = {
            "at_own": nodes.at_own, "places_own": nodes.places_own, "shared": shared, "at_loads": nodes.at_loads,
            "by_loads": nodes.by_loads, "at_held": nodes.at_held, "places_held": nodes.places[nodes.at_held],
            "held_of_own": held_of_own,
        }  # fmt: skip
        self._arrays |= {name: np.ascontiguousarray(each, np.int64) for name, each in numbers.items()}
        self._blocks = [np.ascontiguousarray(each.blocks[0]) for each in nodes.dashpots.values()]
        self._arrays["dashpots"] = np.array([*map(address, self._blocks)], np.int64)
        values = {**given, **counts, **{name: address(each) for name, each in self._arrays.items()}}
        self.given = values.keys()
        if wrong := (self.given | OF_A_ROW) - members_of_steps():
            raise AssertionError(f"steps.c lacks {', '.join(sorted(wrong))}")
        self._given: Any = steps_struct()(**values)
        widest = max(len(nodes.at_loads), len(nodes.held), own * len(nodes.dashpots) if nodes.waves else 0, 1)
        some = min(MOST_AT_ONCE / max(1, nodes.operators.layout.solid_count), MOST_KEPT / widest)
        self._at_once = max(
            1, round(some if others is None else nodes.operators.layout.comm.allreduce(some, op=MPI.MIN))
        )
        self._some = self._at_once  # that the next tables are for

    def take(self, held: Held, base: Floats, beside: Floats, ahead: StepsAhead) -> Row | None:
        """Some of the steps ahead, the last of all up to an instant; None where the first needs laws. Collective.

        base    (m,) forces that stay, on those of ``Nodes.every`` on which others act [force per thickness]
        beside  (l,) loads that stay where others change [force per thickness]
        """
        if self._is_refused(held.sections):
            return None
        arrays = self._begin(held, base, ahead.dt)
        done, outer = self._go_on(held, beside, ahead)
        return self._row(held, arrays, done, outer) if done else None

    def _begin(self, held: Held, base: Floats, dt: float) -> _Arrays:
        """Give the loops what a row begins with. Collective."""
        given, nodes, sections = self._given, self.nodes, held.sections
        given.dt, given.share, given.damping_waits = dt, joint_share(dt), held.damping_waits
        strain, before = self._all_sections(sections)
        answers = before, Answers(np.empty_like(before.values), np.empty_like(before.statuses))
        damped_forces = (np.zeros(self._places), np.zeros(self._places))
        for damped_before in held.damped.values():
            damped_forces[0][: len(damped_before)] = damped_before
        pairs: dict[str, tuple[Floats, Floats]] = {
            "strain": _and_new(strain),
            "record": _and_new(sections.record),
            "blur": _and_new(sections.blur),
            "accelerations": _and_new(held.acceleration),
            "damped_forces": damped_forces,
        }
        resisting = {name: held.resisting[name].copy() for name in nodes.dashpots}
        singles = {
            "friction": held.friction.copy(), "support": held.support.copy(), "of_terms": np.zeros(len(resisting)),
            "of_joints": np.zeros(5), "base": base, "inverse_own": nodes.inverse_with_dashpots(dt).blocks[0],
            "resisting": np.array([*map(address, resisting.values())], np.int64),
        }  # fmt: skip
        for name, values in singles.items():
            setattr(given, name, address(values))
        of_sections = zip(("values", "statuses"), zip(*answers, strict=True), strict=True)
        for name, pair in (*pairs.items(), *of_sections):
            getattr(given, name)[:] = [*map(address, pair)]
        given.scheme = given.boundaries = given.of_damping = given.energy = given.iterations = given.left = 0.0
        return _Arrays(pairs, answers, resisting, singles)

    def _go_on(self, held: Held, beside: Floats, ahead: StepsAhead) -> tuple[int, _Outer]:
        """Take steps, table by table, to the end or to one that needs laws; and how many. Collective."""
        nodes, done, load, supports = self.nodes, 0, held.load, held.supports
        powers, brought, taken, some = dict(held.powers), dict[str, float](), 0, 0
        while done < ahead.left and taken == some:
            some = min(self._some, ahead.left - done)
            tables = self._tables(
                load, supports, loads_at(nodes, beside, ahead, done, some), supports_at(nodes, ahead, done, some)
            )
            incoming, power = waves_at(nodes, ahead, done, some)
            self._given.incoming = address(incoming)
            taken = self._steps(some, done + some == ahead.left)
            done, load, supports = done + taken, tables[0][taken], SupportsAt(*(each[taken] for each in tables[1:]))
            for name, each in power.items():
                for now in each[:taken].tolist():
                    brought[name] = brought.get(name, 0.0) + 0.5 * ahead.dt * (powers.get(name, 0.0) + now)
                    powers[name] = now
            # tables of steps that are not taken are lost: after a refusal few at a time, as it may come again
            self._some = max(1, taken) if taken < some else min(2 * self._some, self._at_once)
        return done, _Outer(load, supports, powers, brought)

    def _row(self, held: Held, arrays: _Arrays, done: int, outer: _Outer) -> Row:
        """Values that the loops have left there after some steps."""
        given, sections, last = (
            self._given,
            held.sections,
            {name: pair[done % 2] for name, pair in arrays.pairs.items()},
        )
        if self._friction is not None:
            response = self._friction.response(self._own(arrays.answers[done % 2]))
            found = self.nodes.operators.joints.answered(last["strain"][: self._count].copy(), response)
            sections = replace(found, record=last["record"], blur=last["blur"])
        damped = {name: last["damped_forces"][: len(values)].copy() for name, values in held.damped.items()}
        of_terms, joints, friction, support = (
            arrays.singles[name] for name in ("of_terms", "of_joints", "friction", "support")
        )
        taken = dict(zip(arrays.resisting, of_terms.tolist(), strict=True))
        for name in damped:
            taken[name] = taken.get(name, 0.0) + given.of_damping
        ended = sections, friction, last["accelerations"], arrays.resisting, damped
        new = Held(*ended, outer.load, support, outer.supports, outer.powers, held.damping_waits)
        sums = given.energy, given.scheme, given.boundaries, taken, outer.brought, joints
        return Row(done, new, *sums, round(given.iterations), given.left)

    def _tables(self, load: Floats, supports: SupportsAt, loads: Floats, moving: SupportsAt) -> list[Floats]:
        """Tables whose first rows are the present load (m,) and supports; the loops begin there."""
        pairs = [(load, loads), *zip(supports, moving, strict=True)]
        tables = [np.vstack([now, then]) for now, then in pairs]
        for name, table in zip(("loads", "held_at", "held_speed", "held_acceleration"), tables, strict=True):
            setattr(self._given, name, address(table))
        self._given.row = 0
        return tables

    def _steps(self, some: int, end: bool) -> int:
        """Up to ``some`` steps, and how many: one that joints need the laws for is not begun. Collective."""
        loops, others, at = library(), self._others, ctypes.addressof(self._given)
        assert loops is not None
        if others is None:
            return int(loops.fracflow_steps(at, some, end))
        comm, rock = self.nodes.operators.layout.comm, self.nodes.rock
        assert isinstance(rock, Cells) and rock.way is not None
        way, travel = rock.way, dict[str, Callable[[], None]]()  # what goes between ranks before a piece
        travel["JOINTS"] = others.receive_motion
        travel["FORCES"] = lambda: comm.Allreduce(MPI.IN_PLACE, self._agreed, op=MPI.MAX)
        travel |= {"FIRST_HALF": way.begin, "LATE_CELLS": way.end}  # displacements of ghosts
        travel |= {"SECOND_HALF": way.begin_back, "END": way.end_back}  # forces on them
        for done in range(some):
            for number, name in enumerate(pieces_of_step()):
                if name in travel:
                    travel[name]()
                if name == "FORCES" and self._agreed[0] > 0.0:
                    return done
                loops.fracflow_piece(at, number, end and done == some - 1)
        return some

    def _all_sections(self, sections: Sections) -> tuple[Floats, Answers]:
        """Strains and answers of this rank's sections, and those of others behind them. Collective."""
        answers, count = Answers(np.zeros(0), np.zeros((2, 0), dtype=bool)), self._count
        if self._friction is not None:
            known = sections.traction, sections.tangent, sections.inelastic, sections.stored
            answers = self._friction.answers(*known, sections.history[0])
        if self._others is None:
            return sections.strain, answers
        own = np.hstack([sections.strain, *in_parts(answers.values, count).values()])
        rows = np.vstack([own, self._others.sections.there(own)])
        values = np.concatenate([rows[:, 2:][:, columns].ravel() for columns in parts_of_answer().values()])
        return rows[:, :2], Answers(values, np.zeros((2, len(rows)), dtype=bool))

    def _own(self, answers: Answers) -> Answers:
        """Those of this rank's sections."""
        if self._others is None:
            return answers
        parts, count = in_parts(answers.values, self._others.count), self._count
        values = np.concatenate([part[:count].ravel() for part in parts.values()])
        return Answers(values, answers.statuses[:, :count].copy())

    def destroy(self) -> None:
        """Free the ways between ranks. Collective."""
        if self._others is not None:
            self._others.destroy()

    def _is_refused(self, sections: Sections) -> bool:
        """Whether no compression is known on any rank at which no section jumps. Collective."""
        self._given.most_pressed = self._most_pressed(sections)
        is_here = self._given.most_pressed == -np.inf
        return (
            is_here if self._others is None else bool(self.nodes.operators.layout.comm.allreduce(is_here, op=MPI.LOR))
        )

    def _most_pressed(self, sections: Sections) -> float:
        """Up to which compression no strength falls so fast that a section jumps, as far as that is known [stress].

        -inf where none is known, as of tractions that are no numbers: the loops then take no step.
        """
        if self._friction is None:
            return np.inf
        law, present = self.nodes.operators.joints.laws[0].law, -float(sections.traction[:, 1].min(initial=0.0))
        bounds = (np.inf, 2.0 * present, 1.1 * present)
        return next((each for each in bounds if law.most_steepness(each) < 1.0), -np.inf)


def steps_in_a_row(
    nodes: Nodes, passes: JointNodes, guess: JointGuess | None, damping: list[PETSc.Mat]
) -> StepsInARow | None:
    """The loops; None where something acts that they do not have. ``damping`` are matrices of what damps. Collective."""
    others = nodes.operators.flow is not None or not is_tabled(nodes) or len(damping) > 1
    others = bool(others or nodes.springs)
    if nodes.operators.layout.comm.size > 1:
        found = beyond(nodes, guess, damping, others)
        return None if found is None else StepsInARow(nodes, found.given, found)
    parts = [nodes.rock.given(), passes.given(), *(each.given() for each in nodes.damping.values())]
    if len(nodes.operators.joints.weights):
        parts.append(None if guess is None else guess.given())
    known = [each for each in parts if each is not None]
    if others or len(known) < len(parts):
        return None
    given = {name: value for each in known for name, value in each.items()}
    given |= {
        "sections_all": given["sections"],
        "pushed_all": given["pushed"],
        "first_ghost": given["every"],
        "ghosts": 0,
    }
    return StepsInARow(nodes, given, None)


def _and_new(values: Floats) -> tuple[Floats, Floats]:
    """A copy of values (...), and as many: steps write into one and the other in turn."""
    return np.array(values, float, order="C"), np.empty(values.shape)
