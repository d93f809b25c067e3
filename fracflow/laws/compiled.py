"""Laws of friction in the plane by one compiled loop over sections, ``friction.c``.

The laws are at home in their own files; the loop is a copy of them and has their bits. Only stored energies may differ in the
last one, since their logarithm is the C library's. Setting up makes the loop where there is a compiler, else the laws serve.
Their evaluation is some hundred calls of NumPy.
"""

from __future__ import annotations

import ctypes
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fracflow.laws.base import Bools, Floats, History, JointLaw, JointResponse, LawStep, per_section

VERSION = 2  # of the function's arguments, as in friction.c
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


@cache
def parts_of_answer() -> dict[str, slice]:
    """Columns of the parts of an answer, one part after the other, as ``response.h`` has them."""
    compiled = library()
    assert compiled is not None
    text = ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(compiled, "fracflow_answer"))).decode()
    names, counts = zip(*(part.split() for part in text.split(";")[:-1]), strict=True)
    ends = list(accumulate(map(int, counts)))
    return {name: slice(end - int(count), end) for name, count, end in zip(names, counts, ends, strict=True)}


class Answers(NamedTuple):
    """Values (15 n,) and statuses (2, n) of sections: each part of ``parts_of_answer`` is of all sections, (n, k)."""

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
        self._columns = max(each.stop for each in parts_of_answer().values())

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
        return Answers(np.empty(self._columns * n), np.empty((2, n), dtype=bool))

    def answers(
        self, traction: Floats, tangent: Floats, inelastic: Floats, stored: Floats, history: History
    ) -> Answers:
        """Those of a response (n, ...) from which a loop goes on: without strengths, margins and statuses."""
        found = self.empty()
        known = {"traction": traction, "tangent": tangent, "inelastic": inelastic, "stored": stored}
        parts = in_parts(found.values, len(self._rows))
        for name, each in (known | dict(zip(self._names, self.past(history), strict=True))).items():
            parts[name][:] = each.reshape(parts[name].shape)
        return found

    def response(self, answers: Answers) -> JointResponse:
        """The response (n, ...) that a loop has put there."""
        n, statuses = len(self._rows), answers.statuses
        parts = in_parts(answers.values, n)
        new = {name: parts[name] for name in ("plastic_slip", "sliding")}
        if self.has_path:
            new["slip_path"] = parts["slip_path"][:, 0]
        scalars = {name: parts[name][:, 0] for name in ("stored", "strength", "utilisation", "margin")}
        return JointResponse(
            traction=parts["traction"],
            tangent=parts["tangent"].reshape(n, 2, 2),
            inelastic=parts["inelastic"],
            **scalars,
            is_sliding=statuses[0],
            is_open=statuses[1],
            history=new,
        )


def in_parts(values: Floats, sections: int) -> dict[str, Floats]:
    """Views (n, k) of the parts of answers of so many sections, by their names."""
    return {
        name: values[sections * at.start : sections * at.stop].reshape(sections, at.stop - at.start)
        for name, at in parts_of_answer().items()
    }


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
