"""`scripts/bench fuzz` on few inputs, what it must notice, and the inputs that it has found."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest
from _fuzz_cases import COMMAND, FRESH, GMSH, PROCESS, SHARES, kind_and_way
from _fuzz_judge import Box, inside, of_command
from _launch import without_ranks

from fracflow.errors import LONGEST, InputError
from fracflow.mesh.files.geo_check import check_geo
from fracflow.mesh.read import read_mesh
from fracflow.scene.scene import load
from fracflow.storage.files import read_bytes

pytestmark = pytest.mark.serial
BENCHES = Path(__file__).parents[2] / "scripts" / "benches"
SCENES = BENCHES.parents[1] / "meshes"
FEW, SEED = 250, 6
PLANTED = """
import sys
import fuzz
import _fuzz_cases as cases

read = cases.read_scene


def planted(folder, settings):
    read(folder, settings)
    1 / 0


cases.read_scene = planted
raise SystemExit(fuzz.main(sys.argv[1:]))
"""


def bench(*arguments):
    clean = without_ranks()
    way = os.pathsep.join(map(str, (BENCHES.parents[1], BENCHES.parent, BENCHES)))
    return subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL,
        env=clean | {"PYTHONPATH": way, "COLUMNS": "150"},
    )  # fmt: skip


def test_inputs_of_all_kinds_are_read_or_refused_in_one_line(tmp_path):
    drawn = {kind_and_way(SEED, number) for number in range(FEW)}
    assert {kind for kind, _ in drawn} == {kind for kind, _ in SHARES}
    assert {way for _, way in drawn} == {PROCESS, GMSH, COMMAND, FRESH}
    found = bench(BENCHES / "fuzz.py", "--inputs", FEW, "--seed", SEED, "--jobs", 1, "--out", tmp_path)
    assert found.returncode == 0 and f"{FEW} inputs" in found.stdout, found.stdout + found.stderr


def test_a_fault_that_is_planted_is_found_reduced_and_kept(tmp_path):
    found = bench(
        "-c",
        PLANTED,
        "--inputs",
        60,
        "--seed",
        SEED,
        "--jobs",
        1,
        "--only",
        "scene",
        "--way",
        PROCESS,
        "--out",
        tmp_path,
    )
    assert found.returncode == 1 and "ZeroDivisionError" in found.stdout, found.stdout + found.stderr
    (kept,) = (tmp_path / "cases").iterdir()
    assert "1 / 0" in (kept / "why.txt").read_text() or "ZeroDivisionError" in (kept / "why.txt").read_text()
    assert (kept / "scene.toml").exists()


def raised(error):
    raise error


@pytest.mark.parametrize(
    ("job", "key"),
    [
        (lambda: None, None),
        (lambda: raised(InputError("scene.toml: x = 1: must be 2")), None),
        (lambda: raised(InputError("scene.toml: x = 1: is wrong")), "message without a remedy"),
        (lambda: raised(KeyError("x")), "KeyError at"),
        (lambda: raised(SystemExit(1)), "SystemExit at"),
        (lambda: warnings.warn("overflow", RuntimeWarning, stacklevel=1), "RuntimeWarning at"),
        (lambda: os.write(3, b"words\n") and None, None),
        (lambda: time.sleep(5), "hang"),
    ],
)
def test_what_happens_in_one_process_is_judged(job, key, tmp_path, monkeypatch):
    monkeypatch.setattr("_fuzz_judge.HANGS", 0.2)
    (tmp_path / "log").touch()
    if "write" in repr(job.__code__.co_names):
        descriptor, key = os.open(tmp_path / "log", os.O_WRONLY | os.O_APPEND), "printed: words"
        job = lambda: os.write(descriptor, b"words\n")  # noqa: E731
    _, found = inside(job, tmp_path / "log")
    assert [fault.key.startswith(key) for fault in found] == ([True] if key else [])


@pytest.mark.parametrize(
    ("code", "out", "err", "key"),
    [
        (0, "note: x\n", "", None),
        (2, "", "fracflow: scene.toml: x = 1: must be 2\n", None),
        (2, "", "fracflow: scene.toml: x = 1: is wrong\n", "message without a remedy"),
        (2, "", "fracflow: a: must be b\nmore\n", "exit code 2 with 2 lines"),
        (2, "", "", "exit code 2 with 0 lines"),
        (0, "", "note: invalid value encountered in divide\n", "stderr: note"),
        (0, "", "words\n", "exit code 0 with stderr"),
        (0, "\x1b[31m", "", "output holds"),
        (1, "", 'File "/x/fracflow/simulation/run.py", line 7, in run\nKeyError: 1\n', "exit code 1: KeyError"),
        (-11, "", "", "exit code -11"),
        (139, "", "", "exit code 139"),
    ],
)
def test_what_a_command_leaves_is_judged(code, out, err, key):
    assert [fault.key.startswith(key) for fault in of_command(code, out, err)] == ([True] if key else [])


def test_a_mark_outside_the_folder_of_a_case_is_seen_and_taken_away(tmp_path):
    box = Box(tmp_path / "box")
    (box.case / "inside").touch()
    assert box.marks() == []
    for harm in (box.outside / "hit", box.case.parent / "hit"):
        harm.touch()
        assert [fault.key for fault in box.marks()] == ["wrote outside its folder"] and not harm.exists()
    (box.outside / "canary").write_text("dead")
    assert len(box.marks()) == 1 and box.marks() == [] and (box.outside / "canary").read_text() == "alive\n"


def refused(action, *arguments):
    """The message of an InputError, without a warning before it."""
    with warnings.catch_warnings(), pytest.raises(InputError) as caught:
        warnings.simplefilter("error")
        action(*arguments)
    return str(caught.value)


def test_links_in_a_circle_are_refused(tmp_path):
    for name in ("loop.msh", "loop.csv", "loop.geo"):
        (tmp_path / name).symlink_to(tmp_path / name)
    text = (SCENES / "report_5_2" / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(text.replace("block.geo", "loop.msh"))
    scene = load(tmp_path / "scene.toml")
    assert "loop.msh: " in refused(lambda: read_mesh(scene.mesh_path, ["lower"]))
    text = (SCENES / "three_fractures" / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(text.replace("traces.csv", "loop.csv"))
    assert "loop.csv: " in refused(load, tmp_path / "scene.toml")
    (tmp_path / "a.geo").write_text('Include "loop.geo";\n')
    assert "loop.geo" in refused(check_geo, tmp_path / "a.geo")


MESH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
2 1 "rock"
$EndPhysicalNames
$Nodes
{nodes}
$EndNodes
$Elements
1
1 2 2 1 1 1 2 3
$EndElements
"""


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (MESH.replace("$Nodes\n{nodes}", "$Node1 0 0 0"), ""),  # no nodes at all
        (MESH.format(nodes="0"), ""),
        (MESH.format(nodes="3\n1 0 0 0\n2 1e308 0 0\n3 0 1e308 0"), "beyond 1e+100; save the mesh again"),
        (MESH.format(nodes="3\n1 0 0 0\n2 1 0 0\n3 0 1 1"), "give nodes one z"),
    ],
)
def test_meshes_that_the_bench_has_found(text, why, tmp_path):
    (tmp_path / "mesh.msh").write_text(text)
    message = refused(read_mesh, tmp_path / "mesh.msh", [])
    assert "mesh.msh: " in message and ";" in message and message.endswith(why)


