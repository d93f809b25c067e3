"""How large and how tangled the package is: files, layers, imports, circles, arguments, lines of code.

    scripts/bench counts [ROOT...]        of this checkout, or of others to compare with
    scripts/bench counts --way [ROOT...]  how far it is from a run to a law, and how a step hands the state on; -v: each move

Lines of code are those without blank lines, docstrings and comments. Imports are those within the package, under
TYPE_CHECKING too. Widest are the functions with the most arguments, without self.

The way is that of the second step of meshes/report_5_1. Frames are functions of the package from ``run`` to the joint law,
both counted. A move is a pair of functions of which one hands a State to the other, as an argument (not as ``self``) or as
its result, alone or in a tuple, an outcome or a step. A climb is a move by a result. Each counts once in a step.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import io
import os
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

SILENT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING}
WIDEST = 5
SMALL = 60


def modules_of(root: Path) -> dict[str, Path]:
    """Files of the package under a checkout, by the name of their module."""
    names = {}
    for path in sorted((root / "fracflow").rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def imports_of(tree: ast.Module, modules: dict[str, Path]) -> set[str]:
    """Modules of the package that a module imports."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(each.name for each in node.names if each.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module in modules:
            for each in node.names:
                inner = f"{node.module}.{each.name}"
                found.add(inner if inner in modules else node.module)
    return found


