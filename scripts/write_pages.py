"""Pages that follow from the sources: keys of a scene, commands, and the index of equations.

    python scripts/write_pages.py    # after . scripts/setup.sh: writes those that are stale, and names them

An equation is indexed where its number stands in the first line of a docstring: at its beginning for the place that
computes it, anywhere for places that use it, which are listed only where no place begins with it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "fracflow"
BEGIN, END = "<!-- equations: python scripts/write_pages.py -->", "<!-- end of equations -->"
LETTERED = r"[a-z](?:,[a-z])*"
EQUATION = re.compile(rf"\(([234])\.(\d+)({LETTERED})?\)(?:-\(([234])\.(\d+)({LETTERED})?\))?")
LEADING = re.compile(rf"(?:{EQUATION.pattern}(?:, | with (?=\()| and (?=\())?)+")
Number = tuple[int, int]


@dataclass(frozen=True)
class Entry:
    """A docstring that names equations in its first line: which, where it stands, and the line."""

    numbers: tuple[Number, ...]
    shown: str
    path: str
    name: str
    line: str
    is_home: bool


def entries(package: Path = PACKAGE) -> Iterator[Entry]:
    """All docstrings of a package whose first line names an equation of chapters 2 to 4."""
    for path in sorted(package.rglob("*.py")):
        here = path.relative_to(package).as_posix()
        for name, text in docstrings(ast.parse(path.read_text(encoding="utf-8"))):
            first = text.strip().splitlines()[0] if text.strip() else ""
            found = list(EQUATION.finditer(first))
            if not found:
                continue
            leading = LEADING.match(first)
            shown = leading[0].rstrip(", ") if leading else ", ".join(match[0] for match in found)
            line = first[leading.end() :] if leading else first
            in_head = [match for match in found if leading is None or match.end() <= leading.end()]
            numbers = tuple(number for match in in_head for number in covered(match))
            yield Entry(numbers, shown.removesuffix(" with"), here, name, line.lstrip(" :,"), leading is not None)


def docstrings(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """(qualified name, docstring) of a module, its classes and their functions; a module's name is empty."""

    def walk(node: ast.AST, path: str) -> Iterator[tuple[str, str]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                name = f"{path}{child.name}"
                yield name, ast.get_docstring(child) or ""
                yield from walk(child, f"{name}.")

    yield "", ast.get_docstring(tree) or ""
    yield from walk(tree, "")


def covered(match: re.Match[str]) -> list[Number]:
    """The numbers from the first to the last of a range, letters aside."""
    first = (int(match[1]), int(match[2]))
    last = (int(match[4]), int(match[5])) if match[4] else first
    return [(first[0], number) for number in range(first[1], last[1] + 1)]


def chosen() -> list[Entry]:
    """Places that compute an equation; places that use one where no other computes it; in the order of equations."""
    found = list(entries())
    homes = {number for entry in found if entry.is_home for number in entry.numbers}
    kept = [entry for entry in found if entry.is_home or not set(entry.numbers) <= homes]
    return sorted(kept, key=lambda entry: (entry.numbers[0], not entry.is_home, entry.path, entry.name))


def equations() -> str:
    """The index as a table in Markdown, with links from ``fracflow/README.md``."""
    rows = ["| equation | place | |", "|---|---|---|"]
    for entry in chosen():
        place = f"[{entry.path}]({entry.path})" + (f" `{entry.name}`" if entry.name else "")
        line = entry.line.replace("|", "\\|")
        rows.append(f"| {entry.shown} | {place} | {line} |")
    return "\n".join(rows)


def pages() -> dict[Path, str]:
    """The text that each page should have."""
    from fracflow.cli.app import commands
    from fracflow.cli.reference import markdown as commands_page
    from fracflow.scene.scene import Scene
    from fracflow.scene.schema import markdown as scene_page

    layers = PACKAGE / "README.md"
    head, _, rest = layers.read_text(encoding="utf-8").partition(BEGIN)
    tail = rest.partition(END)[2]
    return {
        ROOT / "meshes" / "SCENE.md": scene_page(Scene.json_schema()),
        PACKAGE / "COMMANDS.md": commands_page(commands()),
        layers: f"{head}{BEGIN}\n{equations()}\n{END}{tail}",
    }


def main() -> None:
    """Write the pages that are stale."""
    for path, text in pages().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
