"""The pages of the project: found by their names and links, with the order and the titles that they state themselves."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from math import inf
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token
from write_pages import BEGIN, END

ROOT = Path(__file__).parents[2]
MARKDOWN = MarkdownIt("commonmark").enable("table")
NAMED = {"key", "equation"}  # heads of first columns whose rows have anchors of their own


class BrokenLink(Exception):
    """A link that leads nowhere: one line with page and target."""


def readmes(root: Path) -> list[str]:
    """Paths of the README.md files, in folders and in folders of these, but for runs and for hidden folders."""
    found = (path.relative_to(root) for deep in ("", "*/", "*/*/") for path in sorted(root.glob(f"{deep}README.md")))
    return [path.as_posix() for path in found if not re.match(r"\.|runs/|build/", path.as_posix())]


def slug(text: str) -> str:
    """A heading as an anchor: lower case, punctuation gone, hyphens for spaces."""
    return re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")


def row_name(text: str) -> str:
    """The first cell of a named row as an anchor: a key keeps its points, an equation its digits."""
    return re.sub(r"[^\w.-]+", "-", text).strip("-")


def plain(inline: Token) -> str:
    """The words of a line without marks."""
    breaks = ("softbreak", "hardbreak")
    return "".join(
        " " if each.type in breaks else each.content for each in inline.children or () if each.type != "image"
    )


@dataclass(frozen=True)
class Page:
    """A page in Markdown by its path from the root.

    source  its origin in words where the path has no file
    """

    path: str
    text: str
    source: str = ""

    @cached_property
    def tokens(self) -> list[Token]:
        """The tokens of the page; headings and named rows have their anchors as ``id``, each once."""
        tokens, taken, named = MARKDOWN.parse(self.text), set(), False
        for at, token in enumerate(tokens):
            if token.type == "heading_open":
                text = plain(tokens[at + 1])
                token.attrSet("id", _free(slug(text), taken))
            elif token.type == "thead_open":
                named = plain(tokens[at + 3]) in NAMED
            elif token.type == "table_close":
                named = False
            elif token.type == "tr_open" and named and tokens[at + 1].type == "td_open":
                token.attrSet("id", _free(row_name(plain(tokens[at + 2])), taken))
        return tokens

    @cached_property
    def anchors(self) -> frozenset[str]:
        """Places of the page that a link may name."""
        return frozenset(str(token.attrs["id"]) for token in self.tokens if "id" in token.attrs)

    @cached_property
    def title(self) -> str:
        """The first heading; empty for a page without one."""
        heads = (
            self.tokens[at + 1] for at, token in enumerate(self.tokens) if token.tag == "h1" and token.nesting == 1
        )
        return next(map(plain, heads), "")

    @property
    def short(self) -> str:
        """The title up to its colon."""
        return self.title.partition(":")[0]

    @property
    def url(self) -> str:
        """Its place in the site: README.md is the index of its folder."""
        return url_of(self.path)

    def targets(self) -> Iterator[str]:
        """Targets of its links as they are written, in their order."""
        for token in self.tokens:
            yield from (str(each.attrs["href"]) for each in token.children or () if each.type == "link_open")

    def resolved(self, target: str) -> tuple[str, str]:
        """(path from the root, anchor) of a target; a folder is its README.md."""
        path, _, anchor = target.partition("#")
        there = posixpath.normpath(posixpath.join(posixpath.dirname(self.path), path)) if path else self.path
        return there, anchor


def _free(name: str, taken: set[str]) -> str:
    """A name that is not taken, and from now on is."""
    found = next(each for each in chain([name], (f"{name}-{at}" for at in count(1))) if each not in taken)
    taken.add(found)
    return found


def url_of(path: str) -> str:
    """The file of the site that shows a file of the project; folders have no leading point there."""
    stem = re.sub(r"(^|/)README$", r"\1index", path.removesuffix(".md"))
    return re.sub(r"(^|/)\.(?=\w)", r"\1", f"{stem}.html")


def is_outside(target: str) -> bool:
    """Whether a link leads to the network."""
    return "://" in target or target.startswith("mailto:")


def ordered(root: Path, made: dict[str, Page]) -> list[list[Page]]:
    """All pages of the site in groups: the front page alone, then a group a folder, each with its README.md first.

    ``made``  pages without a file, by path: they follow the first page of their group

    A page belongs to the site if it is a README.md or if a page of the site links to it. Groups stand as the table at the
    end of the front page has them, pages of a group as its first page links to them, and then as the others do.
    """
    found: dict[str, Page] = {}

    def read(path: str) -> None:
        if path in found or path in made or not (root / path).is_file():
            return
        text = (root / path).read_text(encoding="utf-8")
        if "fracflow/equations.md" in made:
            text = re.sub(f"{BEGIN}.*?{END}", "[The index](equations.md) has a page of its own.", text, flags=re.DOTALL)
        found[path] = page = Page(path, text)
        for target in page.targets():
            there = page.resolved(target)[0]
            if not is_outside(target) and there.endswith(".md"):
                read(there)

    for path in readmes(root):
        read(path)
    front = found.pop("README.md")
    by_front = places(_linked(front), last=True)
    groups: dict[str, list[Page]] = {}
    for page in found.values():
        groups.setdefault(page.path.partition("/")[0], []).append(page)
    for name, group in groups.items():
        head = next((page for page in group if page.path == f"{name}/README.md"), group[0])
        by_head = places(_linked(head), last=False)
        group.sort(key=lambda page: (page is not head, by_head.get(page.path, inf), by_front.get(page.path, inf)))
        group[1:1] = [page for path, page in made.items() if path.partition("/")[0] == name]
    first = {name: min(by_front.get(page.path, inf) for page in group) for name, group in groups.items()}
    return [[front], *(groups[name] for name in sorted(groups, key=lambda name: (first[name], name)))]


def _linked(page: Page) -> list[str]:
    return [page.resolved(target)[0] for target in page.targets() if not is_outside(target)]


def places(paths: list[str], last: bool) -> dict[str, int]:
    """The place of each path in a row, that of its last mention or that of its first."""
    row = list(enumerate(paths))
    return {path: at for at, path in (row if last else reversed(row))}
