"""A .geo cut into tokens, more strictly than Gmsh's own lexer cuts it: what is unclear is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass

from fracflow.mesh.files.geo_words import BLOCKS

LONGEST_NAME = 60  # Gmsh prints names into buffers of fixed size
LONGEST_TEXT = 200
MOST_TOKENS = 2_000_000
SCAN = re.compile(
    r"""(?P<space>[ \t\f\n]+)
      | (?P<comment>//[^\n]*|/\*.*?\*/)
      | (?P<text>"[^"\n]*"|'[^'\n]*')
      | (?P<number>(?:\d+\.\d*|\.\d+|\d+)(?:[Ee][-+]?\d+)?)
      | (?P<word>[A-Za-z_][A-Za-z_0-9]*)
      | (?P<mark>\.\.\.|::|[-+*/]=|\+\+|--|==|!=|<=|>=|<<|>>|\|\||&&|[-+*/=<>|&!?:;,.(){}\[\]\#~^%])""",
    re.VERBOSE | re.DOTALL | re.ASCII,
)
# Gmsh looks for these words letter by letter where it leaves a part of a file out.
HIDDEN = re.compile(rf"(?<![A-Za-z_])(?:{'|'.join(sorted(BLOCKS))})(?![A-Za-z_])")


@dataclass(slots=True)
class Token:
    """A piece of a file: ``kind`` is "text", "number", "word" or "mark"; ``shown`` is given to Gmsh in its place."""

    kind: str
    value: str
    line: int
    at: int
    shown: str


class Unclear(Exception):
    """A place in a file that cannot be read as Gmsh's language: a line and why."""

    def __init__(self, line: int, why: str) -> None:
        """Keep both."""
        super().__init__(why)
        self.line, self.why = line, why


def cut(text: str) -> list[Token]:
    """The tokens of a file, comments left out. Raises Unclear."""
    if "\r" in text:
        raise Unclear(text[: text.index("\r")].count("\n") + 1, "a line end that is neither Unix's nor that of Windows")
    tokens: list[Token] = []
    at, line = 0, 1
    while at < len(text):
        found = SCAN.match(text, at)
        if found is None or (text.startswith("/*", at) and found.lastgroup != "comment"):
            raise Unclear(line, _why(text, at))
        kind, value = str(found.lastgroup), found.group()
        if len(tokens) > MOST_TOKENS:
            raise Unclear(line, f"more than {MOST_TOKENS} words, numbers and marks")
        if kind not in ("space", "comment"):
            tokens.append(_token(kind, value, line, at, text[found.end() : found.end() + 1]))
        line += value.count("\n")
        at = found.end()
    return tokens


def _why(text: str, at: int) -> str:
    if text.startswith("/*", at):
        return "a comment that does not end"
    if text[at] in "\"'":
        return "a text that does not end on its line"
    return f"the character {text[at]!a}, which Gmsh's language does not have"


def _token(kind: str, value: str, line: int, at: int, after: str) -> Token:
    if kind == "number" and re.match("[A-Za-z_0-9.]", after):
        raise Unclear(line, f"{value[:20]}{after}: a number and a word without a space between them")
    is_hidden = kind == "word" and value not in BLOCKS and HIDDEN.search(value)
    if kind != "text" and (len(value) > LONGEST_NAME or is_hidden):
        raise Unclear(line, f"{value[:LONGEST_NAME]}: a name that Gmsh may misread")
    if kind != "text":
        return Token(kind, value, line, at, value)
    inner = value[1:-1]
    if len(inner) > LONGEST_TEXT or HIDDEN.search(inner) or re.search('[\\x00-\\x1f\\x7f"\\\\]', inner):
        raise Unclear(line, f"{value[:LONGEST_NAME]}: a text that Gmsh may misread")
    return Token(kind, inner, line, at, f' "{inner}" ')


def written(tokens: list[Token]) -> str:
    """The tokens as Gmsh is given them, each on its own line of the file."""
    parts, line, end = [], 1, 0
    for token in tokens:
        parts.append("\n" * (token.line - line) if token.line > line else " " if token.at > end else "")
        parts.append(token.shown)
        line, end = token.line, token.at + len(token.value)
    return "".join(parts) + "\n"
