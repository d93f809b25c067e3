"""Explicit steps in a row by ``steps.c``, without a call of Python between them, where all that acts has compiled loops.

That is plain rock, joints whose law has a compiled answer, sides of dashpots, and one term that damps. Where a step needs the
laws themselves, the loops stop before it. On several ranks a step is a few calls, between which values travel.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.integrators.explicit import joint_share
from fracflow.laws.compiled import Answers
from fracflow.mesh.data import Floats
from fracflow.model.state import Sections
from fracflow.solve.leapfrog.compiled import address, library, members_of_steps, steps_struct
from fracflow.solve.leapfrog.guess import JointGuess
from fracflow.solve.leapfrog.joint_nodes import JointNodes
from fracflow.solve.leapfrog.nodes import Nodes
from fracflow.solve.leapfrog.on_ranks import Beyond, beyond
from fracflow.solve.leapfrog.rock import Cells

MOST_AT_ONCE = 1e7  # unknowns times steps between two looks at signals: .1 to .4 s
_JOINTS, _FORCES, _FIRST_HALF, _LATE_CELLS, _SECOND_HALF, _END = range(6)  # as in steps.c
OF_A_ROW = {
    "most_pressed", "dt", "share", "base", "inverse_own", "friction", "of_terms", "of_joints", "resisting", "values", "strain",
    "record", "blur", "accelerations", "damped_forces", "statuses", "scheme", "of_damping", "energy", "iterations", "left",
}  # fmt: skip
"""Members of ``steps`` that each row sets anew."""
COLUMNS = (0, 2, 6, 8, 9, 10, 11, 12, 13, 14, 15)  # first ones of the parts of an answer, as in response.h


class Held(NamedTuple):
    """Values at the end of a step that the next one begins with.

    sections      of all joints, and the work of friction (s,) there [energy/area]
    acceleration  (p,) at ``Nodes.pushed`` [length/time^2]
    resisting     (o,) forces of dashpots at ``Nodes.own``, by terms, and ``damped`` (n,) of what damps [force per thickness]
    """

    sections: Sections
    friction: Floats
    acceleration: Floats
    resisting: Mapping[str, Floats]
    damped: Mapping[str, Floats]


class Row(NamedTuple):
    """Steps that were taken, how many, and their sums.

    energy          strain energy of the rock at the last one;  ``scheme``, ``taken`` and ``joints`` as of ``steps.BalanceSums``
    iterations      of joints, and the most that was left of their motion, over the largest
    """

    done: int
    held: Held
    energy: float
    scheme: float
    taken: Mapping[str, float]
    joints: Floats
    iterations: int
    left: float


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
        self._arrays: dict[str, np.ndarray] = {
            name: np.zeros(size)
            for name, size in {
                "moved": every, "free": 2 * sections, "sizes": 2 * sections, "force": pushed, "added": pushed,
                "scratch": pushed, "forces": every, "u_own": own, "a_own": own,
            }.items()
        }  # fmt: skip
        self._arrays["agreed"] = self._agreed
        for name, numbers in {"at_own": nodes.at_own, "places_own": nodes.places_own, "shared": shared}.items():
            self._arrays[name] = np.ascontiguousarray(numbers, np.int64)
        self._blocks = [np.ascontiguousarray(each.blocks[0]) for each in nodes.dashpots.values()]
        self._arrays["dashpots"] = np.array([*map(address, self._blocks)], np.int64)
        values = {**given, **counts, **{name: address(each) for name, each in self._arrays.items()}}
        self.given = values.keys()
        if wrong := (self.given | OF_A_ROW) - members_of_steps():
            raise AssertionError(f"steps.c lacks {', '.join(sorted(wrong))}")
        self._given: Any = steps_struct()(**values)
        self._at_once = max(1, round(MOST_AT_ONCE / max(1, nodes.operators.layout.solid_count)))

    def take(self, held: Held, base: Floats, dt: float, count: int) -> Row | None:
        """Up to ``count`` steps of length dt, the last of them up to an instant; None where the first needs laws. Collective.

        base  (m,) forces that stay, on those of ``Nodes.every`` on which others act [force per thickness]
        """
        given, nodes, loops = self._given, self.nodes, library()
        assert loops is not None
        given.most_pressed = self._most_pressed(held.sections)
        if self._is_refused(given.most_pressed):
            return None
        given.dt, given.share = dt, joint_share(dt)
        inverse = nodes.inverse_with_dashpots(dt).blocks[0]
        (strain, before), sections, friction = self._all_sections(held.sections), held.sections, held.friction.copy()
        after = Answers(np.empty_like(before.values), np.empty_like(before.statuses))
        damped_forces = (np.zeros(self._places), np.zeros(self._places))
        for damped_before in held.damped.values():
            damped_forces[0][: len(damped_before)] = damped_before
        pairs: dict[str, tuple[Floats, Floats]] = {
            "values": (before.values, after.values),
            "strain": _and_new(strain),
            "record": _and_new(sections.record),
            "blur": _and_new(sections.blur),
            "accelerations": _and_new(held.acceleration),
            "damped_forces": damped_forces,
        }
        resisting = {name: held.resisting[name].copy() for name in nodes.dashpots}
        of_terms, joints = np.zeros(len(resisting)), np.zeros(5)
        addresses = np.array([*map(address, resisting.values())], np.int64)
        singles = {"base": base, "inverse_own": inverse, "friction": friction, "of_terms": of_terms}
        for name, values in (singles | {"of_joints": joints, "resisting": addresses}).items():
            setattr(given, name, address(values))
        for name, pair in (pairs | {"statuses": (before.statuses, after.statuses)}).items():
            getattr(given, name)[:] = [*map(address, pair)]
        given.scheme = given.of_damping = given.energy = given.iterations = given.left = 0.0
        at = ctypes.addressof(given)
        done = self._steps(at, count) if self._others is None else self._pieces(at, count, self._others)
        if not done:
            return None
        last = {name: pairs[name][done % 2] for name in pairs}
        if self._friction is not None:
            response = self._friction.response(self._own((before, after)[done % 2]))
            found = nodes.operators.joints.answered(last["strain"][: self._count].copy(), response)
            sections = replace(found, record=last["record"], blur=last["blur"])
        damped = {name: last["damped_forces"][: len(values)].copy() for name, values in held.damped.items()}
        taken = dict(zip(resisting, of_terms.tolist(), strict=True))
        for name in damped:
            taken[name] = taken.get(name, 0.0) + given.of_damping
        new = Held(sections, friction, last["accelerations"], resisting, damped)
        return Row(done, new, given.energy, given.scheme, taken, joints, round(given.iterations), given.left)

    def _steps(self, given: int, count: int) -> int:
        """Steps on one rank, by calls that are short enough for a signal to be met between them."""
        loops, done = library(), 0
        assert loops is not None
        while done < count:
            some = min(self._at_once, count - done)
            taken = int(loops.fracflow_steps(given, some, done + some == count))
            done += taken
            if taken < some:
                break
        return done

    def _pieces(self, given: int, count: int, others: Beyond) -> int:
        """Steps on several ranks, as many on each. Collective."""
        loops, comm, rock = library(), self.nodes.operators.layout.comm, self.nodes.rock
        assert loops is not None and isinstance(rock, Cells) and rock.way is not None
        piece, way, speeds = loops.fracflow_piece, rock.way, others.way
        for done in range(count):
            is_last = done == count - 1
            speeds.begin()
            speeds.end()
            piece(given, _JOINTS, is_last)
            comm.Allreduce(MPI.IN_PLACE, self._agreed, op=MPI.MAX)
            if self._agreed[0] > 0.0:
                return done
            piece(given, _FORCES, is_last)
            way.begin()
            piece(given, _FIRST_HALF, is_last)
            way.end()
            piece(given, _LATE_CELLS, is_last)
            way.begin_back()
            piece(given, _SECOND_HALF, is_last)
            way.end_back()
            piece(given, _END, is_last)
        return count

    def _all_sections(self, sections: Sections) -> tuple[Floats, Answers]:
        """Strains and answers of this rank's sections, and those of others behind them. Collective."""
        answers, count = Answers(np.zeros(0), np.zeros((2, 0), dtype=bool)), self._count
        if self._friction is not None:
            known = sections.traction, sections.tangent, sections.inelastic, sections.stored
            answers = self._friction.answers(*known, sections.history[0])
        if self._others is None:
            return sections.strain, answers
        own = np.hstack([sections.strain, *_parts(answers.values, count)])
        rows = np.vstack([own, self._others.sections.there(own)])
        values = np.concatenate([rows[:, 2 + first : 2 + last].ravel() for first, last in pairwise(COLUMNS)])
        return rows[:, :2], Answers(values, np.zeros((2, len(rows)), dtype=bool))

    def _own(self, answers: Answers) -> Answers:
        """Those of this rank's sections."""
        if self._others is None:
            return answers
        parts, count = _parts(answers.values, self._others.count), self._count
        values = np.concatenate([part[:count].ravel() for part in parts])
        return Answers(values, answers.statuses[:, :count].copy())

    def destroy(self) -> None:
        """Free the ways between ranks. Collective."""
        if self._others is not None:
            self._others.destroy()

    def _is_refused(self, most_pressed: float) -> bool:
        """Whether no compression is known on any rank at which no section jumps. Collective."""
        is_here = most_pressed == -np.inf
        return (
            is_here if self._others is None else bool(self.nodes.operators.layout.comm.allreduce(is_here, op=MPI.LOR))
        )

    def _most_pressed(self, sections: Sections) -> float:
        """Up to which compression no strength falls so fast that a section jumps, as far as that is known [stress].

        -inf where none is known, as of tractions that are no numbers.
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
    others = nodes.operators.flow is not None or nodes.changing.is_any or len(nodes.held) > 0 or len(damping) > 1
    others = bool(others or nodes.waves or nodes.springs)
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


def _parts(values: Floats, count: int) -> list[Floats]:
    """Answers of so many sections, by their columns: (n, k) each."""
    return [values[count * first : count * last].reshape(count, last - first) for first, last in pairwise(COLUMNS)]


def _and_new(values: Floats) -> tuple[Floats, Floats]:
    """A copy of values (...), and as many: steps write into one and the other in turn."""
    return np.array(values, float, order="C"), np.empty(values.shape)
