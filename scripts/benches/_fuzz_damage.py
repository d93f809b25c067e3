"""Damage of texts and bytes that any file may suffer, and values that no scene should hold."""

from __future__ import annotations

import datetime
import random
import re
from collections.abc import Callable

NUMBERS = (
    "0", "-1", "1e308", "-1e308", "nan", "inf", "-inf", "1e-320", "1e999", "99999999", "2147483648", "-2147483649",
    "4294967296", "9223372036854775807", "-9223372036854775808", "18446744073709551616", "1" + "0" * 400, "0.5",
    "1e-300", "0x7fffffff", "1_000", "1,5", "x", "",
)  # fmt: skip
LISTS = (
    [], {}, [[]], [{}], [1], [1, 2], [1, 2, 3], [1, 2, 3, 4, 5], [[0, 0], [1, 1]], [[0, 0], [0, 1]], [[1, 0], [0, 1]],
    [[0, "x"]], [[0, float("nan")], [1, 0]], [[0, 0] for _ in range(500)], [[0, 1e308], [1, -1e308]], [[0, 0, 0], [1, 1, 1]],
    {"along": [0, 1], "value": [1, 2]}, {"along": [], "value": []}, {"along": [0, 0], "value": [1, 1]},
    {"along": [0, 1], "time": [0, 1], "value": [[1, 2], [3]]}, {"time": [0, 1], "value": [1, 2]},
    {"time": ["0 d", "10 d"], "value": ["4 MPa", "12 MPa"]}, {"time": 1, "value": "x"}, {"x": {"x": {"x": {"x": 1}}}},
    {"fracture": "fault", "end": "start"}, {"fracture": 1, "end": []}, {"x": 1}, {"name": "a"}, {"name": ["a"]},
)  # fmt: skip
SINGLE = (
    0, 1, -1, 2, 7, 0.0, -0.0, 0.5, 1e308, -1e308, 1e-320, 1e-300, 1e100, 1e99, 1e30, 1e9, 1e-9, float("nan"),
    float("inf"),
    float("-inf"), 2**31, 2**63, 2**64, 2**200, -(2**63), 10**400, True, False, datetime.date(1979, 5, 27),
    datetime.time(7, 32), datetime.datetime(1979, 5, 27, 7, 32, tzinfo=datetime.timezone.utc),
)  # fmt: skip
WORDS = (
    "", " ", "a", "\u202eabc", "\x00x", "\n", "a\nb", "\t", "\x1b[31mred", "x" * 5000, "☃", "ﬁ", "\ufeff", "\u2028",
    "🪨" * 40,
    "1 Pa", "-1 mm", "1e999 m", "nan m", "inf s", "1 m/s", "5 %", "1,0 m", "1e-400 m", "0x10 m", "1 m m", "m",
    "1 furlong",
    "1 m**1000000", "1 (((((m)))))", "1 m^2^2", "9" * 300 + " m", "1 __import__", "1 degC", "1 kg m", "1 µm", "1 Å",
    "../../etc/passwd", "/etc/passwd", "/dev/zero", "/dev/stdin", "~", "$HOME", "`id`", "$(touch hit)", "; touch hit",
    "default", "rock", "fault", "west", "initial", "initial-stress", "..", ".", "a/b", "a/../b", "a\\b", "con", "-o",
    "--help",
    "[bold]x[/]", "{x}", "%s%n", "ascii:hit", "python", "1 mm", "30 GPa", "10 ms", "1 L/s", "9.81 kN/m^3",
    "1e-3 Pa s", "0 m",
    "-5 MPa", "1e20 s", "5 d", "1 ft", "1 m^3/s", "100 ft^3/s",
)  # fmt: skip
JUNK = b"[]{}\"'=.,#\n\r\t\x00\xff\x80\x1b0123456789eE+-naif $;()*/\\"
PIECES = (
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\r\n",
    b"\r",
    b"\x00",
    b"\xc3",
    b"\xe2\x80\xa8",
    b'"""',
    b"'''",
    b"\x1b[2J",
    b"\n" * 3,
)

Damage = Callable[[random.Random, bytes], bytes]


