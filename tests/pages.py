"""The pages in Markdown, taken apart: links, anchors, code blocks, code in lines."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from markdown_it.token import Token
from website.pages import Page

ROOT = Path(__file__).parents[1]
FOLDERS = (".github", "fracflow", "meshes", "scripts", "tests")
PAGES = [*sorted(ROOT.glob("*.md")), *(page for name in FOLDERS for page in sorted((ROOT / name).rglob("*.md")))]
NO_TUTORIALS = {
    "failures",
    "injected_fault",
    "mapped_network",
    "ten_faults",
}  # their scenes take too long to be run with them
TUTORIALS = [page for page in sorted((ROOT / "meshes").glob("*/README.md")) if page.parent.name not in NO_TUTORIALS]
"""Pages whose blocks are run one after another, and whose shown output is compared: see test_tutorials.py."""

SCENES = sorted(path for path in (ROOT / "meshes").rglob("*.toml") if not any(path.parent.glob("*.py")))
"""Scene files whose laws are all of the package."""


class Code(NamedTuple):
    """A block of code: its language, the words after it, its text, and the line of the page where it begins."""

    language: str
    words: tuple[str, ...]
    text: str
    line: int


@cache
def tokens(page: Path) -> list[Token]:
    """Tokens of a page, those inside lines in a row with the others."""
    found = Page(page.as_posix(), page.read_text(encoding="utf-8")).tokens
    return [each for token in found for each in (token, *(token.children or ()))]


def targets(page: Path) -> Iterator[tuple[str, str]]:
    """(kind, target) of every link and picture of a page."""
    for token in tokens(page):
        if token.type == "link_open":
            yield "link", str(token.attrs["href"])
        elif token.type == "image":
            yield "picture", str(token.attrs["src"])


def blocks(page: Path) -> Iterator[Code]:
    """The blocks of code of a page."""
    for token in tokens(page):
        if token.type in ("fence", "code_block"):
            language, *words = token.info.split() or [""]
            yield Code(language, tuple(words), token.content, (token.map or [0])[0] + 1)


def spans(page: Path) -> Iterator[str]:
    """Code inside lines."""
    return (token.content for token in tokens(page) if token.type == "code_inline")


@cache
def anchors(page: Path) -> frozenset[str]:
    """The anchors of a page's headings, as the forge makes them."""
    return frozenset(str(token.attrs["id"]) for token in tokens(page) if token.type == "heading_open")
