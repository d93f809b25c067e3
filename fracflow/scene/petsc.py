"""PETSc options that a scene may give: methods, tolerances and limits, as plain values.

PETSc's options do more than choose solvers: some run Python files or load libraries, and any viewer or monitor may
write to a file. A scene comes from anybody, and so does its copy in a run folder: it gives what petsc_options.toml
lists. The command line, which only the user writes, gives any option.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from fracflow.scene.messages import nearest
from fracflow.scene.toml import read_toml

Value = str | float | int | bool

SOLVERS = (
    "monolithic", "whole-lu", "solid", "flow", "mass", "condensed", "period", "stability", "explicit", "handed",
)  # fmt: skip
"""Prefixes of the program's solvers; each has one, so that an option without one reaches none."""
_SOLVER = re.compile(f"(?:{'|'.join(SOLVERS)})_")
_INNER = re.compile(
    r"fieldsplit_(?:solid|flow|\d{1,2})_|mg_(?:coarse|levels|fine)_(?:\d{1,2}_)?|(?:sub|redundant|ksp|esteig|inner|upper|intact|jumps|strips)_"
)
_NUMBER = r"[-+]?(?:\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})(?:[eE][-+]?\d{1,3})?"
_NUMBERS = re.compile(rf"{_NUMBER}(?:,{_NUMBER}){{0,19}}")
LARGEST = 10_000_000  # whole number, such as a count of iterations


def _expected() -> dict[str, str | Sequence[str]]:
    """Name of an option, without the prefixes of solvers -> its kind of value, or the words that it takes."""
    given = read_toml(Path(__file__).with_name("petsc_options.toml"))
    found: dict[str, str | Sequence[str]] = {
        name: kind for kind, names in given["kinds"].items() for name in names.split()
    }
    return found | {name: tuple(words.split()) for name, words in given["words"].items()}


EXPECTED: Mapping[str, str | Sequence[str]] = _expected()


def reaches_a_solver(option: str) -> bool:
    """Whether an option begins with the prefix of one of the program's solvers."""
    return _SOLVER.match(option) is not None


def refusal(option: str, value: Value) -> str:
    """Why a scene may not give an option of PETSc this value; empty where it may."""
    if not re.fullmatch(r"[A-Za-z][!-~]{0,150}", option):
        return "is no name of a PETSc option; give it without dash, such as solid_pc_type"
    elsewhere = f"or give it on the command line: -- -{option}"
    name = base = _SOLVER.sub("", option, count=1) if _SOLVER.match(option) else option
    while name not in EXPECTED and (inner := _INNER.match(name)):
        name = name[inner.end() :]
    expected = EXPECTED.get(name)
    if expected is None:
        close = nearest(base, EXPECTED)
        hint = f"{close} " if close.startswith("did") else ""
        return (
            "is not among the PETSc options that a scene may give, which choose methods, tolerances and limits of the solvers"
            f" {', '.join(SOLVERS)}; {hint}{elsewhere}"
        )
    if _fits(expected, value):
        return ""
    needs = {
        "switch": "true or false",
        "whole": f"a whole number, at most {LARGEST}",
        "number": "a number",
        "list": "numbers with commas between",
        "terminal": '"", which writes to the terminal',
    }
    wanted = needs[expected] if isinstance(expected, str) else f"one of {', '.join(expected)}"
    return f"must be {wanted}; {elsewhere}"


def _fits(expected: str | Sequence[str], value: Value) -> bool:
    """Whether a value is of the kind that an option takes in a scene."""
    if not isinstance(expected, str):
        return isinstance(value, str) and value.lower() in [word.lower() for word in expected]
    if isinstance(value, int) and abs(value) > LARGEST:
        return False
    text = str(value).lower() if isinstance(value, bool) else value if isinstance(value, str) else repr(value)
    if expected == "switch":
        return text in ("", "0", "1", "true", "false")
    if expected == "terminal":
        return text == ""
    if len(text) > 1000 or _NUMBERS.fullmatch(text) is None or (expected != "list" and "," in text):
        return False
    return expected != "whole" or (re.fullmatch(r"[-+]?\d{1,9}", text) is not None and abs(int(text)) <= LARGEST)
