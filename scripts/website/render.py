"""Pages in Markdown as HTML: links, pictures with captions, code in colours, tables that fit a phone, entries to search."""

from __future__ import annotations

import ast
import html
import posixpath
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from markdown_it.token import Token
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import get_lexer_by_name, get_lexer_for_filename
from pygments.lexers.special import TextLexer
from pygments.util import ClassNotFound
from website.pages import MARKDOWN, BrokenLink, Page, is_outside, plain, url_of

PICTURES = ".png"  # the only kind that the project has
LONG_CELL, SHORT_CELL = (
    34,
    12,
)  # letters: a phone shows the cells of rows below each other if one is long and none is a short name

Entry = tuple[str, str, str, str]  # page, heading, address, text


@dataclass
class Site:
    """The pages with the names that code in lines may have, and the files that links have asked for so far.

    names     text of code -> path#anchor: keys of a scene, commands, names for Python
    pictures  paths of pictures, all PNG
    sources   paths of other files, which are shown as pages
    """

    root: Path
    pages: dict[str, Page]
    names: dict[str, str] = field(default_factory=dict)
    pictures: set[str] = field(default_factory=set)
    sources: set[str] = field(default_factory=set)

    def link(self, page: Page, target: str) -> str:
        """A target of a page as an address from its place in the site. Raises BrokenLink."""
        if is_outside(target):
            return target
        return self.address(page, target, *page.resolved(target))

    def address(self, page: Page, target: str, there: str, anchor: str) -> str:
        """The same of a path from the root, which a target leads to."""
        if (self.root / there).is_dir():
            there = posixpath.normpath(f"{there}/README.md")
        known = self.pages.get(there)
        if known is None and (there.startswith("..") or not (self.root / there).is_file()):
            raise BrokenLink(f"{page.path}: {target}: no such file")
        if known is not None:
            if anchor and anchor not in known.anchors:
                raise BrokenLink(f"{page.path}: {target}: no such heading")
        elif there.endswith(PICTURES):
            self.pictures.add(there)
        else:
            self.sources.add(there)
            if anchor:
                anchor = f"L-{definition_lines(self.root / there)[anchor]}"
        to = there if there.endswith(PICTURES) else url_of(there)
        address = posixpath.relpath(to, posixpath.dirname(page.url) or ".")
        return f"{address}#{anchor}" if anchor else address

    def named(self, page: Page, code: str) -> str:
        """The address of what code in a line names, empty where it names nothing: a key, a command, a file."""
        bare = bare_name(code.partition(" = ")[0])
        in_table = re.sub(r"^(\[?\w+)\.\w+", r"\1.NAME", bare)
        for each in (code, bare, in_table, " ".join(code.split()[:2])):
            if each in self.names:
                there, _, anchor = self.names[each].partition("#")
                return self.address(page, code, there, anchor)
        path, _, name = code.partition("::")
        if re.fullmatch(r"\.?[\w.-]+(/[\w.-]+)+\.(py|md|toml|csv|geo|sh)", path):
            folder = posixpath.dirname(page.path)
            for there in (posixpath.normpath(posixpath.join(base, path)) for base in ("", "fracflow", folder)):
                if (self.root / there).is_file() and not there.startswith(".."):
                    return self.address(page, code, there, name if name in definition_lines(self.root / there) else "")
        return ""


