"""Cases by their numbers: what each damages, how it is laid out in a folder, and what is done with it."""

from __future__ import annotations

import copy
import json
import random
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import _fuzz_folders as folders
import _fuzz_meshes as meshes
import _fuzz_scenes as scenes
from _fuzz_judge import Box, Found, inside

import fracflow
from fracflow.mesh.files.geo_check import check_geo
from fracflow.mesh.read import network_of
from fracflow.mesh.store import load_mesh
from fracflow.model.setup import geometry_of, place
from fracflow.output.checkpoint import read_arrays, read_notes
from fracflow.output.export import tables
from fracflow.output.history import read_attributes, read_history
from fracflow.output.reader import load_run_data
from fracflow.output.status import read_status
from fracflow.reduction.prepare import read_split
from fracflow.scene.advice import advice
from fracflow.scene.scene import Scene, load
from fracflow.scene.toml import tomllib
from fracflow.simulation.run import has_ended

PROCESS, GMSH, COMMAND, FRESH = "in one process", "Gmsh's process", "command line", "fresh process"
SHARES: dict[tuple[str, str], int] = {  # of ten thousand inputs
    ("scene", PROCESS): 3980,
    ("traces.csv", PROCESS): 1400,
    (".msh 2.2", PROCESS): 1650,
    (".msh 4.1", PROCESS): 300,
    (".geo", PROCESS): 1000,
    ("run folder", PROCESS): 1350,
    (".msh 4.1", GMSH): 12,
    (".geo", GMSH): 18,
    ("scene", COMMAND): 110,
    ("traces.csv", COMMAND): 20,
    (".msh 2.2", COMMAND): 25,
    (".msh 4.1", COMMAND): 25,
    (".geo", COMMAND): 20,
    ("run folder", COMMAND): 80,
    ("scene", FRESH): 3,
    (".msh 4.1", FRESH): 1,
    (".geo", FRESH): 2,
    ("run folder", FRESH): 4,
}
SMALL = (  # scenes whose first steps take little
    "report_5_1", "report_5_2", "report_5_3", "report_5_4", "report_5_5", "half_open_joint", "long_fracture",
    "no_outlet", "bar_impact",
    "slider", "closing_joint", "lifted_layer", "wedged_block", "wedge_flow", "rigid_motion", "two_modes_dynamic",
    "r01_inclined_joint",
)  # fmt: skip
MESHED = 20  # one of so many geometries without harm in them is meshed too


@dataclass(frozen=True)
class Case:
    """An input: what lies in a folder, and what is to be done there.

    kind, way  what is damaged, and how it is read
    how        names of the damages
    files      name -> bytes; laid over a copy of the run folder of ``Bases`` in "run" if ``is_run``; None takes a file away
    target     name of the file that is damaged
    base       what that file held
    words      of the command line
    settings   path.to.key=value
    link       seed of what takes the place of the target
    """

    number: int
    kind: str
    way: str
    how: str
    files: Mapping[str, bytes | None]
    target: str
    base: bytes
    words: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    is_run: bool = False
    link: int | None = None

    def with_target(self, data: bytes) -> Case:
        """The same with other bytes in the damaged file."""
        return replace(self, files={**self.files, self.target: data})


