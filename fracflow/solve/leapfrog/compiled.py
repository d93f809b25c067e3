"""The compiled loops of ``rock.c``, ``joints.c``, ``nodes.c`` and ``steps.c``, made at set-up where there is a compiler.

C and not numba, which takes 2.0 times as long on quadrilaterals and 1.3 times on triangles. It also brings 160 MB, and
compiles for 4 s in each new environment. The loops need no header but C's own, and are called through ctypes.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

VERSION = 11  # of the functions' arguments, as in rock.c
_INT, _LONG, _REAL, _ARRAY = ctypes.c_int32, ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
_FUNCTIONS = {
    "fracflow_sweep": (_REAL, (_INT, _INT, *[_ARRAY] * 14, _REAL, _REAL, *[_ARRAY] * 3)),
    "fracflow_cells": (_REAL, (_INT, _INT, *[_ARRAY] * 8)),
    "fracflow_move": (None, (_INT, _INT, _ARRAY, _REAL, _REAL, *[_ARRAY] * 3)),
    "fracflow_start": (None, (_INT, _REAL, _REAL, *[_ARRAY] * 3)),
    "fracflow_stop": (None, (_INT, *[_ARRAY] * 12)),
    "fracflow_sums": (None, (_INT, *[_ARRAY] * 6)),
    "fracflow_take": (None, (_INT, *[_ARRAY] * 3)),
    "fracflow_joints": (
        _INT,
        (_INT, _INT, *[_ARRAY] * 2, _REAL, *[_ARRAY] * 2, _INT, _INT, _ARRAY, _INT, _INT, *[_ARRAY] * 2),
    ),
    "fracflow_work": (None, (_INT, *[_ARRAY] * 16)),
    "fracflow_predict": (None, (_INT, _ARRAY, _ARRAY, _REAL, _ARRAY)),
    "fracflow_jumps": (None, (_INT, *[_ARRAY] * 5)),
    "fracflow_pull": (None, (_INT, _INT, *[_ARRAY] * 8, _REAL, *[_ARRAY] * 6)),
    "fracflow_resist": (None, (_INT, *[_ARRAY] * 6)),
    "fracflow_put": (None, (_INT, _INT, *[_ARRAY] * 3)),
    "fracflow_accelerate": (None, (_INT, *[_ARRAY] * 4)),
    "fracflow_damp": (_REAL, (_INT, *[_ARRAY] * 3, _REAL, *[_ARRAY] * 4)),
    "fracflow_gain": (_REAL, (_INT, *[_ARRAY] * 4)),
    "fracflow_before": (None, (_INT, *[_ARRAY] * 8)),
    "fracflow_after": (_INT, (_INT, *[_ARRAY] * 4)),
    "fracflow_steps": (_LONG, (_ARRAY, _LONG, _INT)),
    "fracflow_piece": (None, (_ARRAY, _INT, _INT)),
    "fracflow_triad": (None, (_INT, *[_ARRAY] * 3, _REAL)),
}


@cache
def library() -> ctypes.CDLL | None:
    """The functions; None where they were not compiled, or are those of another version."""
    for path in sorted(Path(__file__).parent.glob("_rock*.so")):
        try:
            found = ctypes.CDLL(str(path))
            if ctypes.c_int.in_dll(found, "fracflow_leapfrog_version").value != VERSION:
                continue
            for name, (result, given) in _FUNCTIONS.items():
                function = getattr(found, name)
                function.restype, function.argtypes = result, given
        except (OSError, ValueError, AttributeError):
            continue
        return found
    return None


@cache
def steps_struct() -> type[ctypes.Structure]:
    """``steps`` of ``steps.c``, made from its text, so that both have the same members.

    Raises ImportError where the text is read otherwise than the compiler did.
    """
    loops, fields = library(), list[tuple[str, Any]]()
    assert loops is not None
    for declaration in _text("fracflow_steps_members").replace("const ", "").split(";")[:-1]:
        kind, names = declaration.split(maxsplit=1)
        for each in names.split(","):
            found: Any = _ARRAY if "*" in each else {"int64_t": _LONG, "double": _REAL}[kind]
            name = each.strip("* ").removesuffix("[2]")
            fields.append((name, found * 2 if each.endswith("[2]") else found))
    made = type("Steps", (ctypes.Structure,), {"_fields_": fields})
    if ctypes.sizeof(made) != ctypes.c_int64.in_dll(loops, "fracflow_steps_size").value:
        raise ImportError("the text of steps.c is not read as its compiler does: set up again")
    return made


@cache
def pieces_of_step() -> list[str]:
    """Names of the pieces of a step, in their order."""
    return _text("fracflow_pieces").split(", ")


def _text(name: str) -> str:
    loops = library()
    assert loops is not None
    return ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(loops, name))).decode()


def members_of_steps() -> set[str]:
    """Their names."""
    return {name for name, *_ in steps_struct()._fields_}


def address(values: NDArray[np.generic]) -> int:
    """Address of an array (...), which must stay alive while that is used."""
    assert values.flags.c_contiguous
    found: int = values.__array_interface__["data"][0]  # a tenth of the time of values.ctypes
    return found