@cache
def definition_lines(path: Path) -> dict[str, int]:
    """The lines at which a module's classes and functions begin, by their qualified names."""
    if path.suffix != ".py":
        return {}

    def walk(node: ast.AST, above: str) -> Iterator[tuple[str, int]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                yield f"{above}{child.name}", child.lineno
                yield from walk(child, f"{above}{child.name}.")

    return dict(walk(ast.parse(path.read_text(encoding="utf-8")), ""))


def names_of(page: Page) -> Iterator[tuple[str, str]]:
    """(code, path#anchor) of the headings and named rows of a reference page; words without a point name nothing."""
    for at, token in enumerate(page.tokens):
        if "id" in token.attrs:
            text = plain(page.tokens[at + (1 if token.type == "heading_open" else 2)])
            if re.search(r"[. \[A-Z]", text) and token.tag != "h1":
                yield bare_name(text), f"{page.path}#{token.attrs['id']}"


def bare_name(code: str) -> str:
    """The name of a key or of a table without the marks of arrays: ``[[well]]`` and ``[well[]]`` are ``[well]``."""
    return re.sub(r"^\[\[(.*)\]\]$", r"[\1]", code.replace("[]", ""))


def body_of(site: Site, page: Page) -> tuple[str, list[Entry]]:
    """The page as HTML, and its entries to search, one a section and one a named row. Raises BrokenLink."""
    tokens = [token.copy() for token in page.tokens]
    entries = list(_entries(page))
    for token in tokens:
        if token.children:
            token.children = list(_inline(site, page, [each.copy() for each in token.children]))
    tokens = list(_tables(_figures(tokens)))
    for at, token in enumerate(tokens):
        if token.type == "heading_open" and token.tag != "h1":
            mark = f'<a class="anchor" href="#{token.attrs["id"]}" aria-label="link to this section">#</a>'
            tokens[at + 1].children = [*(tokens[at + 1].children or ()), _raw(mark)]
        elif token.type == "fence":
            tokens[at] = _raw(coloured(token.content, token.info))
    return MARKDOWN.renderer.render(tokens, MARKDOWN.options, {}), entries


def _raw(text: str) -> Token:
    return Token("html_inline", "", 0, content=text)


def coloured(code: str, info: str) -> str:
    """A block of code in HTML, by its language and the words after it."""
    language, _, words = info.partition(" ")
    try:
        lexer = get_lexer_by_name({"sh": "bash", "": "text"}.get(language, language))
    except ClassNotFound:
        lexer = TextLexer()
    return f'<div class="code {language} {words}">{highlight(code, lexer, HtmlFormatter())}</div>\n'


def source_body(path: str, text: str) -> str:
    """A file of the project as HTML, each line with its number as an anchor."""
    try:
        lexer = get_lexer_for_filename(path)
    except ClassNotFound:
        lexer = TextLexer()
    shown = highlight(text, lexer, HtmlFormatter(linenos="inline", lineanchors="L", anchorlinenos=True))
    return f"<h1><code>{html.escape(path)}</code></h1>\n{shown}"


def _inline(site: Site, page: Page, children: list[Token]) -> Iterator[Token]:
    """A line's tokens, with addresses in the site, and titles in place of names of pages.

    Code that names a key, a command or a file leads there.
    """
    depth = 0
    for at, each in enumerate(children):
        depth += {"link_open": 1, "link_close": -1}.get(each.type, 0)
        if each.type == "link_open":
            there = site.pages.get(page.resolved(str(each.attrs["href"]))[0])
            if there and children[at + 1].content.endswith(".md"):
                children[at + 1].content = there.short
            each.attrs["href"] = site.link(page, str(each.attrs["href"]))
        elif each.type == "image":
            source = str(each.attrs["src"])
            each.attrs |= {"src": site.link(page, source), "loading": "lazy"}
            each.attrs["width"], each.attrs["height"] = size_of(site.root / page.resolved(source)[0])
        to = site.named(page, each.content) if each.type == "code_inline" and not depth else ""
        if to:
            yield _raw(f'<a href="{html.escape(to)}">')
        yield each
        if to:
            yield _raw("</a>")


def size_of(picture: Path) -> tuple[int, int]:
    """Width and height of a PNG, so that a page keeps its place while pictures load."""
    with picture.open("rb") as file:
        width, height = struct.unpack(">16xII", file.read(24))
    return width, height


def _figures(tokens: list[Token]) -> Iterator[Token]:
    """A paragraph that is a picture becomes a figure, and one after it that begins in italics its caption."""
    at = 0
    while at < len(tokens):
        children = [each for each in tokens[at + 1].children or ()] if tokens[at].type == "paragraph_open" else []
        if [each.type for each in children] != ["image"]:
            yield tokens[at]
            at += 1
            continue
        picture = html.escape(str(children[0].attrs["src"]))
        caption: list[Token] = []
        if at + 5 < len(tokens) and tokens[at + 3].type == "paragraph_open":
            inner = tokens[at + 4].children or []
            if inner and inner[0].type == "em_open":
                caption = [_raw("<figcaption>"), tokens[at + 4], _raw("</figcaption>")]
        line = tokens[at + 1]
        yield from (_raw(f'<figure><a href="{picture}">'), line, _raw("</a>"), *caption, _raw("</figure>\n"))
        at += 6 if caption else 3


def _tables(tokens: Iterator[Token]) -> Iterator[Token]:
    """Each table in a box that scrolls; where cells are long a phone shows the cells of a row below each other."""
    table: list[Token] = []
    for token in tokens:
        if token.type == "table_open" or table:
            table.append(token)
        if token.type == "table_close":
            yield from _table(table)
            table = []
        elif not table:
            yield token


def _table(table: list[Token]) -> Iterator[Token]:
    cells = [at + 1 for at, token in enumerate(table) if token.type == "td_open"]
    heads = [plain(table[at + 1]) for at, token in enumerate(table) if token.type == "th_open"]
    longest = [
        max((len(plain(table[at])) for at in cells[column :: len(heads)]), default=0) for column in range(len(heads))
    ]
    is_long = max(longest) > LONG_CELL and (len(heads) > 2 or longest[0] > SHORT_CELL)
    for count, at in enumerate(cells):
        table[at - 1].attrSet("data-head", heads[count % len(heads)])
    yield _raw(f'<div class="rows {"wide" if is_long else "small"}">')
    for at, token in enumerate(table):
        is_full = at in cells and plain(token)
        yield from (_raw("<div>"), token, _raw("</div>")) if is_full else (token,)
    yield _raw("</div>\n")


def _entries(page: Page) -> Iterator[Entry]:
    """(title, heading, address, text) of each section and named row."""
    head, address, texts = page.short, page.url, []
    row: list[str] | None = None
    place = ""
    for at, token in enumerate(page.tokens):
        before = page.tokens[at - 1] if at else None
        if token.type == "heading_open" and token.tag != "h1":
            yield page.short, head, address, " ".join(texts)
            head, address, texts = plain(page.tokens[at + 1]), f"{page.url}#{token.attrs['id']}", []
        elif token.type == "tr_open" and "id" in token.attrs:
            row, place = [], f"{page.url}#{token.attrs['id']}"
        elif token.type == "tr_close" and row is not None:
            yield page.short, row[0], place, " · ".join(filter(None, row[1:]))
            row = None
        elif token.type == "inline" and not (before and before.type == "heading_open"):
            (texts if row is None else row).append(plain(token))
        elif token.type == "fence":
            texts.append(token.content)
    yield page.short, head, address, " ".join(texts)
