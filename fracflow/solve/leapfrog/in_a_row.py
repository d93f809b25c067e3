"""Explicit steps in a row by ``steps.c``, without a call of Python between them, where all that acts has compiled loops.

That is rock on one rank, joints whose law has a compiled answer, sides of dashpots, and one term that damps. Where a step needs
the laws themselves, the loops stop before it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fracflow.integrators.explicit import joint_share
from fracflow.laws.compiled import Answers
from fracflow.mesh.data import Floats
from fracflow.model.state import Sections
from fracflow.solve.leapfrog.compiled import address, library
from fracflow.solve.leapfrog.guess import JointGuess
from fracflow.solve.leapfrog.joint_nodes import JointNodes
from fracflow.solve.leapfrog.nodes import Nodes

_LONG, _REAL, _ARRAY = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
_PAIR = _ARRAY * 2


def _all(names: str, kind: type) -> list[tuple[str, type]]:
    return [(name, kind) for name in names.split()]


class Given(ctypes.Structure):
    """``steps`` of ``steps.c``, name by name."""

    _fields_ = [
        *_all("sections every forced pushed own both ranges batches terms damped", _LONG),
        *_all("is_coupled has_path most most_changes", _LONG),
        *_all("dt share most_pressed", _REAL),
        *_all("node top of_three of_four oblique triangles quads quiet rock_three rock_four", _ARRAY),
        *_all("moduli x inverse e u v f", _ARRAY),
        *_all("starts at to entries weights inverse_pushed of_pushed places places_forced places_pushed", _ARRAY),
        *_all("moved free sizes force added scratch forces base", _ARRAY),
        *_all("accelerations", _PAIR),
        *_all("laws before found shapes rows compliance", _ARRAY),
        *_all("strain values record blur", _PAIR),
        *_all("friction", _ARRAY),
        *_all("statuses", _PAIR),
        *_all("at_own places_own shared inverse_own dashpots resisting u_own a_own a_rock", _ARRAY),
        *_all("damping_starts damping_columns damping", _ARRAY),
        *_all("damped_forces", _PAIR),
        *_all("of_joints", _ARRAY),
        *_all("scheme of_damping", _REAL),
        *_all("of_terms", _ARRAY),
        *_all("energy iterations left", _REAL),
    ]


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

    def __init__(self, nodes: Nodes, given: Mapping[str, int]) -> None:
        """Keep the addresses of all that stays."""
        self.nodes, joints = nodes, nodes.operators.joints
        self._friction = joints.copy_of_law if len(joints.weights) else None
        self._dt = np.nan
        sections, every, pushed, own = len(joints.weights), len(nodes.every), len(nodes.pushed), len(nodes.own)
        shared = np.stack([nodes.pushed_own, nodes.own_pushed], axis=1)
        counts = {"own": own, "both": len(shared), "terms": len(nodes.dashpots)}
        self._arrays: dict[str, np.ndarray] = {
            name: np.zeros(size)
            for name, size in {
                "moved": every, "free": 2 * sections, "sizes": 2 * sections, "force": pushed, "added": pushed,
                "scratch": pushed, "forces": len(nodes.places_forced), "u_own": own, "a_own": own,
            }.items()
        }  # fmt: skip
        for name, numbers in {"at_own": nodes.at_own, "places_own": nodes.places_own, "shared": shared}.items():
            self._arrays[name] = np.ascontiguousarray(numbers, np.int64)
        self._blocks = [np.ascontiguousarray(each.blocks[0]) for each in nodes.dashpots.values()]
        self._arrays["dashpots"] = np.array([*map(address, self._blocks)], np.int64)
        self._given = Given(**given, **counts, **{name: address(each) for name, each in self._arrays.items()})

    def take(self, held: Held, base: Floats, dt: float, count: int) -> Row | None:
        """Up to ``count`` steps of length dt, the last of them up to an instant; None where the first needs the laws.

        base  (m,) forces that stay, on those of ``Nodes.every`` on which others act [force per thickness]
        """
        given, nodes, loops = self._given, self.nodes, library()
        assert loops is not None
        given.most_pressed = self._most_pressed(held.sections)
        given.dt, given.share = dt, joint_share(dt)
        inverse = nodes.inverse_with_dashpots(dt).blocks[0]
        before, sections, friction = self._answers(held.sections), held.sections, held.friction.copy()
        after = self._friction.empty() if self._friction is not None else before
        pairs: dict[str, tuple[Floats, Floats]] = {
            "values": (before.values, after.values),
            "strain": _and_new(sections.strain),
            "record": _and_new(sections.record),
            "blur": _and_new(sections.blur),
            "accelerations": _and_new(held.acceleration),
            "damped_forces": next(map(_and_new, held.damped.values()), (base, base)),
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
        done = int(loops.fracflow_steps(ctypes.addressof(given), count, 1))
        if not done:
            return None
        last = {name: pair[done % 2] for name, pair in pairs.items()}
        if self._friction is not None:
            response = self._friction.response(Answers(last["values"], (before, after)[done % 2].statuses))
            found = nodes.operators.joints.answered(last["strain"], response)
            sections = replace(found, record=last["record"], blur=last["blur"])
        damped = dict.fromkeys(held.damped, last["damped_forces"])
        taken = dict(zip(resisting, of_terms.tolist(), strict=True))
        for name in damped:
            taken[name] = taken.get(name, 0.0) + given.of_damping
        new = Held(sections, friction, last["accelerations"], resisting, damped)
        return Row(done, new, given.energy, given.scheme, taken, joints, round(given.iterations), given.left)

    def _answers(self, sections: Sections) -> Answers:
        if self._friction is None:
            return Answers(np.zeros(0), np.zeros((2, 0), dtype=bool))
        known = sections.traction, sections.tangent, sections.inelastic, sections.stored
        return self._friction.answers(*known, sections.history[0])

    def _most_pressed(self, sections: Sections) -> float:
        """Up to which compression no strength falls so fast that a section jumps, as far as that is known [stress]."""
        if self._friction is None:
            return np.inf
        law, present = self.nodes.operators.joints.laws[0].law, -float(sections.traction[:, 1].min(initial=0.0))
        bounds = (np.inf, 2.0 * present, 1.1 * present)
        return next((each for each in bounds if law.most_steepness(each) < 1.0), -np.inf)


def steps_in_a_row(nodes: Nodes, passes: JointNodes, guess: JointGuess | None) -> StepsInARow | None:
    """The loops; None where something acts that they do not have."""
    parts = [nodes.rock.given(), passes.given(), *(each.given() for each in nodes.damping.values())]
    if len(nodes.operators.joints.weights):
        parts.append(None if guess is None else guess.given())
    others = nodes.operators.flow is not None or nodes.changing.is_any or len(nodes.held) > 0 or len(nodes.damping) > 1
    known = [each for each in parts if each is not None]
    if others or nodes.waves or nodes.springs or len(known) < len(parts):
        return None
    return StepsInARow(nodes, {name: value for each in known for name, value in each.items()})


def _and_new(values: Floats) -> tuple[Floats, Floats]:
    """A copy of values (...), and as many: steps write into one and the other in turn."""
    return np.array(values, float, order="C"), np.empty(values.shape)
