"""The reach of a stranger's mesh file: it can only be read, within limits of time and memory."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time

import pytest

from fracflow._petsc import MPI
from fracflow.cli.app import app
from fracflow.errors import InputError, Interrupted
from fracflow.mesh.files import gmsh
from fracflow.mesh.files.msh_check import check_msh
from fracflow.mesh.read import read_mesh
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.levels import at_level
from fracflow.simulation.run import resume, run

pytestmark = pytest.mark.serial

SQUARE = """
Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {1, 1, 0}; Point(4) = {0, 1, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1:4}; Plane Surface(1) = {1}; Physical Surface("rock") = {1};
Transfinite Curve{1:4} = 2; Transfinite Surface{1};
"""
SCENE = """
units = "none"
[mesh]
file = "{file}"
[rock.rock]
density = 1
youngs_modulus = 1
poissons_ratio = 0
[[stage]]
kind = "dynamic"
time_step = 0.1
end = 0.5
"""
FOUR = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
1
2 1 "rock"
$EndPhysicalNames
$Entities
0 0 1 0
1 0 0 0 1 1 0 1 1 0
$EndEntities
$Nodes
1 3 1 3
2 1 0 3
1
2
3
0 0 0
1 0 0
0 1 0
$EndNodes
$Elements
1 1 1 1
2 1 2 1
1 1 2 3
$EndElements
"""
TWO = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
2 1 "rock"
$EndPhysicalNames
$Nodes
3
1 0 0 0
2 1 0 0
3 0 1 0
$EndNodes
$Elements
1
1 2 2 1 1 1 2 3
$EndElements
"""


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def inside(folder):
    return sorted(path.name for path in folder.rglob("*"))


def refused(path, message):
    before = inside(path.parent)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path, ())
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))
    assert inside(path.parent) == before


def test_a_geo_runs_and_writes_nothing_unless_it_is_trusted(tmp_path):
    here = tmp_path.as_posix()
    harm = f'SystemCall "touch {here}/called";\nPrintf("written") > "{here}/printed";\nSave "{here}/saved.msh";\n'
    path = write(tmp_path / "a.geo", SQUARE + harm)
    refused(path, r"a\.geo: line 6: SystemCall .*--trust")
    write(tmp_path / "scene.toml", SCENE.format(file="a.geo"))
    words = ["mesh", str(tmp_path / "scene.toml")]
    with pytest.raises(InputError, match=r"a\.geo: line 6: SystemCall"):
        app(words, standalone_mode=False)
    assert inside(tmp_path) == ["a.geo", "scene.toml"]
    app([*words, "--trust"], standalone_mode=False)
    assert inside(tmp_path) == ["a.geo", "called", "printed", "saved.msh", "scene.toml"]


def test_a_trusted_run_goes_on_without_its_geo(tmp_path):
    path = write(tmp_path / "a.geo", SQUARE + f'SystemCall "touch {tmp_path.as_posix()}/called";\n')
    write(tmp_path / "scene.toml", SCENE.format(file="a.geo") + "[output]\npictures = false\n")
    scene = load(tmp_path / "scene.toml", trust=True)
    assert scene.trust and at_level(scene, 1, {}).trust and not load(tmp_path / "scene.toml").trust
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Interrupted):
        run(scene, tmp_path / "out", MPI.COMM_SELF, lambda step: os.kill(os.getpid(), signal.SIGTERM))
    assert signal.getsignal(signal.SIGTERM) == before and (tmp_path / "called").exists()
    assert "trust" not in (tmp_path / "out" / "scene.toml").read_text()
    path.unlink()
    resume(tmp_path / "out", MPI.COMM_SELF)
    assert read_history(tmp_path / "out" / "history.h5")["time"][-1] == pytest.approx(0.5)


def test_an_endless_loop_ends_with_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("FRACFLOW_GMSH_SECONDS", "1")
    path = write(tmp_path / "a.geo", "n = 1000000000;\nFor i In {0:n}\nx = i;\nEndFor\n" + SQUARE)
    refused(path, r"a\.geo: Gmsh did not end within 1 s of CPU time; .*FRACFLOW_GMSH_SECONDS")
    monkeypatch.setattr(gmsh.Limits, "wall", 0.2)
    path = write(tmp_path / "b.geo", f'SystemCall "sleep 60; touch {tmp_path}/slept";\n' + SQUARE)
    with pytest.raises(InputError, match=r"Gmsh did not end within 0 s;"):
        read_mesh(path, (), trust=True)


def test_a_list_larger_than_memory_ends_with_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("FRACFLOW_GMSH_GIB", "1")
    refused(write(tmp_path / "a.geo", "x[] = LinSpace(0, 1, 1e9);\n" + SQUARE), r"a\.geo: .*1 GiB.*FRACFLOW_GMSH_GIB")


def test_a_file_larger_than_the_limit_is_not_written(tmp_path):
    code = (
        "import os, sys; from fracflow.mesh.files.gmsh_worker import keep_within; keep_within(60, 1 << 33, os.getppid());"
        " file = open(sys.argv[1], 'wb'); file.truncate(1 << 33); file.truncate((1 << 33) + 1)"
    )
    found = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a")], capture_output=True, text=True)
    assert "File too large" in found.stderr and (tmp_path / "a").stat().st_size == 1 << 33


def test_no_room_for_temporary_files_is_one_line(tmp_path, monkeypatch):
    path = write(tmp_path / "a.geo", SQUARE)
    monkeypatch.setattr(gmsh.tempfile, "tempdir", str(tmp_path / "gone"))
    refused(path, r"a\.geo: Gmsh cannot be run: .*gone.*: No such file or directory; make room, or set TMPDIR")


@pytest.mark.parametrize(("name", "value"), [("SECONDS", "soon"), ("GIB", "0"), ("GIB", "-1")])
def test_a_limit_that_is_no_number(tmp_path, monkeypatch, name, value):
    monkeypatch.setenv(f"FRACFLOW_GMSH_{name}", value)
    with pytest.raises(InputError, match=f'FRACFLOW_GMSH_{name} = "{value}": must be a whole number'):
        read_mesh(write(tmp_path / "a.geo", SQUARE), ())


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_gmsh_ends_with_those_who_called_it(tmp_path, sent):
    path = write(tmp_path / "a.geo", "n = 1000000000;\nFor i In {0:n}\nx = i;\nEndFor\n" + SQUARE)
    code = f"from fracflow.mesh.read import read_mesh; read_mesh({str(path)!r}, ())"
    caller = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    try:
        children = f"/proc/{caller.pid}/task/{caller.pid}/children"
        until = time.monotonic() + 60
        while not (found := open(children).read().split()) and time.monotonic() < until:
            time.sleep(0.05)
        (worker,) = found
        while "gmsh" not in open(f"/proc/{worker}/maps").read() and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(0.5)  # it sets its limits first
        os.kill(caller.pid, sent)
        caller.wait(30)
        while is_alive(worker) and time.monotonic() < until:
            time.sleep(0.05)
        assert not is_alive(worker)
    finally:
        caller.kill()  # and with it the endless loop of a test that has failed


def is_alive(process):
    try:
        return open(f"/proc/{process}/stat").read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_msh_begins_as_one(tmp_path):
    call = f'SystemCall "touch {tmp_path.as_posix()}/called";\n'
    for text in (call + "/*\n" + FOUR + "*/\n", "\n" + FOUR, " " + FOUR, "\ufeff" + FOUR, "$MeshFormat2\n",
                 FOUR.replace("$MeshFormat\n", "$MeshFormat \n" + call, 1), "//" + FOUR, "",
                 FOUR.replace("4.1", "1.0")):  # fmt: skip
        refused(write(tmp_path / "a.msh", text), "no Gmsh mesh of version 2 or 4")
    for text in (FOUR, TWO, FOUR.replace("\n", "\r\n")):
        assert read_mesh(write(tmp_path / "a.msh", text), ()).rocks == ("rock",)


def test_no_options_are_read_from_beside_a_file(tmp_path):
    call = f'SystemCall "touch {tmp_path.as_posix()}/called";\n'
    for name, text in (("a.msh", FOUR), ("b.msh", TWO), ("c.geo", SQUARE)):
        write(tmp_path / f"{name}.opt", call)
        assert read_mesh(write(tmp_path / name, text), ()).rocks == ("rock",)
    assert not (tmp_path / "called").exists()


@pytest.mark.parametrize(
    "name", ["a", "a.GEO", "a.MSH", "a.geo.opt", "a.msh.opt", "a.opt", "a.geo_unrolled", "a.pos", "a.brep", "a.step",
             "a.stp", "a.iges", "a.stl", "a.med", "a.cgns", "a.mesh", "a.unv", "a.vtk", "a.geo ", "a.py", ".geo"],
)  # fmt: skip
def test_other_kinds_of_files_reach_no_library(tmp_path, name):
    refused(
        write(tmp_path / name, f'SystemCall "touch {tmp_path.as_posix()}/called";\n' + FOUR), "unknown kind of file"
    )


@pytest.mark.parametrize("ending", ["geo", "msh"])
def test_special_files_are_refused(tmp_path, ending):
    os.mkfifo(tmp_path / f"a.{ending}")
    refused(tmp_path / f"a.{ending}", "is no regular file")
    (tmp_path / f"b.{ending}").symlink_to("/dev/zero")
    refused(tmp_path / f"b.{ending}", "is no regular file")
    (tmp_path / f"c.{ending}").mkdir()
    refused(tmp_path / f"c.{ending}", "is no regular file")
    large = write(tmp_path / f"d.{ending}", "$MeshFormat\n")
    os.truncate(large, 17 << 30)  # without room on the disk
    refused(large, "has more than")


NODES, ELEMENTS = b"$Nodes\n", b"$Elements\n"


@pytest.mark.parametrize(
    "text",
    [
        TWO.replace("$Nodes\n3", "$Nodes\n3000000000000"), TWO.replace("$Elements\n1", "$Elements\n1000000000000000000"),
        TWO.replace("$PhysicalNames\n1", "$PhysicalNames\n99999999999"), TWO.replace("$Nodes\n3", "$Nodes\n-1"),
        TWO.replace("$Nodes\n3", "$Nodes\n1e9"), TWO.replace("$Nodes\n3", f"$Nodes\n{'9' * 500}"),
        FOUR.replace("$Nodes\n1 3 ", "$Nodes\n1 3000000000000 "), FOUR.replace("$Nodes\n1 ", "$Nodes\n1000000000 "),
        FOUR.replace("$Elements\n1 1 ", "$Elements\n1 99999999999 "), TWO + "$Periodic\n1000000000000\n",
        b"$MeshFormat\n4.1 1 8\n" + struct.pack("i", 1) + b"\n$EndMeshFormat\n$Nodes\n" + struct.pack("4Q", 1, 1 << 40, 1, 9),
        b"$MeshFormat\n4.1 1 8\n" + struct.pack("i", 1) + b"\n$EndMeshFormat\n$Elements\n" + struct.pack("2Q", 1 << 60, 1),
        b"$MeshFormat\n4.1 1 8\n" + struct.pack(">i", 1) + b"\n$EndMeshFormat\n$Nodes\n" + struct.pack(">2Q", 1, 1 << 40),
        b"$MeshFormat\n2.2 1 8\n" + struct.pack("i", 1) + b"\n$EndMeshFormat\n$Nodes\n4000000000\n" + bytes(100),
    ],
)  # fmt: skip
def test_counts_fit_into_the_file(tmp_path, text):
    path = write(tmp_path / "a.msh", text)
    with pytest.raises(InputError, match="more than there is room for"):
        check_msh(path)


def test_counts_inside_of_a_mesh_stay_within_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(gmsh, "LEAST_SECONDS", 1)
    tags = "$NodeData\n1000000000\n" + "x\n" * 10  # of texts, which meshio would keep
    refused(write(tmp_path / "a.msh", TWO + tags), "a.msh: Gmsh did not end within 1 s")
    far = TWO.replace("3 0 1 0", "2000000000 0 1 0").replace(" 3\n$EndElements", " 2000000000\n$EndElements")
    refused(write(tmp_path / "b.msh", far), "b.msh: .* may use 1 GiB; let it make fewer cells")
    refused(write(tmp_path / "c.msh", TWO.replace("1 1 1 2 3", "1 1 1 2 7")), "c.msh: cannot be read")
    gap = TWO.replace("3 0 1 0", "9 0 1 0").replace("1 1 1 2 3", "1 1 1 2 5")
    refused(write(tmp_path / "d.msh", gap), "d.msh: an element has a node that the file does not have")