def code_lines(text: str, tree: ast.Module) -> int:
    """Lines with code on them."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SILENT and token.type != tokenize.ENDMARKER:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def circles(arrows: dict[str, set[str]]) -> int:
    """Groups of modules that import each other, over any number of steps."""
    names = {name: number for number, name in enumerate(arrows)}
    pairs = np.array([(names[a], names[b]) for a, to in arrows.items() for b in to])
    graph = csr_array((np.ones(len(pairs)), pairs.T), shape=(len(names), len(names)))
    _, group = connected_components(graph, connection="strong")
    return int((np.bincount(group) > 1).sum())


def widest(trees: dict[str, ast.Module]) -> list[tuple[int, str]]:
    """The functions with the most arguments."""
    found = []
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                given = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                found.append((len([a for a in given if a not in ("self", "cls")]), f"{name}.{node.name}"))
    return sorted(found, key=lambda each: (-each[0], each[1]))[:WIDEST]


def counts(root: Path) -> dict[str, str]:
    """Counts of one checkout, by what they count."""
    modules = modules_of(root)
    texts = {name: path.read_text() for name, path in modules.items()}
    trees = {name: ast.parse(text) for name, text in texts.items()}
    arrows = {name: imports_of(tree, modules) - {name} for name, tree in trees.items()}
    importers = Counter(to for targets in arrows.values() for to in targets)
    lines = {name: code_lines(texts[name], trees[name]) for name in modules}
    lonely = [name for name in modules if importers[name] == 1]
    packages = Counter(str(path.parent.relative_to(root)) for path in modules.values())
    return {
        "files": str(len(modules)),
        "files at the root of the package": str(packages["fracflow"]),
        "packages": str(len(packages)),
        "most files in a package": "{1} ({0})".format(*packages.most_common(1)[0]),
        "arrows between modules": str(sum(map(len, arrows.values()))),
        "circles": str(circles(arrows)),
        "files with one importer": str(len(lonely)),
        f"of these below {SMALL} lines": str(sum(texts[name].count("\n") < SMALL for name in lonely)),
        "lines": str(sum(text.count("\n") for text in texts.values())),
        "lines of code": str(sum(lines.values())),
        "longest file": "{} ({})".format(*max((text.count("\n"), name) for name, text in texts.items())),
        "files that say absorb": str(sum("absorb" in text for text in texts.values())),
        "widest functions": ", ".join(f"{count} {name.rpartition('fracflow.')[2]}" for count, name in widest(trees)),
    }


class Way:
    """Frames from a run to a law, and moves of the state, (caller, callee, whether it is a climb), in each step."""

    def __init__(self, package: Path) -> None:
        self.package = f"{package}{os.sep}"
        self.moves: list[set[tuple[str, str, bool]]] = [set()]
        self.frames: list[str] = []
        self.entered: set[int] = set()  # generators, which are gone on with later

    def __call__(self, frame: FrameType, event: str, result: Any) -> None:
        """As ``sys.setprofile`` calls it."""
        code = frame.f_code
        if event not in ("call", "return") or not self.is_ours(frame):
            return
        if event == "return":
            self.move(frame, [result], is_climb=True)
        elif not (code.co_flags & inspect.CO_GENERATOR and id(frame) in self.entered):
            self.entered |= {id(frame)} if code.co_flags & inspect.CO_GENERATOR else set()
            if code.co_qualname == "Recorder.record":
                self.moves.append(set())
            flags = bool(code.co_flags & inspect.CO_VARARGS) + bool(code.co_flags & inspect.CO_VARKEYWORDS)
            names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount + flags]
            self.move(frame, [frame.f_locals[name] for name in names if name != "self" and name in frame.f_locals])
            is_law = f"{os.sep}laws{os.sep}" in code.co_filename and code.co_name in ("evaluate", "respond")
            if len(self.moves) == 3 and not self.frames and is_law:
                self.frames = self.stack(frame)

    def is_ours(self, frame: FrameType) -> bool:
        """Whether a frame is one of the package."""
        return frame.f_code.co_filename.startswith(self.package)

    def stack(self, frame: FrameType | None) -> list[str]:
        """Names of the frames of the package, from the last ``run`` to a frame."""
        found: list[str] = []
        while frame is not None and not (found and found[0].endswith("run.run")):
            found = [self.name(frame), *found] if self.is_ours(frame) else found
            frame = frame.f_back
        return found

    def name(self, frame: FrameType) -> str:
        """Module and name of a function."""
        module = frame.f_code.co_filename.removeprefix(self.package).removesuffix(".py").replace(os.sep, ".")
        return f"{module}.{frame.f_code.co_qualname}"

    def move(self, frame: FrameType, values: list[Any], is_climb: bool = False) -> None:
        """Note it if the state is among the values."""
        other = frame.f_back
        while other is not None and not self.is_ours(other):
            other = other.f_back
        if other is not None and any(map(carries, values)):
            self.moves[-1].add((self.name(other), self.name(frame), is_climb))


def carries(value: Any) -> bool:
    """Whether a value is a State, or has one among its members."""
    inside = value if isinstance(value, tuple) else ()
    if is_dataclass(value) and not isinstance(value, type):
        inside = tuple(getattr(value, each.name, None) for each in fields(value))
    return any(type(each).__name__ == "State" for each in (value, *inside))


def way(root: Path) -> Way:
    """The way through the package that Python finds first, on the scene of a checkout."""
    import fracflow

    seen = Way(Path(fracflow.__file__).parent)
    scene = fracflow.load(str(root / "meshes/report_5_1/scene.toml"), ["output.pictures=false"])
    with tempfile.TemporaryDirectory() as folder:
        sys.setprofile(seen)
        try:
            fracflow.run(scene, Path(folder) / "out")
        finally:
            sys.setprofile(None)
    return seen


def print_way(root: Path, lists: bool) -> None:
    """Print the way of a checkout, from within a process that imports it."""
    seen = way(root)
    moves = seen.moves[2]
    print(f"{len(seen.frames)} frames, {len(moves)} moves, {sum(climbs for *_, climbs in moves)} climbs")
    if lists:
        print(*seen.frames, sep="\n  ")
        print(*sorted(f"{a} {'<-' if climbs else '->'} {b}" for a, b, climbs in moves), sep="\n")


def main() -> None:
    """Print the counts of each checkout beside each other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", nargs="*", type=Path, default=[Path(__file__).parents[2]])
    parser.add_argument("--way", action="store_true")
    parser.add_argument("-v", "--verbose", action="store_true")
    given = parser.parse_args()
    for root in given.root if given.way else ():
        if str(root) == os.environ.get("PYTHONPATH"):
            print_way(root, given.verbose)
        else:
            words = [__file__, "--way", *(["-v"] if given.verbose else []), str(root.resolve())]
            subprocess.run([sys.executable, *words], env={**os.environ, "PYTHONPATH": str(root.resolve())}, check=True)
    if given.way:
        return
    columns = [counts(root) for root in given.root]
    for name in columns[0]:
        print(f"{name:36s}", *(f"{column[name]:>28s}" for column in columns))


if __name__ == "__main__":
    main()
