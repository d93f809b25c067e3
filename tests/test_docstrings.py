"""Docstrings of public functions say what a reader needs: shapes, errors, collectives, in sentences with a subject.

Read from the sources alone. Functions that do not yet are counted, a package and a rule, in ALLOWED: a ratchet, which
fails where there are more and where there are fewer. ``python tests/test_docstrings.py`` prints the table as it should be,
``python tests/test_docstrings.py PACKAGE`` the functions themselves.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial
PACKAGE = Path(__file__).parents[1] / "fracflow"

ARRAY = re.compile(r"\b(Floats|Ints|Bools|NDArray|ndarray)\b")
AXIS = re.compile(r"\.\.\.|\d+|\d* ?[a-z]{1,2}\d?|\d* ?dim(?: - 1)?|\*shape|[A-Z]+")  # n, 2k, 4 dim, 3, ...
COUNT = re.compile(r"[a-z_]+(?: [*+] \d)?")  # cells, joints * 2
ON_RANKS = {
    "allgather", "allreduce", "assemble", "Barrier", "bcast", "createMPI", "matMult", "multAdd", "multTranspose",
    "multTransposeAdd", "on_root", "ptap", "transposeMatMult",
}  # fmt: skip
ON_RANKS_OF_PETSC = {"dot", "duplicate", "mult", "norm", "sum"}  # names that arrays have too
OURS = re.compile(r"(Error|Interrupted|LimitPoint|NotConverged|ReductionInvalid|StatusCycling)$")

WHAT = re.compile(r"(?:^|[.:;]\s+)What\b")

ALLOWED: dict[str, dict[str, int]] = {}

Function = ast.FunctionDef


def public_functions(tree: ast.Module) -> Iterator[tuple[str, Function]]:
    """(qualified name, function) of a module's functions and of its classes' methods, without an underscore.

    The docstring of a command is its help, and speaks to others.
    """

    def walk(node: ast.Module | ast.ClassDef, path: str) -> Iterator[tuple[str, Function]]:
        for child in node.body:
            if isinstance(child, Function | ast.ClassDef) and not child.name.startswith("_"):
                if isinstance(child, Function):
                    if not any("app.command" in ast.unparse(each) for each in child.decorator_list):
                        yield path + child.name, child
                else:
                    yield from walk(child, f"{path}{child.name}.")

    return walk(tree, "")


def annotations(function: Function) -> list[str]:
    """Types of arguments and of the result, as written."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [
        ast.unparse(each) for each in (*(one.annotation for one in arguments), function.returns) if each is not None
    ]


def own_nodes(function: Function) -> Iterator[ast.AST]:
    """Nodes of a function's body, without those of functions inside it."""
    todo: list[ast.AST] = list(function.body)
    while todo:
        node = todo.pop()
        yield node
        if not isinstance(node, Function | ast.Lambda | ast.ClassDef):
            todo += ast.iter_child_nodes(node)


def called(function: Function) -> set[str]:
    """Last names of the functions that are called."""
    calls = [node.func for node in own_nodes(function) if isinstance(node, ast.Call)]
    return {call.attr if isinstance(call, ast.Attribute) else getattr(call, "id", "") for call in calls}


def raised(function: Function) -> set[str]:
    """Names of our errors that are raised here and not handled here."""
    inside = {
        id(node) for body in own_nodes(function) if isinstance(body, ast.Try) and body.handlers
        for part in body.body for node in ast.walk(part)
    }  # fmt: skip
    found = [node.exc for node in own_nodes(function) if isinstance(node, ast.Raise) and id(node) not in inside]
    kinds = [each.func if isinstance(each, ast.Call) else each for each in found if each is not None]
    names = {ast.unparse(kind).split(".")[0] for kind in kinds}
    return {name for name in names if OURS.search(name)}


def is_shape(words: str) -> bool:
    """Whether words in brackets are a shape: (n, dim), (2k,), (cells,), (rocks, 2); (slip, opening) is none."""
    axes = [word.strip() for word in words.removesuffix(",").split(",")]
    single = words.endswith(",") or words == "..."
    known = [AXIS.fullmatch(axis) is not None for axis in axes]
    return all(a or COUNT.fullmatch(axis) for a, axis in zip(known, axes, strict=True)) and (
        single if len(axes) == 1 else any(known)
    )


def has_shapes(function: Function, text: str) -> bool:
    """A function that takes or gives arrays states a shape, such as (n, dim)."""
    takes = any(ARRAY.search(each) for each in annotations(function))
    return not takes or any(is_shape(words) for words in re.findall(r"\(([^()]+)\)", text))


