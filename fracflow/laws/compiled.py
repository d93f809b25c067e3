"""Laws of friction in the plane by one compiled loop over sections, ``friction.c``.

The laws are at home in their own files; the loop is a copy of them and has their bits. Only stored energies may differ in the
last one, since their logarithm is the C library's. Setting up makes the loop where there is a compiler, else the laws serve.
Their evaluation is some hundred calls of NumPy.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fracflow.laws.base import Bools, Floats, History, JointLaw, JointResponse, LawStep, per_section

VERSION = 1  # of the function's arguments, as in friction.c
_INT, _ARRAY = ctypes.c_int32, ctypes.c_void_p
PARAMETERS = {
    "normal_stiffness": 1.0, "shear_stiffness": 1.0, "aperture": 1.0, "initial_normal_traction": 0.0,
    "initial_shear_traction": 0.0, "cohesion": 0.0, "friction_coefficient": 0.0, "dynamic_friction_coefficient": 0.0,
    "slip_weakening_distance": 1.0, "stick_slip_ratio": 1.0, "strength_when_open": 0.0,
}  # fmt: skip
"""Columns of a law behind its number and the weight of its section, and their values where the law has none of that name."""
OF_FRICTION = (1, 2)  # numbers of copies that the loop has


class Evaluates(Protocol):
    """A law, or what stands for one."""

    def evaluate(self, strain: Floats, history: History, step: LawStep) -> JointResponse:
        """As ``JointLaw.evaluate``: the response to strains (n, dim) after ``history``."""
        ...


@cache
def library() -> ctypes.CDLL | None:
    """The function; None where it was not compiled, or is that of another version."""
    for path in sorted(Path(__file__).parent.glob("_friction*.so")):
        try:
            found = ctypes.CDLL(str(path))
            if ctypes.c_int.in_dll(found, "fracflow_laws_version").value == VERSION:
                found.fracflow_friction.restype = None
                found.fracflow_friction.argtypes = (*[_INT] * 3, *[_ARRAY] * 7)
                return found
        except (OSError, ValueError, AttributeError):
            continue
    return None


def number_of(law: JointLaw) -> int | None:
    """The number of the copy that a law has by itself, not by what it inherits."""
    found: int | None = vars(type(law)).get("compiled")
    return found


def table(law: JointLaw, weights: Floats) -> Floats:
    """Number of the law, weights (n,) and parameters (n, 13) of sections."""
    rows = np.zeros((len(weights), 2 + len(PARAMETERS)))
    rows[:, 0], rows[:, 1] = number_of(law), weights
    for column, (name, none) in enumerate(PARAMETERS.items(), start=2):
        rows[:, column] = per_section(np.ravel(getattr(law, name, none)), len(weights))
    return rows


class Answers(NamedTuple):
    """Values (15 n,) and statuses (2, n) of sections, in the order of ``response.h``."""

    values: Floats
    statuses: Bools


class CompiledFriction:
    """A law of friction for as many sections as it is made for."""

    def __init__(self, law: JointLaw, sections: int) -> None:
        """Bring its parameters into a table."""
        self._rows = table(law, np.zeros(sections))
        self.is_coupled, self.has_path = bool(getattr(law, "coupled_tangent", True)), "slip_path" in law.history
        self._names = ("plastic_slip", "sliding", *["slip_path"][: self.has_path])
        compiled = library()
        assert compiled is not None
        self._loop = compiled.fracflow_friction
        self._of_laws = self._rows.ctypes.data

    def evaluate(self, strain: Floats, history: History, step: LawStep) -> JointResponse:
        """The law's own response to strains (n, 2) after ``history``. Raises ValueError for others than its n sections."""
        n = len(strain)
        if n != len(self._rows):
            raise ValueError(f"{n} strains for {len(self._rows)} sections")
        answers = self.empty()
        given = [np.ascontiguousarray(each, dtype=float) for each in (strain, *self.past(history))]
        arrays = [*map(_address, given), None][:4]
        self._loop(n, step.hold, self.is_coupled, self._of_laws, *arrays, *map(_address, answers))
        return self.response(answers)

    def past(self, history: History) -> list[Floats]:
        """Plastic slips, directions of sliding and, where the law has them, paths of slip (n,)."""
        return [history[name] for name in self._names]

    def empty(self) -> Answers:
        """Arrays that a loop fills with the answers of all sections."""
        n = len(self._rows)
        return Answers(np.empty(15 * n), np.empty((2, n), dtype=bool))

    def answers(
        self, traction: Floats, tangent: Floats, inelastic: Floats, stored: Floats, history: History
    ) -> Answers:
        """Those of a response (n, ...) from which a loop goes on: without strengths, margins and statuses."""
        n, found = len(self._rows), self.empty()
        starts = (0, traction), (2 * n, tangent), (6 * n, inelastic), (8 * n, stored)
        for first, each in (*starts, *((12 * n + n * k, each) for k, each in enumerate(self.past(history)))):
            found.values[first : first + each.size] = each.ravel()
        return found

    def response(self, answers: Answers) -> JointResponse:
        """The response (n, ...) that a loop has put there."""
        n, (found, statuses) = len(self._rows), answers
        new = {"plastic_slip": found[12 * n : 13 * n, None], "sliding": found[13 * n : 14 * n, None]}
        if self.has_path:
            new["slip_path"] = found[14 * n :]
        return JointResponse(
            traction=found[: 2 * n].reshape(n, 2),
            tangent=found[2 * n : 6 * n].reshape(n, 2, 2),
            inelastic=found[6 * n : 8 * n].reshape(n, 2),
            stored=found[8 * n : 9 * n],
            strength=found[9 * n : 10 * n],
            utilisation=found[10 * n : 11 * n],
            margin=found[11 * n : 12 * n],
            is_sliding=statuses[0],
            is_open=statuses[1],
            history=new,
        )


def _address(values: NDArray[Any]) -> int:
    found: int = values.__array_interface__["data"][0]  # a tenth of the time of values.ctypes
    return found


def copy_of(law: JointLaw, sections: int, dim: int) -> CompiledFriction | None:
    """The compiled copy of a law for so many sections; None where there is none."""
    has_copy = dim == 2 and number_of(law) in OF_FRICTION and library() is not None
    return CompiledFriction(law, sections) if has_copy else None


def fastest(law: JointLaw, sections: int, dim: int) -> Evaluates:
    """The compiled copy of a law for so many sections, where there is one; else the law itself."""
    return copy_of(law, sections, dim) or law