def value(r: random.Random) -> object:
    """Draw a value that a key hardly expects."""
    kind = r.random()
    return r.choice(LISTS) if kind < 0.25 else r.choice(WORDS) if kind < 0.6 else r.choice(SINGLE)


def place(r: random.Random, count: int) -> int:
    """A place among ``count``; every other time near the beginning, where formats say what follows."""
    return min(int(r.random() ** 6 * count) if r.random() < 0.5 else r.randrange(count), count - 1)


def flipped(r: random.Random, data: bytes) -> bytes:
    """Some bits turned over."""
    found = bytearray(data)
    for _ in range(r.choice((1, 1, 2, 5, 20))):
        found[place(r, len(found))] ^= 1 << r.randrange(8)
    return bytes(found)


def overwritten(r: random.Random, data: bytes) -> bytes:
    """Some bytes replaced by others that mean something to most parsers."""
    found = bytearray(data)
    for _ in range(r.choice((1, 1, 2, 5, 20))):
        found[place(r, len(found))] = r.choice(JUNK)
    return bytes(found)


def cut(r: random.Random, data: bytes) -> bytes:
    """The file left by a copy that was broken off."""
    return data[: r.randrange(len(data))]


def lost(r: random.Random, data: bytes) -> bytes:
    """A block inside is gone."""
    at = place(r, len(data))
    return data[:at] + data[at + r.choice((1, 4, 16, 512)) :]


def blanked(r: random.Random, data: bytes) -> bytes:
    """A block inside became zeros or ones, as bad sectors do."""
    at, size = place(r, len(data)), r.choice((1, 8, 64, 512, 4096))
    size = min(size, len(data) - at)
    return data[:at] + r.choice((b"\x00", b"\xff")) * size + data[at + size :]


def doubled(r: random.Random, data: bytes) -> bytes:
    """A block inside stands twice."""
    at, size = place(r, len(data)), r.choice((1, 8, 64, 512))
    return data[: at + size] + data[at:]


def inserted(r: random.Random, data: bytes) -> bytes:
    """Bytes that no text expects somewhere inside."""
    at = place(r, len(data))
    return data[:at] + r.choice(PIECES) + data[at:]


def replaced(r: random.Random, data: bytes) -> bytes:
    """All is gone, or is of another kind."""
    return r.choice(
        (b"", b"\n", b"\x00" * 100, b"\x89HDF\r\n\x1a\n", bytes(range(256)) * 4, b"{}", b"[]", b"null", data * 2)
    )


def numbers(r: random.Random, data: bytes) -> bytes:
    """Some numbers of a text replaced."""
    spans = [match.span() for match in re.finditer(rb"-?\d[\d.]*(?:[eE][-+]?\d+)?", data)]
    for start, end in sorted(r.sample(spans, min(len(spans), r.choice((1, 1, 2, 4)))), reverse=True):
        data = data[:start] + r.choice(NUMBERS).encode() + data[end:]
    return data


def lines(r: random.Random, data: bytes) -> bytes:
    """Lines left out, doubled, swapped, moved or joined."""
    found = data.split(b"\n")
    for _ in range(r.choice((1, 1, 2, 4))):
        here, there = r.randrange(len(found)), r.randrange(len(found))
        what = r.randrange(5)
        if what == 0 and len(found) > 1:
            del found[here]
        elif what == 1:
            found.insert(there, found[here])
        elif what == 2:
            found[here], found[there] = found[there], found[here]
        elif what == 3:
            found[here : here + r.choice((2, 3, 20))] = []
            found = found or [b""]
        else:
            found[here : here + 2] = [b"".join(found[here : here + 2])]
    return b"\n".join(found)


BYTES: tuple[Damage, ...] = (flipped, overwritten, cut, lost, blanked, doubled, inserted, replaced)
TEXT: tuple[Damage, ...] = (numbers, numbers, lines, lines, *BYTES)


def damaged(r: random.Random, data: bytes, ways: tuple[Damage, ...]) -> tuple[bytes, str]:
    """Damaged in one or several of the ways, and their names."""
    names = []
    for _ in range(r.choice((1, 1, 1, 2, 3))):
        way = r.choice(ways)
        if data:
            data = way(r, data)
            names.append(way.__name__)
    return data, "+".join(names)