def says_collective(function: Function, text: str) -> bool:
    """A function that calls collectives says so."""
    of_petsc = any("PETSc." in each for each in annotations(function))
    talks = called(function) & (ON_RANKS | ON_RANKS_OF_PETSC if of_petsc else ON_RANKS)
    return not talks or re.search(r"[Cc]ollective|every rank", text) is not None


def says_raises(function: Function, text: str) -> bool:
    """A function that raises one of our errors says which."""
    return not raised(function) or re.search(r"\b(Raises?|Refuses?|raises)\b", text) is not None


def has_subjects(function: Function, text: str) -> bool:
    """No sentence begins with "what"."""
    return re.search(WHAT, text) is None


def first_line_ends(function: Function, text: str) -> bool:
    """The first line is a sentence."""
    return text.splitlines()[:1] == [] or text.splitlines()[0].rstrip('"').endswith(".")


RULES = (has_shapes, says_collective, says_raises, has_subjects, first_line_ends)


def faults(package: Path = PACKAGE) -> Iterator[tuple[str, str, str]]:
    """(package, rule, place) of each public function whose docstring breaks a rule; files at the root by their name.

    Docstrings of modules and classes are held to sentences with subjects.
    """
    for path in sorted(package.rglob("*.py")):
        inner = path.relative_to(package)
        top = inner.parts[0] if len(inner.parts) > 1 else inner.stem
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef) and re.search(WHAT, ast.get_docstring(node) or ""):
                yield top, "has_subjects", f"{inner.as_posix()}: {(ast.get_docstring(node) or '').splitlines()[0]}"
        for name, function in public_functions(tree):
            text = ast.get_docstring(function) or ""
            for rule in RULES:
                if not rule(function, text):
                    yield top, rule.__name__, f"{inner.as_posix()}:{function.lineno} {name}: {text.splitlines()[:1]}"


def counts(found: list[tuple[str, str, str]]) -> dict[str, dict[str, int]]:
    """How many functions of a package break a rule, without zeros."""
    number = Counter((top, rule) for top, rule, _ in found)
    return {top: {r: n for (t, r), n in sorted(number.items()) if t == top} for top in sorted({t for t, _ in number})}


def test_docstrings_get_no_worse():
    """More faults than recorded: mend the new ones. Fewer: lower the number, by the table that this file prints."""
    found = list(faults())
    now = counts(found)
    different = {top for top in now.keys() | ALLOWED.keys() if now.get(top) != ALLOWED.get(top)}
    listed = [place for top, _, place in found if top in different]
    assert now == ALLOWED, "\n".join(listed)


GOOD = '''
def force(traction: Floats) -> Floats:
    """(2.31) Nodal forces (n, dim) of tractions (n, dim)."""

def norm(vector: PETSc.Vec) -> float:
    """Size of a vector. Collective."""
    return vector.norm()

def check(value: int) -> None:
    """Look at a number. Raises InputError below zero."""
    raise InputError("no")

def _inner(values: Floats) -> Floats:
    return values
'''


def test_shapes_are_known_from_other_words():
    shapes = ("n, dim", "n,", "...", "..., dim", "n, 4 dim", "2k,", "rocks, 2", "joints * 2,", "rows, WIDTH")
    assert all(map(is_shape, shapes))
    assert not any(map(is_shape, ("slip, opening", "n", "its nodes, without padding", "report", "2.31")))


@pytest.mark.parametrize(
    ("old", "new", "rule"),
    [
        ("(n, dim) of tractions (n, dim)", "of tractions (slip, opening)", "has_shapes"),
        (" Collective.", "", "says_collective"),
        (" Raises InputError below zero.", "", "says_raises"),
        ("Look at a number.", "Look. What a number is, it says.", "has_subjects"),
        ("Size of a vector. Collective.", "Size of a vector, collective", "first_line_ends"),
        ("_inner", "inner", "has_shapes"),
    ],
)
def test_a_planted_fault_is_found(tmp_path, old, new, rule):
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "base.py").write_text(GOOD, encoding="utf-8")
    assert list(faults(tmp_path)) == []
    assert old in GOOD
    (tmp_path / "laws" / "base.py").write_text(GOOD.replace(old, new), encoding="utf-8")
    assert counts(list(faults(tmp_path))) == {"laws": {rule: 1}}


if __name__ == "__main__":
    every = list(faults())
    for package, rule, place in every:
        if package in sys.argv[1:]:
            print(f"{rule}: {place}")
    for package, rules in counts(every).items() if len(sys.argv) == 1 else ():
        print(f'    "{package}": {rules},'.replace("'", '"'))
