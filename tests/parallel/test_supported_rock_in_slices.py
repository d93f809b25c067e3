"""A saved mesh in slices with supports and loads on rocks: results are those of the whole mesh, on any number of ranks."""

import json
import os
import subprocess
import sys

import pytest
from test_same_on_ranks import KEPT
from test_slices_in_a_run import PROGRAM, _assert_same

from fracflow.cli.mesh import mesh_lines
from fracflow.mesh.store import load_mesh
from fracflow.output import read_history
from fracflow.reduction.locked_fractures import PART
from fracflow.scene.scene import load
from fracflow.simulation.run import run

LAYERS = """
Mesh.MeshSizeMin = 3; Mesh.MeshSizeMax = 3;
Point(1) = {0, 0, 0}; Point(2) = {50, 0, 0}; Point(3) = {100, 0, 0};
Point(4) = {0, 30, 0}; Point(5) = {50, 30, 0}; Point(6) = {100, 30, 0};
Point(7) = {0, 100, 0}; Point(8) = {100, 100, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {1, 4}; Line(4) = {2, 5}; Line(5) = {3, 6};
Line(6) = {4, 5}; Line(7) = {5, 6}; Line(8) = {4, 7}; Line(9) = {6, 8}; Line(10) = {7, 8};
Curve Loop(1) = {1, 4, -6, -3}; Plane Surface(1) = {1};
Curve Loop(2) = {2, 5, -7, -4}; Plane Surface(2) = {2};
Curve Loop(3) = {6, 7, 9, -10, -8}; Plane Surface(3) = {3};
Point(11) = {35, 60, 0}; Point(12) = {65, 60, 0}; Line(11) = {11, 12};
Point(13) = {15, 85, 0}; Point(14) = {35, 85, 0}; Line(12) = {13, 14};
Point(15) = {65, 85, 0}; Point(16) = {85, 85, 0}; Line(13) = {15, 16};
Curve{11, 12, 13} In Surface{3};
Physical Surface("base") = {1}; Physical Surface("bench") = {2}; Physical Surface("rock") = {3};
Physical Curve("sides") = {1, 2, 3, 5, 8, 9, 10};
Physical Curve("fault") = {11}; Physical Curve("seam1") = {12}; Physical Curve("seam2") = {13};
"""
SCENE = """
output = {pictures = false}
mesh = {file = "layers.geo"}
initial_stress = {xx = -1e7, yy = -1e7, zz = -5e6}
support = [{on = "base"}, {on = "bench", displacement = {x = {time = [0, 3], value = [0, 1e-3]}, y = 0}}]
load = [{on = "sides", traction = "initial-stress"}]
probe = [{name = "rock", at = [50, 75]}, {name = "fault", at = [50, 60], on = "fault"}]
stage = [{kind = "quasi-static", time_step = 1, steps = 3}]
[rock]
base = {youngs_modulus = 1e10, poissons_ratio = 0.25, density = 2500}
bench = {youngs_modulus = 1e10, poissons_ratio = 0.25, density = 2500}
rock = {youngs_modulus = 1e10, poissons_ratio = 0.25, density = 2500}
[fracture]
default = {normal_stiffness = 2e12, shear_stiffness = 2e12, aperture = 1e-3, friction_coefficient = 0.6}
fault = {normal_stiffness = 5e10, shear_stiffness = 2e10, aperture = 1e-3, friction_coefficient = 0.03}
"""
FORCE = 'load=[{on="sides",traction="initial-stress"},{on="rock",force=[{time=[0,3],value=[0,5e7]},0]}]'


def _said(folder):
    """The line on supports that meet, and the row of the plan on fractures that are locked."""
    log, plan = (folder / "log.txt").read_text(encoding="utf-8"), json.loads((folder / "plan.json").read_text())
    (line,) = (each for each in log.splitlines() if "prescribes another displacement" in each)
    (row,) = (each for each in plan["decisions"] if each["part"] == PART)
    return line, row


@pytest.mark.serial
@pytest.mark.starts_ranks
@pytest.mark.parametrize("is_forced", [True, False], ids=["force", "locked"])
def test_supports_and_a_load_on_rocks_by_slices_on_1_2_and_3_ranks(is_forced, tmp_path):
    """Two rocks are held in two ways where they meet. Distances to them let stiff fractures be locked, but for a force."""
    (tmp_path / "layers.geo").write_text(LAYERS, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    scene, settings = str(tmp_path / "scene.toml"), [f"mesh.file={tmp_path / 'kept.h5'}"]
    settings += [FORCE] if is_forced else []
    list(mesh_lines(load(scene), tmp_path / "kept.h5"))
    run(load(scene, settings), tmp_path / "whole")
    line, row = _said(tmp_path / "whole")
    assert "in x than support.0 (base) at nodes of both, (50, 0), (50, 3) and 9 more" in line
    assert (
        row["left_out"] != is_forced and read_history(tmp_path / "whole" / "history.h5")["probe/fault/slip"][-1] != 0.0
    )
    clean = {k: v for k, v in os.environ.items() if k in KEPT}
    for ranks in (1, 2, 3):
        out = tmp_path / str(ranks)
        words = [sys.executable, "-c", PROGRAM.format(scene=scene, settings=settings), "0", str(out)]
        subprocess.run(
            ["mpirun", "--oversubscribe", "-n", str(ranks), *words], check=True, env=clean, timeout=300,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        _assert_same([tmp_path / "whole", out], "layers")
        assert _said(out) == (line, row)
        mesh = load_mesh(out / "mesh.h5")
        inside = (mesh.points[mesh.cells[mesh.near :]][..., 1].max(axis=1) < 30.0).sum()
        assert inside > 0.7 * (mesh.points[mesh.cells][..., 1].max(axis=1) < 30.0).sum()
