"""The language of docstrings, comments and messages: subject first, short sentences, the field's own words.

Counts of each package that are left stand in language.toml and may only fall; ``python tests/test_language.py`` writes them.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pytestmark = pytest.mark.serial

ROOT = Path(__file__).parents[1]
RECORD = Path(__file__).with_name("language.toml")
MOST_WORDS = 25
DIALECT = {  # words of the program's old dialect, and those of the field
    r"\b(?:energy )?books?\b|\bbooked\b": "energy balance",
    r"\bfilms?\b(?!.*\bnow called\b)": "fracture flow",
    r"\blast words\b": "summary",
    r"\bturn(?:s|ed)? back\b|\bin circles\b": "active-set cycling",
    r"\bits past\b|\bthe past\b|``past``": "history",
    r"\bin parts\b|\bparts? of (?:a|the|its|their) steps?\b": "substeps",
    r"\btied fractures?\b": "locked fractures",
    r"\bscene card\b|\bthe card\b": "pre-run checks",
    r"\b(?:tells?|told|hopeless|hurr(?:y|ies)|calm|forgets?|remembers?|nobody|wants?|cannot speak)\b": "no personification",
}
KINDS = ("what", "long", *dict.fromkeys(DIALECT.values()))


@cache
def nodes(source: str) -> tuple[ast.AST, ...]:
    """All nodes of a source file, parsed once for all tests."""
    return tuple(ast.walk(ast.parse(source)))


def texts(source: str) -> Iterator[str]:
    """Docstrings, also those of attributes, comments and messages of a file, a paragraph or an entry of a list each.

    The docstring below a key of a class is its meaning, which messages and the schema have: it counts as a message.
    """
    bodies = [node.body for node in nodes(source) if isinstance(node, ast.ClassDef)]
    below = {
        id(line.value)
        for body in bodies
        for key, line in pairwise(body)
        if isinstance(key, ast.AnnAssign) and isinstance(line, ast.Expr)
    }
    docs = {
        id(node.value): node.value.value
        for node in nodes(source)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        and id(node.value) not in below
    }
    for text in docs.values():
        for paragraph in re.split(r"\n\s*\n", text):
            yield from re.split(r"\n(?=\s*\S+(?:, \S+)*  +\S)", paragraph)
    skipped = {*docs, *(id(part) for node in nodes(source) if isinstance(node, ast.JoinedStr) for part in node.values)}
    for node in nodes(source):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped:
            text = node.value
        else:
            continue
        if text.count(" ") >= 3:
            yield from re.split(r"[;:]\s", text)  # file, key, fault and remedy are statements of their own
    yield from _comments(source)


def _comments(source: str) -> Iterator[str]:
    last, found = -1, ""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text, alone = token.string.lstrip("#: "), token.line.lstrip().startswith("#")
            if alone and token.start[0] == last + 1:
                found += " " + text
            else:
                yield found
                found = text
            last = token.start[0]
    yield found


def sentences(text: str) -> list[str]:
    """The sentences of a text, its white space made plain."""
    return re.split(r"(?<=[.!?])\s+(?=[A-Z\"`(\[])", " ".join(text.split()))


def words(sentence: str) -> int:
    """Number of words: signs and letters of equations, code and sources are none."""
    plain = re.sub(r"``[^`]*``|\([^()]*\d{4}[^()]*\)", "name", sentence).split()
    return sum(re.fullmatch(r"\W*[^\W\d_]{2,}(?:['’/-][^\W\d_]+)*\W*", word) is not None for word in plain)


def faults(source: str) -> Counter[str]:
    """Sentences of a source file that begin with "What", that are long, and words of the dialect."""
    found: Counter[str] = Counter()
    for text in texts(source):
        for sentence in sentences(text):
            found["what"] += re.match(r"\W?What\b", sentence) is not None
            found["long"] += words(sentence) > MOST_WORDS
            for pattern, standard in DIALECT.items():
                found[standard] += len(re.findall(pattern, sentence))
    return found


def counted() -> dict[str, dict[str, int]]:
    """The counts of each package of fracflow, of its root, of the scripts and of the docstrings of tests."""
    found: dict[str, Counter[str]] = {}
    for path in sorted((ROOT / "fracflow").rglob("*.py")):
        inside = path.relative_to(ROOT / "fracflow").parts
        found.setdefault(inside[0] if len(inside) > 1 else "root", Counter()).update(faults(path.read_text()))
    return {package: {kind: counts[kind] for kind in KINDS if counts[kind]} for package, counts in found.items()}


def test_a_fault_is_found():
    source = '''"""What it does. It tells of the film, for """\n# in circles\nx = f"the {1} books are open"\n'''
    source += f'y = "{"word " * (MOST_WORDS + 1)}"\n'
    once = {"what", "long", "no personification", "fracture flow", "active-set cycling", "energy balance"}
    assert +faults(source) == Counter(once)
    assert faults('"""The balance M a + K u = f (4.1)."""\n').total() == 0
    table = '"""A table.\n\n    name  ' + "word " * 20 + "\n    other  " + "word " * 20 + '\n"""\n'
    assert faults(table)["long"] == 0


def test_language_of_the_package():
    allowed, found = tomllib.loads(RECORD.read_text()), counted()
    more = [
        f"{package}: {kind}: {found.get(package, {}).get(kind, 0)}, recorded {allowed.get(package, {}).get(kind, 0)}"
        for package in sorted({*allowed, *found})
        for kind in KINDS
        if found.get(package, {}).get(kind, 0) != allowed.get(package, {}).get(kind, 0)
    ]
    assert not more, "mend new sentences; where counts fell, write them by python tests/test_language.py\n" + "\n".join(
        more
    )


@pytest.mark.parametrize("folder", ["fracflow", "scripts", "tests"])
def test_no_docstring_begins_with_what(folder):
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = {
        (path, node): ast.get_docstring(node, clean=False)
        for path in sorted((ROOT / folder).rglob("*.py"))
        for node in nodes(path.read_text())
        if isinstance(node, kinds)
    }
    found = [f"{path}: {text}" for (path, _), text in docs.items() if re.match(r"\W*What\b", text or "")]
    assert len(docs) > 100 and not found, "begin with the subject:\n" + "\n".join(found)


def risen(allowed: dict[str, dict[str, int]], found: dict[str, dict[str, int]]) -> list[str]:
    """Packages with more of a kind than is recorded."""
    return [
        f"{package}: {kind}: {count}, recorded {allowed.get(package, {}).get(kind, 0)}"
        for package, counts in found.items()
        for kind, count in counts.items()
        if count > allowed.get(package, {}).get(kind, 0)
    ]


def test_counts_that_rise_are_not_written():
    assert risen({"laws": {"long": 1}}, {"laws": {"long": 1}}) == []
    assert risen({"laws": {"long": 1}}, {"laws": {"long": 2}, "mesh": {"what": 1}}) == [
        "laws: long: 2, recorded 1",
        "mesh: what: 1, recorded 0",
    ]


def main() -> None:
    """Write the counts that are left; exit code 1 where some are more than before."""
    if more := risen(tomllib.loads(RECORD.read_text()), counted()):
        sys.exit("mend new sentences:\n" + "\n".join(more))
    lines = ["# sentences and words that are left, by package: see test_language.py"]
    for package, counts in sorted(counted().items()):
        if counts:
            lines += ["", f"[{package}]", *(f'"{kind}" = {count}' for kind, count in counts.items())]
    RECORD.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
