"""Scenes and tables of traces out of order: keys, values, structure and text, grown from the scenes of ``meshes``."""

from __future__ import annotations

import copy
import json
import random
import re
import string
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import _fuzz_damage as damage

from fracflow.scene.scene import Scene
from fracflow.scene.toml import tomllib, write_toml

MESHES = Path(__file__).parents[2] / "meshes"
Key = str | int
STEPS = 3  # that a stage of a scene to be run takes at most
CELLS = 800.0  # that a scene to be meshed asks for at most
TABLES = {
    "rock": "Rock", "fracture": "Fracture", "stage": "Stage", "well": "Well", "load": "Load", "support": "Support",
    "probe": "Probe", "tie": "Tie", "absorbing": "Absorbing", "control": "Control", "method": "Method", "mesh": "Mesh",
    "accuracy": "Accuracy", "output": "Output", "geometry": "Geometry", "fluid": "Fluid", "initial": "Initial",
    "initial_stress": "InitialStress", "body_force": "BodyForce",
}  # fmt: skip
SETTINGS = (
    "stage.0.steps=3", "a", "=", "a=b=c", "method.coupling=condensed", "fracture.default.aperture=1e-9", "units=[[",
    "geometry.fractures_csv=/etc/passwd", "well..x=1", "stage.-1.steps=2", 'probe.0.name="\\u0000"', "stage.0=3", "=1",
    "petsc.x=[]", "geometry=3", "title.x.y=1", "\u202e=1", "x=" + "[" * 3000, '"a.b".c=1', "rock.rock.density=nan",
    "stage.99999999999999999999.steps=1", "output.pictures=1", "stage.\u0661.steps=1", "stage.0.time_step=1e-320 s",
)  # fmt: skip
TRACES = b"""name,x,y
Anna,200,120
Anna,340,320
Anna,830,530
Bruno,430,680
Bruno,640,200
Clara,600,540
Clara,1000,330
"""
SEGMENTS = b"""name;x1;y1;x2;y2;aperture;cohesion
Anna;200;120;340;320;0.1 mm;
Anna;340;320;830;530;;
Bruno;430;680;640;200;1e-4;2 MPa
"""
FIELDS = (
    "", "x", "1", "-1", "0", "nan", "inf", "1e308", "1e-320", "1,5", "700", "400", "0.1 mm", "-1 mm", "[1]", '"',
    '"a,b"', "x" * 200000,
    "slip-weakening", "\x00", "\u202e", "Anna", "Clara", "default", "=cmd()", "1" * 5000, "north", " ", "\r",
    "{x=1}", "a\tb",
)  # fmt: skip
_SCHEMA: dict[str, Any] = {}
_BASES: list[tuple[Path, dict[str, Any], bytes]] = []


def bases() -> list[tuple[Path, dict[str, Any], bytes]]:
    """Path, data and text of every scene of the repository, read once."""
    if not _BASES:
        for path in sorted(MESHES.rglob("scene.toml")):
            text = path.read_bytes()
            _BASES.append((path, tomllib.loads(text.decode()), text))
    return _BASES


def schema() -> dict[str, Any]:
    """Every key of a scene, made once."""
    if not _SCHEMA:
        _SCHEMA.update(json.loads(json.dumps(Scene.json_schema(), default=str)))
    return _SCHEMA


def at(data: Any, path: tuple[Key, ...]) -> Any:
    """The value at a path."""
    for key in path:
        data = data[key]
    return data


def paths(data: Any, path: tuple[Key, ...] = ()) -> Iterator[tuple[Key, ...]]:
    """Of all values, those inside others too."""
    pairs: Any = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, inside in pairs:
        yield (*path, key)
        yield from paths(inside, (*path, key))


