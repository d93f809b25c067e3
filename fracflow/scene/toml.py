"""Scene text: read it, change it by ``--set path.to.key=value``, write it."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from fracflow.errors import InputError
from fracflow.storage.files import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LARGEST = 8 << 20  # bytes of a scene, or of a table beside it: a hundred thousand rows of tables
MOST_DOTS = 2000  # in a value of --set, but for those of plain numbers
DEEPEST = 50  # tables and lists inside each other, or keys joined by dots
_POINT_FIRST = re.compile(r"^([-+]?)\.(?=\d)")  # of a number, which TOML does not take
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_DOT = re.compile(r"(?<!\.)\.(?!\.)")
_PLAIN_NUMBER = re.compile(r"(?<![\w.])\d+\.\d*(?![\d.])")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; raises InputError where there is none, or where it is not TOML, or more than a scene can be."""
    return parse_toml(read_text(path, "give the path of a TOML file", LARGEST), path)


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """The tables of a text as that of a file; raises InputError, naming it, where it is not TOML."""
    for number, line in enumerate(text.split("\n"), 1):
        if _dots(line) > DEEPEST:
            raise InputError(f"{path.name}: line {number}: more than {DEEPEST} dots in a row of keys; shorten the line")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        what = " ".join(str(error).split())
        raise InputError(f"{path.name}: not valid TOML: {what[:300]}{_at_key(text, what)}") from None
    except ValueError:  # Python reads whole numbers of a few thousand digits at most
        raise InputError(f"{path.name}: a number has thousands of digits; write it with an exponent") from None
    except RecursionError:
        data = None
    if data is None or _is_deeper(data, DEEPEST):
        raise InputError(f"{path.name}: not valid TOML: brackets too deep inside each other; close them")
    return data


def _dots(text: str) -> int:
    """Dots of a text that are not those of plain numbers."""
    return len(_DOT.findall(_PLAIN_NUMBER.sub("", text))) if text.count(".") > DEEPEST else 0


def _is_deeper(value: Any, most: int) -> bool:
    """Whether tables and lists lie more than so many deep inside each other."""
    level = [value]
    for _ in range(most):
        level = [
            inner
            for each in level
            for inner in (each.values() if isinstance(each, dict) else each)
            if isinstance(inner, dict | list)
        ]
        if not level:
            return False
    return True


def _at_key(text: str, error: str) -> str:
    """The key at which TOML ends, as it stands there, where its value is a list or a number, and how these are written."""
    if "immutable namespace" in error:
        return ": a table in braces is whole where it ends; write its keys within the braces, or all of them below a [header]"
    line = re.search(r"at line (\d+)", error)
    before = text.splitlines()[: int(line[1])] if line else text.splitlines()
    begun = [words for words in before if re.match(r"\s*[\w.\"'-]+\s*=", words)]
    value = begun[-1].partition("=")[2].lstrip() if begun else ""
    if value.startswith(("[", "(")):
        how = 'commas between, units in quotes, such as the time table [[0, 0], [10, "2 kPa"]] of pairs [time, value]'
    elif value[:1].isdecimal() and "Expected newline" in error:
        how = 'a number with its unit stands in quotes, such as "2 kPa"'
    else:
        return "; correct the line"
    return f" in {_one_line(begun[-1])}: {how}"


def override(data: dict[str, Any], setting: str) -> None:
    """Apply one ``path.to.key=value`` in place; entries of arrays have a name or an index. Raises InputError."""
    path, equals, text = setting.partition("=")
    keys = [key.strip().strip("\"'") for key in re.findall(r'"[^"]*"|\'[^\']*\'|[^.]+', path.strip())]
    if not equals or not keys or not all(keys) or len(keys) > DEEPEST:
        raise InputError(f"--set {_one_line(setting)}: must be path.to.key=value, such as stage.0.time_step=0.1")
    here: Any = data
    for depth, name in enumerate(keys):
        key: Any = name
        if isinstance(here, list):
            key = _index(here, name, ".".join(keys[: depth + 1]), setting)
        elif not isinstance(here, dict):
            where = ".".join(keys[:depth])
            raise InputError(f"--set {_one_line(setting)}: {where} is a value, not a table; name a key of a table")
        if depth == len(keys) - 1:
            here[key] = parse_value(text)
        else:
            here = here[key] if isinstance(here, list) else here.setdefault(key, {})


def parse_value(text: str) -> Any:
    """Read the value of ``--set`` as TOML, or as a number such as .5; what is neither is a string."""
    text = _POINT_FIRST.sub(r"\g<1>0.", text.strip())
    try:
        values = tomllib.loads(f"value = {text}") if _dots(text) < MOST_DOTS else {}
    except (ValueError, RecursionError):  # of no TOML, and of a whole number with thousands of digits
        return text
    return values["value"] if len(values) == 1 and not _is_deeper(values, DEEPEST) else text


def _index(entries: list[Any], key: str, path: str, setting: str) -> int:
    names = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    if key in names:
        return names.index(key)
    if key.isdecimal() and int(key) < len(entries):
        return int(key)
    known = [json.dumps(name, ensure_ascii=False) if name else str(index) for index, name in enumerate(names)]
    allowed = ", ".join(known[:12]) or "none"
    raise InputError(f"--set {_one_line(setting)}: {path}: no such entry; allowed: {allowed}")


def _one_line(text: str) -> str:
    return " ".join(text.split())[:120]


def write_value(value: Any) -> str:
    """Write a value as TOML, tables inline."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float):
        return write_float(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{write_key(key)} = {write_value(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(write_value(entry) for entry in value) + "]"
    return hex(value) if isinstance(value, int) and value.bit_length() > 14000 else str(value)


def write_float(value: float) -> str:
    """Write a float in the shorter of its exact forms: 1e8, not 100000000.0."""
    plain = repr(value)
    if plain in ("nan", "inf", "-inf"):
        return plain
    short = str(Decimal(plain).normalize()).lower().replace("e+", "e")
    return short if "e" in short and not 1e-5 < abs(value) < 1e5 else plain


def write_key(key: str) -> str:
    """Write a key, in quotes where it needs them."""
    return key if _BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False)


def write_toml(data: Mapping[str, Any], path: tuple[str, ...] = ()) -> str:
    """Write tables and arrays of tables under their headings; whatever lies deeper in an array is inline."""
    values = {key: value for key, value in data.items() if not _is_table(value)}
    blocks = [_block(f"[{_dotted(path)}]" if path else "", values)] if values or (path and not data) else []
    for key, value in data.items():
        if isinstance(value, Mapping):
            blocks.append(write_toml(value, (*path, key)))
        elif key not in values:
            blocks.extend(_block(f"[[{_dotted((*path, key))}]]", entry) for entry in value)
    return "\n".join(blocks)


def _block(heading: str, values: Mapping[str, Any]) -> str:
    lines = [f"{write_key(key)} = {write_value(value)}" for key, value in values.items()]
    return "\n".join([heading, *lines] if heading else lines) + "\n"


def _dotted(path: tuple[str, ...]) -> str:
    return ".".join(map(write_key, path))


def _is_table(value: Any) -> bool:
    entries = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(part, Mapping) for part in value)
    return isinstance(value, Mapping) or entries