class Bases:
    """Whole inputs, made once for all: a run folder and meshes of every format."""

    def __init__(self, folder: Path) -> None:
        """Of what ``make`` left in a folder."""
        self.folder, self.run = folder, folder / "run"

    def make(self, forked: Callable[[Callable[[], object]], int]) -> None:
        """Run a scene, mesh some geometries; each in a process of its own."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        jobs = [lambda: folders.make(self.run, self.folder / "scene"), self._resume]
        jobs += [
            lambda s=source, v=version, b=binary: meshes.meshed(s, v, b, self.mesh_path(s, v, b))  # type: ignore[misc]
            for source in meshes.SOURCES
            for version, binary in meshes.FORMATS
        ]
        for job in jobs:
            if code := forked(job):
                raise RuntimeError(f"the inputs that are to be damaged could not be made (exit code {code})")

    def _resume(self) -> None:
        """Leave what the run comes to in ``whole``."""
        from fracflow.simulation.run import resume

        shutil.copytree(self.run, self.folder / "whole")
        resume(self.folder / "whole")

    def mesh_path(self, source: str, version: str, binary: bool) -> Path:
        """Of a whole mesh."""
        return self.folder / f"{Path(source).parent.name}-{version}-{'binary' if binary else 'text'}.msh"

    @cached_property
    def whole(self) -> dict[str, object]:
        """History of the run, gone to its end."""
        return dict(read_history(self.folder / "whole" / "history.h5"))


def kind_and_way(seed: int, number: int) -> tuple[str, str]:
    """The damage that a number stands for, and the reader of the file; the same for every run of the bench."""
    drawn = random.Random(f"{seed}/{number}").randrange(sum(SHARES.values()))
    for key, share in SHARES.items():
        drawn -= share
        if drawn < 0:
            return key
    raise AssertionError


def draw(seed: int, number: int, bases: Bases, box: Box) -> Case:
    """The case of a number."""
    kind, way = kind_and_way(seed, number)
    r = random.Random(f"{seed}/{number}/{kind}/{way}")
    case = DRAWN[kind](r, number, way, bases, box)
    return case if way == PROCESS else replace(case, words=_words(r, case))


def _scene(r: random.Random, number: int, way: str, bases: Bases, box: Box) -> Case:
    if way == PROCESS:
        path, base, new, how = scenes.draw_scene(r)
        settings = (r.choice(scenes.SETTINGS),) if r.random() < 0.1 else ()
        files: dict[str, bytes | None] = {"scene.toml": new}
        if b"fractures_csv" in base:
            files["traces.csv"] = scenes.TRACES
        return Case(number, "scene", way, how, files, "scene.toml", base, (), settings)
    while True:
        path = r.choice([path for path, _, _ in scenes.bases() if path.parent.name in SMALL])
        data = copy.deepcopy(scenes.at_path(path))
        scenes.made_small(data, r)
        start = scenes.written(data)
        how = scenes.changed(r, data, scenes.MILD if r.random() < 0.7 else scenes.WILD)
        scenes.made_small(data, r)
        new = scenes.written(data)
        if new is not None and start is not None:
            files = {"scene.toml": new, **_beside(path)}
            return Case(number, "scene", way, how, files, "scene.toml", start)


def _beside(path: Path) -> dict[str, bytes | None]:
    """Geometries and tables in the folder of a scene."""
    return {file.name: file.read_bytes() for file in path.parent.iterdir() if file.suffix in (".geo", ".csv")}


def _traces(r: random.Random, number: int, way: str, bases: Bases, box: Box) -> Case:
    base, new, how = scenes.draw_traces(r)
    text = next(text for path, _, text in scenes.bases() if path.parent.name == "three_fractures")
    data = tomllib.loads(text.decode())
    data["geometry"] |= {"size": 150, "size_at_fractures": 100}
    data["probe"], data["well"] = [], data["well"][:1]
    data["well"][0]["at"] = [420, 350]
    scenes.made_small(data, r)
    files: dict[str, bytes | None] = {"scene.toml": scenes.written(data), "traces.csv": new}
    case = Case(number, "traces.csv", way, how, files, "traces.csv", base)
    return replace(case, link=r.randrange(10**6), how="link") if r.random() < 0.005 else case


def _msh(version: str) -> Callable[[random.Random, int, str, Bases, Box], Case]:
    def drawn(r: random.Random, number: int, way: str, bases: Bases, box: Box) -> Case:
        source, binary = r.choice(meshes.SOURCES), r.random() < 0.5
        base = bases.mesh_path(source, version, binary).read_bytes()
        new, how = meshes.draw_msh(r, base, binary)
        data = copy.deepcopy(scenes.at_path(scenes.MESHES / meshes.OF_SCENE[source]))
        data["mesh"] = {"file": "mesh.msh"}
        scenes.made_small(data, r)
        files = {"scene.toml": scenes.written(data), "mesh.msh": new}
        case = Case(number, f".msh {version}", way, how, files, "mesh.msh", base)
        return replace(case, link=r.randrange(10**6), how="link") if r.random() < 0.005 else case

    return drawn


def _geo(r: random.Random, number: int, way: str, bases: Bases, box: Box) -> Case:
    name, base, new, how = meshes.draw_geo(r, box.outside / "hit", box.outside)
    path = scenes.MESHES / Path(name).parent / "scene.toml"
    data = copy.deepcopy(scenes.at_path(path))
    data["mesh"]["file"] = Path(name).name
    scenes.made_small(data, r)
    target = Path(name).name
    files = {**_beside(path), "scene.toml": scenes.written(data), target: new}
    case = Case(number, ".geo", way, how, files, target, base)
    return replace(case, link=r.randrange(10**6), how="link") if r.random() < 0.005 else case


def _folder(r: random.Random, number: int, way: str, bases: Bases, box: Box) -> Case:
    name, base, new, how = folders.draw_file(r, bases.run)
    case = Case(number, "run folder", way, how, {f"run/{name}": new}, f"run/{name}", base, is_run=True)
    return replace(case, link=r.randrange(10**6), how="link") if r.random() < 0.03 else case


DRAWN: dict[str, Callable[[random.Random, int, str, Bases, Box], Case]] = {
    "scene": _scene,
    "traces.csv": _traces,
    ".msh 2.2": _msh("2.2"),
    ".msh 4.1": _msh("4.1"),
    ".geo": _geo,
    "run folder": _folder,
}


def _words(r: random.Random, case: Case) -> tuple[str, ...]:
    """A command for a case that is not read in one process."""
    if case.is_run:
        drawn = r.random()
        if drawn < 0.75:
            return ("resume", "run")
        return ("export", "run", "--csv") if drawn < 0.9 else ("picture", "run")
    if case.way == GMSH:
        return ("mesh", "scene.toml")
    if case.kind == "scene":
        return r.choice((("run", "scene.toml", "-o", "o"), ("check", "scene.toml"), ("check", "scene.toml", "--json")))
    return r.choice((("run", "scene.toml", "-o", "o"), ("mesh", "scene.toml"), ("check", "scene.toml")))


def lay_out(case: Case, folder: Path, bases: Bases, outside: Path) -> None:
    """Make the folder of a case anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if case.is_run:
        shutil.copytree(bases.run, folder / "run")
    for name, data in case.files.items():
        if data is None:
            (folder / name).unlink()
        else:
            (folder / name).write_bytes(data)
    if case.link is not None:
        folders.link(random.Random(case.link), folder / case.target, outside)