def _put(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    at(data, path[:-1])[path[-1]] = copy.deepcopy(damage.value(r))


def _drop(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    del at(data, path[:-1])[path[-1]]


def _rename(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    parent, key = at(data, path[:-1]), path[-1]
    if isinstance(parent, dict) and isinstance(key, str):
        letters = list(key)
        letters[r.randrange(len(letters))] = r.choice(string.printable + "éß\u202e\x00")
        new = r.choice(("".join(letters), key.upper(), key + " ", r.choice(damage.WORDS), key * 30, "", "name", "x"))
        parent[new] = parent.pop(key)


def _swap(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    other = r.choice(list(paths(data)))
    if path != other[: len(path)] and other != path[: len(other)]:
        here, there = at(data, path), at(data, other)
        at(data, path[:-1])[path[-1]], at(data, other[:-1])[other[-1]] = there, here


def _copy(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    other = r.choice(list(paths(data)))
    at(data, path[:-1])[path[-1]] = copy.deepcopy(at(data, other))


def _scale(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    """A number or a list changed, its kind kept; another unit in the place of its own."""
    old, parent, key = at(data, path), at(data, path[:-1]), path[-1]
    if isinstance(old, int | float) and not isinstance(old, bool):
        parent[key] = r.choice((old * 10.0 ** r.randint(-12, 12), -old, old * r.uniform(0.5, 2.0), 0, old + 1))
    elif isinstance(old, str) and (match := re.match(r"^(-?[\d.]+(?:e-?\d+)?)( .*)$", old)):
        factor = r.choice((-1.0, 0.0, 10.0 ** r.randint(-12, 12), 1e308, r.uniform(0.5, 2.0)))
        unit = (
            match[2] if r.random() < 0.7 else r.choice((" Pa", " m", " s", " kg", "", " furlong", " m/s/s/s", " GPa/m"))
        )
        parent[key] = f"{float(match[1]) * factor:.6g}{unit}"
    elif isinstance(old, list) and old:
        what = r.randrange(5)
        if what == 0:
            old.append(copy.deepcopy(r.choice(old)))
        elif what == 1:
            old.pop(r.randrange(len(old)))
        elif what == 2:
            r.shuffle(old)
        else:
            old[:] = [copy.deepcopy(each) for each in old * r.choice((2, 50))]


def _known(r: random.Random, data: Any, path: tuple[Key, ...]) -> None:
    """A key that its table may have, with a value of its kind or a strange one."""
    tables = [each for each in paths(data) if isinstance(at(data, each), dict)]
    where = r.choice([*tables, ()])
    words = [key for key in where if isinstance(key, str)]
    trace = words[:2] == ["geometry", "fracture"]
    name = "Trace" if trace else TABLES.get(words[0], "") if words else ""
    table = schema()["$defs"].get(name) if where else schema()
    if table is None or "properties" not in table:
        return
    key = r.choice(sorted(table["properties"]))
    if where or key not in ("geometry", "mesh"):
        at(data, where)[key] = _of(r, table["properties"][key])


def _of(r: random.Random, entry: dict[str, Any]) -> Any:
    """A value that a schema allows, or near it."""
    text = json.dumps(entry)
    choices = [word for found in re.findall(r'"enum": (\[[^]]*\])', text) for word in json.loads(found)]
    examples = [word for found in re.findall(r'"examples": (\[[^]]*\])', text) for word in json.loads(found)]
    examples += [0, 1, 2, 7] * ('"integer"' in text) + [True, False] * ('"boolean"' in text)
    examples += [0, 0.5, 1, 2, 1e-3, -0.3, 10] * ('"number"' in text)
    if choices and r.random() < 0.7:
        return r.choice(choices)
    return r.choice(examples) if examples and r.random() < 0.8 else copy.deepcopy(damage.value(r))


WILD = (_put, _put, _put, _drop, _rename, _swap, _copy, _scale, _scale, _known, _known)
MILD = (_scale, _scale, _scale, _known, _known, _copy, _put)


def changed(r: random.Random, data: dict[str, Any], ways: tuple[Any, ...] = WILD) -> str:
    """Change a scene's data in place, in one or several ways; gives their names."""
    names = []
    for _ in range(r.choice((1, 1, 1, 2, 2, 3, 5))):
        way, found = r.choice(ways), list(paths(data))
        if not found:
            break
        try:
            way(r, data, r.choice(found))
        except (KeyError, IndexError, TypeError, AttributeError, OverflowError, ValueError, MemoryError):
            continue  # what it wanted to change is not there any more
        names.append(way.__name__.strip("_"))
    return "+".join(names)


def written(data: dict[str, Any]) -> bytes | None:
    """The text of a scene's data; None where TOML has no way to write it."""
    try:
        return write_toml(data).encode("utf-8", "surrogatepass")
    except (ValueError, ArithmeticError, RecursionError):
        return None


def deep(r: random.Random, data: bytes) -> bytes:
    """Lists, tables and keys far too deep or far too many."""
    many = r.choice((10, 300, 3000))
    head = r.choice((
        b"a = " + b"[" * many, b"a" + b".a" * many + b" = 1\n", b"a = " + b"{a=" * many, b"[" + b"a." * many + b"a]\n",
        b"a = " + b"[" * 90 + b"]" * 90 + b"\n", b"\n".join(b"k%d = 1" % n for n in range(many)) + b"\n", b"[[a]]\n" * many,
        b"title = " + b"1" * many * 2 + b"\n",
    ))  # fmt: skip
    return head + data


TEXT = (*damage.TEXT, deep)


def draw_scene(r: random.Random) -> tuple[Path, bytes, bytes, str]:
    """Where a scene comes from, its text, its text out of order, and how that was made."""
    path, data, text = r.choice(bases())
    if r.random() < 0.65:
        data = copy.deepcopy(data)
        how = changed(r, data)
        new = written(data)
        if new is not None:
            return path, written(copy.deepcopy(at_path(path))) or text, new, how
    new, how = damage.damaged(r, text, TEXT)
    return path, text, new, how


def at_path(path: Path) -> dict[str, Any]:
    """The data of the scene that was read from a path."""
    return next(data for where, data, _ in bases() if where == path)


def _field(r: random.Random, data: bytes) -> bytes:
    """Fields of a table replaced, added or left out."""
    rows = data.decode("utf-8", "replace").split("\n")
    mark = max(",;\t", key=rows[0].count)
    for _ in range(r.choice((1, 1, 2, 4))):
        at_row = r.randrange(len(rows))
        words = rows[at_row].split(mark)
        here, what = r.randrange(len(words)), r.random()
        if what < 0.7:
            words[here] = r.choice(FIELDS)
        elif what < 0.85:
            words.insert(here, r.choice(FIELDS))
        elif len(words) > 1:
            del words[here]
        rows[at_row] = mark.join(words)
    return "\n".join(rows).encode("utf-8", "surrogatepass")


def _column(r: random.Random, data: bytes) -> bytes:
    """A column more, of a property or of none."""
    names = [*schema()["$defs"]["Fracture"]["properties"], "x", "y", "name", "x1", "", "\x00"]
    name, mark = r.choice(names), b";" if data.startswith(b"name;") else b","
    first, *rest = data.rstrip(b"\n").split(b"\n")
    fields = [mark + r.choice(FIELDS).encode() for _ in rest]
    return (
        b"\n".join([first + mark + name.encode(), *(row + field for row, field in zip(rest, fields, strict=True))])
        + b"\n"
    )


def draw_traces(r: random.Random) -> tuple[bytes, bytes, str]:
    """A table of traces, the same out of order, and how that was made."""
    text = r.choice((TRACES, TRACES, SEGMENTS))
    new, how = damage.damaged(r, text, (*damage.TEXT, _field, _field, _field, _column, _column))
    return text, new, how


def made_small(data: dict[str, Any], r: random.Random) -> None:
    """Few steps, coarse meshes and no pictures, wherever the scene's data are in order."""
    stages = data.get("stage")
    for stage in stages if isinstance(stages, list) else ():
        if isinstance(stage, dict):
            if isinstance(stage.get("steps"), int) and stage["steps"] > STEPS:
                stage["steps"] = r.randint(1, STEPS)
            if "end" in stage and stage.get("kind") != "auto":
                stage.pop("end")
                stage["steps"] = r.randint(1, STEPS)
    output = data.setdefault("output", {})
    if isinstance(output, dict):
        output["pictures"] = False