TABLE = SCENES.joinpath("three_fractures", "scene.toml").read_text()
TRACES = SCENES.joinpath("three_fractures", "traces.csv").read_text()
SUPPORT = 'support = [{on = ["west", "east", "south", "north"]'


@pytest.mark.parametrize(
    ("scene", "traces", "why"),
    [
        ('"a\\nb" = 1\n' + TABLE, TRACES, "unknown key; "),
        (TABLE.replace("increment = 0.01", 'increment = "' + "x" * 300000 + '"'), TRACES, "control.pumping.increment"),
        (TABLE, TRACES.replace("Anna,340", "x" * 100000 + ",340"), "must follow each other"),
        (TABLE, TRACES.replace("Anna,340,320", "Anna,340"), "; give as many"),
        (TABLE, TRACES.replace("name,x,y", "name,x,y," + "y" * 50000), "unknown column"),
        (TABLE, "name,x1,y1,x2,y2\nA,0,0,1,1\nA,2,2,3,3\n", "; join them"),
        (TABLE.replace("steps = 120", "steps = " + "9" * 400), TRACES, "must be at most 1000000000000"),
        (TABLE + 'x = "\x01"\n', TRACES, "; correct the line"),
        (
            TABLE.replace(SUPPORT, SUPPORT + ', components = ["y"], displacement = {x = 1, y = 1}'),
            TRACES,
            "; leave it out",
        ),
    ],
)
def test_scenes_and_tables_that_the_bench_has_found(scene, traces, why, tmp_path):
    (tmp_path / "scene.toml").write_text(scene)
    (tmp_path / "traces.csv").write_text(traces)
    message = refused(load, tmp_path / "scene.toml")
    assert why in message and "\n" not in message and len(message) <= LONGEST + len(" ... ")


def test_a_small_file_is_read_in_little_memory_whatever_would_be_allowed(tmp_path):
    (tmp_path / "a").write_bytes(b"text")
    assert read_bytes(tmp_path / "a", "x", 1 << 50) == b"text"
    assert "more than 0 MiB; x" in refused(read_bytes, tmp_path / "a", "x", 3)