def jobs(case: Case, folder: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """The actions on a case in one process, by name; each may refuse it."""
    if case.is_run:
        yield from _readers(case.target.removeprefix("run/"), folder / "run")
    elif case.kind in ("scene", "traces.csv"):
        yield "load", lambda: read_scene(folder, case.settings)
    elif case.kind == ".geo" and case.number % MESHED and not case.how.startswith("harm"):
        yield "check", lambda: check_geo(folder / case.target)
    else:  # whatever harm the check lets through, Gmsh now does
        yield "mesh", lambda: read_mesh(folder)


def read_scene(folder: Path, settings: tuple[str, ...]) -> None:
    """Load a scene, all but its mesh; what is written of it must be read as the same. Raises InputError."""
    scene = load(folder / "scene.toml", list(settings))
    advice(scene)
    start = 0.0
    for stage in scene.stage:
        stage.step_count(start)
        start = stage.finish(start)
    copied = folder / "copied.toml"
    copied.write_text(scene.dump_toml(folder), encoding="utf-8")
    again = load(copied).model_copy(update={"version": scene.version})  # that of the program that wrote it
    if (
        again.mesh is not None and scene.mesh is not None and again.mesh_path == scene.mesh_path
    ):  # spelled in another way
        again = again.model_copy(update={"mesh": again.mesh.model_copy(update={"file": scene.mesh.file})})
    if again != scene:
        raise AssertionError("what is written of a scene is read as another")
    if scene.geometry is not None and scene.geometry.size is not None and scene.rock:
        network_of(geometry_of(scene))


def read_mesh(folder: Path) -> None:
    """Read and split a mesh and find the scene's places on it. Raises InputError."""
    scene: Scene = load(folder / "scene.toml")
    place(scene, read_split(scene))


def _readers(name: str, run: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """The reader of a file of a run folder."""
    if name in ("history.h5", ".fracflow"):
        yield "history", lambda: read_history(run / "history.h5")
        yield "attributes", lambda: read_attributes(run / "history.h5")
        yield "units", lambda: fracflow.open(run).units
        yield "tables", lambda: tables(run)
    if name in ("checkpoint.h5", ".fracflow"):
        yield "ended", lambda: has_ended(run)
        yield "notes", lambda: read_notes(run / "checkpoint.h5")
        yield "arrays", lambda: read_arrays(run / "checkpoint.h5")
    if name == "mesh.h5":
        yield "mesh", lambda: load_mesh(run / "mesh.h5")
    if name == "events.csv":
        yield "events", lambda: fracflow.open(run).events
    if name == "plan.json":
        yield "plan", lambda: fracflow.open(run).plan
        yield "card", lambda: fracflow.open(run).card
    if name == "scene.toml":
        yield "scene", lambda: fracflow.open(run).scene
    if name in ("status.json", ".fracflow"):
        yield "status", lambda: read_status(run)
    yield "pictures", lambda: load_run_data(run)


def in_one_process(case: Case, box: Box) -> list[tuple[str, Found]]:
    """Read a case: what is wrong, with how each reading ended."""
    found = []
    for name, job in jobs(case, box.case):
        ending, faults = inside(job, box.log)
        found += [(f"{name} {ending}", fault) for fault in faults]
    return found


def notes_of(case: Case) -> str:
    """The command that repeats a case, as text."""
    about = {
        "number": case.number, "kind": case.kind, "way": case.way, "how": case.how, "target": case.target,
        "words": case.words, "settings": case.settings, "link": case.link,
    }  # fmt: skip
    return json.dumps(about, indent=1, ensure_ascii=True)


def hunks(old: bytes, new: bytes) -> list[tuple[int, int, bytes]]:
    """Where two files differ, as (start, end, old bytes) on the new one; by lines, or by bytes where lengths agree."""
    if len(old) == len(new):
        found: list[tuple[int, int, bytes]] = []
        for at, (one, other) in enumerate(zip(old, new, strict=True)):
            if one != other:
                if found and found[-1][1] == at:
                    found[-1] = (found[-1][0], at + 1, old[found[-1][0] : at + 1])
                else:
                    found.append((at, at + 1, old[at : at + 1]))
        return found
    if max(len(old), len(new)) > 20000:
        return []
    import difflib

    a, b = old.splitlines(keepends=True), new.splitlines(keepends=True)
    starts = [0]
    for line in b:
        starts.append(starts[-1] + len(line))
    codes = difflib.SequenceMatcher(None, a, b, autojunk=False).get_opcodes()
    return [(starts[j1], starts[j2], b"".join(a[i1:i2])) for tag, i1, i2, j1, j2 in codes if tag != "equal"]


def reduced(case: Case, fails: Callable[[Case], bool], tries: int = 40) -> Case:
    """The same case with as few differences from the whole file as still fail."""
    new = case.files[case.target]
    if new is None or case.link is not None:
        return case
    for start, end, old in reversed(hunks(case.base, new)):
        if tries <= 0:
            break
        tries -= 1
        trial = case.with_target(new[:start] + old + new[end:])
        if fails(trial):
            case, new = trial, new[:start] + old + new[end:]
    return case
