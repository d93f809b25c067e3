"""How large and how tangled the package is: files, layers, imports, circles, arguments, lines of code.

    scripts/bench counts [ROOT...]        of this checkout, or of others to compare with

Lines of code are those without blank lines, docstrings and comments. Imports are those within the package, under
TYPE_CHECKING too. Widest are the functions with the most arguments, without self.
"""

from __future__ import annotations

import argparse
import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

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


def main() -> None:
    """Print the counts of each checkout beside each other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", nargs="*", type=Path, default=[Path(__file__).parents[2]])
    columns = [counts(root) for root in parser.parse_args().root]
    for name in columns[0]:
        print(f"{name:36s}", *(f"{column[name]:>28s}" for column in columns))


if __name__ == "__main__":
    main()
