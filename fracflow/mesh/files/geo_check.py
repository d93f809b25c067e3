"""A .geo is a program: before Gmsh runs it, it is read through a list of statements that only make geometry.

Gmsh never sees the file itself. Gmsh reads only the checked statements, written anew from their tokens, line by line. Comments
are left out and included files are inserted. So nothing turns on how Gmsh reads what is unclear.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from fracflow.errors import InputError
from fracflow.mesh.files import geo_words as words
from fracflow.mesh.files.geo_depth import DEEPEST, REMEDY, Checked, Unit, check_depths
from fracflow.mesh.files.geo_tokens import Token, Unclear, cut, written
from fracflow.storage.files import read_bytes

LARGEST = 16 << 20  # bytes of a file
MOST_FILES = 100
MOST_TILDES = 8
MOST_NAMES = 200  # in a list of groups
MOST_ENTRIES = 1e7  # of a list
OPENING, CLOSING = {"(": ")", "[": "]", "{": "}"}, frozenset(")]}")
ASSIGNING = frozenset(("=", "+=", "-=", "*=", "/="))
COUNTING = frozenset(("++", "--"))
FORMAT = re.compile(r"(?:[^%]|%[-+ 0]?\d{0,2}(?:\.\d{1,2})?[eEfFgG])*")
LONGEST_FORMAT, LONGEST_STEM = 120, 60
MOST_ROUNDS = 10**6  # of a loop between plain numbers
HAVE_FIELD = ("Delete", "Background", "BoundaryLayer")
END = Token("end", "", 0, 0, "")


def check_geo(path: Path, root: Path | None = None) -> Checked:
    """Read a .geo and all it includes, from the folder ``root`` and those in it; by default the folder of the file.

    Raises InputError that names file, line and statement for whatever is not on the list.
    """
    found = Checked()
    _add(found, path, _real(root or path.parent), ())
    check_depths(found.units, path)
    return found


def _add(found: Checked, path: Path, root: Path, above: tuple[Path, ...]) -> str:
    """Check a file unless that was done; the name that Gmsh is given for it."""
    place = _real(path)
    for name, source in found.sources.items():
        if _real(source) == place:
            return name
    if len(found.sources) >= MOST_FILES:
        raise InputError(f"{path}: is more than the {MOST_FILES} files that a geometry may be made of; join some")
    stem = re.sub(r"[^A-Za-z0-9_-]", "_", path.stem)[:LONGEST_STEM]
    name = f"{len(found.sources)}-{stem}.geo"
    found.sources[name], found.texts[name] = path, ""
    text = read_bytes(path, "mesh.file names a Gmsh geometry", LARGEST).decode("utf-8", "surrogateescape")
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")
    try:
        file = _File(found, name, path, root, text, (*above, place))
        file.check()
    except Unclear as error:
        raise InputError(f"{path}: line {error.line}: {error.why}; {REMEDY}") from None
    found.texts[name] = written(file.tokens)
    lines = sorted({token.line for token in file.tokens if token.value == "%" and token.kind == "mark"})
    found.remainders += [f"{path}: line {line}" for line in lines]
    return name


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))  # links that go round are an error of who opens the file


class _File:
    """A file while it is checked: its tokens, where it stands in them, and the blocks it stands in."""

    def __init__(self, found: Checked, name: str, path: Path, root: Path, text: str, above: tuple[Path, ...]) -> None:
        self.found, self.path, self.root, self.text, self.above = found, path, root, text, above
        self.tokens = cut(text)
        self.at = 0
        self.blocks: list[str] = []
        self.own = self.unit = found.units.setdefault(name, Unit())

    def check(self) -> None:
        """Go through all statements. Raises Unclear and InputError."""
        while self.at < len(self.tokens):
            head = self.tokens[self.at]
            if self._value(self.at) in words.BLOCKS:
                self._block(head)
            else:
                self._statement(head)
        if self.blocks:
            raise Unclear(self.tokens[-1].line, f"the file ends inside of {self.blocks[-1]}")

    # Blocks

    def _block(self, head: Token) -> None:
        first, kind = self.at, head.value
        if kind in ("If", "ElseIf"):
            self.at = self._matching(first + 1, "(") + 1
        elif kind == "For":
            is_named = self._is_word(first + 1) and self._value(first + 2) == "In"
            start = first + 3 if is_named else first + 1
            self.at = self._matching(start, "{" if is_named else "(") + 1
            self._bounded(first, start + 1, self.at - 1)
        elif kind in ("Macro", "Function"):
            if not self._is_word(first + 1) or self.blocks:
                raise self._refusal(first, first + 1, "a macro has a name and lies in no other block")
            self.at = first + 2
        else:
            self.at = first + 1
        self._words(first + 1, self.at)
        self._texts(first, self.at - 1)
        if kind not in ("If", "ElseIf", "Else", "EndIf"):
            self._ends_its_line(first, self.at)
        self._nest(kind, first)

    def _bounded(self, first: int, start: int, after: int) -> None:
        """Refuse a loop between plain numbers, from ``start`` to before ``after``, that Gmsh would be in for hours."""
        words = ["a word" if token.kind == "word" else token.shown for token in self.tokens[start:after]]  # inf is one
        texts = "".join(words).split(":")
        try:
            low, high, *steps = (float(text) for text in texts)
        except ValueError:
            return  # expressions: Gmsh's time is limited
        step = steps[0] if steps else 1.0
        if not ((high - low) * step < 0.0 or abs(high - low) <= MOST_ROUNDS * abs(step)):  # it has none the wrong way
            raise self._refusal(first, after, f"a loop of more than {MOST_ROUNDS} rounds; give closer bounds")

    def _nest(self, kind: str, first: int) -> None:
        """Keep the blocks that are open; each end must be that of the innermost one."""
        if kind in ("If", "For"):
            self.blocks.append(kind)
            self.unit.deepest = max(self.unit.deepest, len(self.blocks))
        elif kind in ("Macro", "Function"):
            name = f"macro:{self._value(first + 1)}"
            if name in self.found.units:
                raise self._refusal(first, self.at - 1, "a second macro of that name")
            self.blocks.append("Macro")
            self.unit = self.found.units[name] = Unit(deepest=1)
        else:
            opened = self.blocks[-1] if self.blocks else ""
            fits = {"EndFor": ("For",), "Return": ("Macro",), "Else": ("If",), "ElseIf": ("If",)}
            if opened not in fits.get(kind, ("If", "Else")):
                raise self._refusal(first, first, "no block that is open ends so")
            if kind == "Else":
                self.blocks[-1] = "Else"
            elif kind != "ElseIf":
                self.blocks.pop()
            if kind == "Return":
                self.unit = self.own

    def _ends_its_line(self, first: int, after: int) -> None:
        """Gmsh goes on with the line after a loop's or macro's head or end, whatever else is on that line."""
        if after < len(self.tokens) and self.tokens[after].line == self.tokens[after - 1].line:
            raise self._refusal(first, after, "Gmsh may skip the rest of the line, put it on a line of its own")

    # Statements

    def _statement(self, head: Token) -> None:
        first = self.at
        if self._value(first) == ";":
            self.at += 1
            return
        last = self._end(first)
        self.at = last + 1
        if head.kind != "word":
            raise self._refusal(first, last)
        if head.value == "Include":
            self._include(first, last)
        elif head.value == "Call":
            if last != first + 2 or not self._is_word(first + 1):
                raise self._refusal(first, last, "Call takes the name of a macro")
            self.unit.goes_to.append((len(self.blocks), f"macro:{self._value(first + 1)}"))
            self._words(first + 1, last)
            self._ends_its_line(first, last + 1)
        elif head.value == "General" and self._value(first + 1) == ".":
            self._pass_over(first, last)
        else:
            self._words(first, last + 1)
            self._texts(first, last)
            if head.value in words.HEADS:
                self._keyword(head.value, first, last)
            else:
                self._assignment(first, last)

    def _pass_over(self, first: int, last: int) -> None:
        """Leave out an option of the window, as ``General.Color.Background = White;``: whatever its value is."""
        at = first + 1
        while self._value(at) == "." and self._is_word(at + 1):
            at += 2
        name = "".join(token.value for token in self.tokens[first + 2 : at])
        is_set = self._value(at) in ASSIGNING | COUNTING and self._value(last) == ";"
        if not words.WINDOW.fullmatch(name) or not is_set:
            raise self._refusal(first, last)
        self.found.passed.append(f"General.{name}")
        for token in self.tokens[first : last + 1]:
            token.shown = ""

    def _include(self, first: int, last: int) -> None:
        token = self._token(first + 1 if last == first + 2 else first)
        name = token.value
        if token.kind != "text" or not name or name[0] in "/~" or ":" in name:
            raise self._refusal(first, last, "Include takes the name of a file in the scene's folder")
        path = self.path.parent / name
        if self.root not in _real(path).parents:
            raise self._refusal(first, last, f"the file lies outside of the folder {self.root}")
        if not path.exists():
            raise InputError(
                f"{self.path}: line {token.line}: {self._shown(first, last)}: no such file; correct the name"
            )
        if _real(path) in self.above or len(self.above) > DEEPEST:
            raise self._refusal(first, last, "the file includes itself")
        given = _add(self.found, path, self.root, self.above)
        token.shown = f' "{given}" '
        self.unit.goes_to.append((len(self.blocks), given))
        self._ends_its_line(first, last + 1)

    def _keyword(self, head: str, first: int, last: int) -> None:
        """A statement that begins with a keyword of geometry."""
        after = self._value(first + 1)
        if after in ("(", "[", *ASSIGNING, *COUNTING) and not (
            (after == "(" and head in words.PLACED) or (after == "[" and head in ("DefineConstant", "Field"))
        ):
            raise self._refusal(first, last)
        if head == "Field":
            self._field(first, last)
        elif head in words.SAYING:
            self._saying(first, last)
        elif head == "Delete":
            if after not in ("{", "Field", "Embedded", "Physicals", "Meshes"):
                raise self._refusal(first, last)
        elif head == "SetFactory" and (last != first + 4 or self._token(first + 2).value not in words.FACTORIES):
            raise self._refusal(first, last)

    def _assignment(self, first: int, last: int) -> None:
        """A statement that begins with a name: a variable, an option of numbers, a field that rules, shapes in braces."""
        name, at = self._value(first), first + 1
        while self._value(at) == "~":
            at = self._matching(at + 1, "{") + 1
        mark = self._value(at)
        if name in words.OPTIONS and mark == ".":
            self._option(first, last)
        elif name == "Mesh" and self._token(at).kind == "number" and last == at + 1:
            return
        elif name in HAVE_FIELD and mark == "Field" and self._value(at + 1) == "=":
            return
        elif name in words.ACTIONS and mark == "{":
            return
        elif mark in OPENING and mark != "{":
            end = self._matching(at, mark)
            if self._value(end + 1) not in ASSIGNING and not (
                self._value(end + 1) in COUNTING and end > at + 1 and end + 2 == last
            ):
                raise self._refusal(first, last)
            if end > at + 1:
                self._guard(at, end, last)
        elif mark not in ASSIGNING and not (mark in COUNTING and at + 1 == last):
            raise self._refusal(first, last)

    def _option(self, first: int, last: int) -> None:
        is_color = self._value(first + 2) == "Color" and self._value(first + 3) == "."
        at = first + 5 if is_color else first + 3
        if not self._is_word(at - 1) or self._value(at) not in ASSIGNING | COUNTING:
            raise self._refusal(first, last)

    def _guard(self, opening: int, closing: int, last: int) -> None:
        """Let Gmsh report a place before or far behind a list; left alone, it writes to memory that is not its own."""
        inner = self.tokens[opening + 1 : closing]
        if len(inner) == 1 and inner[0].kind == "number" and float(inner[0].value) < MOST_ENTRIES:
            return
        if any(token.value in COUNTING or token.value in ("{", "}") or token.kind == "text" for token in inner):
            raise self._refusal(opening - 1, last, "the place in a list must be one number that stays as it is")
        place = " ".join(token.shown for token in inner)
        self.tokens[opening].shown += " Min(Max(0, "
        self.tokens[closing].shown = (
            f"), {MOST_ENTRIES:.0f}) + 0/(({place}) > -1 && ({place}) < {MOST_ENTRIES:.0f})"
            + self.tokens[closing].shown
        )

    def _field(self, first: int, last: int) -> None:
        """``Field[i] = KIND;`` of a kind that reads no file, or ``Field[i].NAME = value;``."""
        end = self._matching(first + 1, "[") + 1
        if self._value(end) == ".":
            if not self._is_word(end + 1) or self._value(end + 2) != "=":
                raise self._refusal(first, last)
        elif self._value(end) != "=" or last != end + 2 or self._value(end + 1) not in words.FIELDS:
            raise self._refusal(first, last, "no kind of field that reads no file")

    def _saying(self, first: int, last: int) -> None:
        """``Printf("text", numbers);`` and nothing behind the bracket, where Gmsh has names of files."""
        if self._matching(first + 1, "(") + 1 != last or self._token(first + 2).kind != "text":
            raise self._refusal(first, last)

    # The form of every statement

    def _words(self, first: int, after: int) -> None:
        """Refuse words that are on no list, and marks that stand where only other statements have them."""
        for at in range(first, after):
            value, before = self._value(at), self._value(at - 1) if at > first else ""
            if value in words.REFUSED or value in words.BLOCKS or value in ("Include", "Call"):
                raise self._refusal(first, after - 1, f"{value} is not read")
            if value == "Field" and first < at and not (at == first + 1 and self._value(first) in HAVE_FIELD):
                raise self._refusal(first, after - 1, "Field stands at the beginning of a statement")
            is_option = before in words.OPTIONS | {"Color"} or (self._value(first) == "Field" and before == "]")
            if (
                value == "::"
                or (value == "." and not is_option)
                or (value in COUNTING and before in CLOSING and not self._counts_up(first, at))
                or (value == "~" and self._tildes(at, first) > MOST_TILDES)
            ):
                raise self._refusal(first, after - 1, f"{value} cannot stand there")

    def _follows_place(self, at: int) -> bool:
        """Whether a mark follows a place in a list, as in ``x[3] = 1``; what follows ``x[]`` is the whole list."""
        return self._value(at - 1) in (")", "]") and self._value(at - 2) not in ("(", "[")

    def _counts_up(self, first: int, at: int) -> bool:
        """Whether the statement that ends at a mark is ``name[place]++;``, whose place is looked at."""
        inside = {self._value(place) for place in range(first, at)}
        return self._value(at + 1) == ";" and not inside & ASSIGNING and self._value(first) not in words.HEADS

    def _tildes(self, at: int, first: int) -> int:
        """How many parts a name has had up to a tilde."""
        count = 1
        while self._value(at - 1) == "}" and at > first:
            depth, at = 1, at - 2
            while depth and at > first:
                depth += {"}": 1, "{": -1}.get(self._value(at), 0)
                at -= 1
            if self._value(at) != "~":
                break
            count += 1
        return count

    def _texts(self, first: int, last: int) -> None:
        """Refuse a text wherever it is not a name for people, a format of numbers, a formula, or stands for all."""
        for at in range(first, last + 1):
            if self.tokens[at].kind == "text" and not self._is_harmless(at, first, last):
                raise self._refusal(first, last, f"the text {self._value(at)} cannot stand there")

    def _is_harmless(self, at: int, first: int, last: int) -> bool:
        """Whether a text stands where Gmsh has neither a file nor a program, and is fit for its place."""
        head, text, before, after = self._value(first), self.tokens[at].value, self._value(at - 1), self._value(at + 1)
        if before in words.NAMES_ALL:
            return text in words.EVERYTHING
        if head in words.SAYING or head == "SetFactory":
            return at == first + 2 and before == "(" and (head == "SetFactory" or self._is_format(at))
        if head == "Field":
            is_made = before == "(" and self._value(at - 2) == "Sprintf"
            equals = at - 3 if is_made else at - 1
            is_formula = words.FORMULA.fullmatch(text.replace("%", ""))
            if not (is_formula and words.FORMULAS.fullmatch(self._value(equals - 1))):
                return False
            if self._value(equals) != "=" or self._value(equals - 2) != ".":
                return False
            if is_made:
                return self._is_format(at) and self._matching(at - 1, "(") == last - 1
            return "%" not in text and at == last - 1
        if before in words.LABELS:
            return after in (",", "}", "]", ")")
        if before == "=" and self._token(at - 2).kind == "number":  # a choice of a constant
            return self._value(at - 3) in ("{", ",") and after in (",", "}")
        if before == "(" and self._value(at - 2) == "Sprintf":
            return self._is_group(at - 2) and self._is_format(at)
        return after in (")", ",", "}") and self._is_group(at)

    def _is_group(self, at: int) -> bool:
        """Whether the name of a physical group stands at a place, in round brackets, or in a list of names in braces."""
        least = at - 2 * MOST_NAMES
        while at > least and self._value(at - 1) == "," and self._token(at - 2).kind == "text":
            at -= 2
        is_physical = self._value(at - 2) in words.ENTITIES and self._value(at - 3) == "Physical"
        return is_physical and self._value(at - 1) in ("(", "{")

    def _is_format(self, at: int) -> bool:
        """Whether a format prints as many numbers as Gmsh has room for; what it would print at any length, it prints short."""
        token, is_alone = self.tokens[at], self._value(at + 1) == ")"
        if len(token.value) > LONGEST_FORMAT or not FORMAT.fullmatch(token.value) or (is_alone and "%" in token.value):
            return False
        token.shown = re.sub(r"(%[^A-Za-z]*)[fF]", r"\1g", token.shown)
        return is_alone or self._value(at + 1) == ","

    # Looking around

    def _value(self, at: int) -> str:
        """A token as the file has it; a text in quotes is never taken for a word or mark."""
        token = self._token(at)
        return f'"{token.value}"' if token.kind == "text" else token.value

    def _token(self, at: int) -> Token:
        return self.tokens[at] if 0 <= at < len(self.tokens) else END

    def _is_word(self, at: int) -> bool:
        return self._token(at).kind == "word" and self._value(at) not in words.BLOCKS

    def _matching(self, at: int, mark: str) -> int:
        """Where the bracket that opens at a place closes."""
        if self._value(at) != mark:
            raise self._refusal(at - 1, at)
        open_ones = []
        for place in range(at, len(self.tokens)):
            token = self.tokens[place]
            if token.kind != "mark":
                continue
            if token.value in OPENING:
                open_ones.append(token.value)
            elif token.value in CLOSING:
                open_ones.pop()
                if not open_ones:
                    return place
        raise Unclear(self.tokens[at].line, f"a {mark} that is not closed")

    def _end(self, first: int) -> int:
        """The last token of a statement: its semicolon, the brace that ends it, or the last of the file."""
        open_ones, is_braced = "", self._value(first) in words.BRACED
        for at in range(first, len(self.tokens)):
            token = self.tokens[at]
            if token.kind == "word" and token.value in words.BLOCKS:
                raise self._refusal(first, at, f"{token.value} cannot stand inside of a statement")
            if token.kind != "mark":
                continue
            if token.value in OPENING:
                open_ones += token.value
            elif token.value in CLOSING:
                if not open_ones or OPENING[open_ones[-1]] != token.value:
                    raise self._refusal(first, at, "a bracket that is not open")
                open_ones = open_ones[:-1]
            elif token.value == ";" and open_ones[-1:] != "{":
                if open_ones:
                    raise self._refusal(first, at, f"{open_ones[-1]} is not closed")
                return at
            elif open_ones and token.value in ASSIGNING | COUNTING and self._follows_place(at):
                raise self._refusal(first, at, "an entry of a list is set by a statement of its own")
            goes_on = ("{", ";", "Using", "In", "Surface" if self._value(first) == "Intersect" else ";")
            if not open_ones and token.value == "}" and is_braced and self._value(at + 1) not in goes_on:
                return at
        return len(self.tokens) - 1  # of an error that Gmsh reports

    def _known(self, at: int) -> Token:
        return self.tokens[max(0, min(at, len(self.tokens) - 1))]

    def _shown(self, first: int, last: int) -> str:
        start, end = self._known(first), self._known(last)
        said = " ".join(self.text[start.at : end.at + len(end.value) + 2 * (end.kind == "text")].split())
        return said if len(said) <= 60 else said[:57] + "..."

    def _refusal(self, first: int, last: int, why: str = "") -> Unclear:
        why = why or "is not on the list of statements that only make geometry"
        return Unclear(self._known(first).line, f"{self._shown(first, last)}: {why}")
