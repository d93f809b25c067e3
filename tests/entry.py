"""What tests of input from anybody share: a small scene, a command and its line, all that lies in a folder."""

from __future__ import annotations

import sys

import pytest

from fracflow.cli.app import main

SCENE = """
[geometry]
domain = [0, 0, 4, 4]
size = 2
[[geometry.fracture]]
name = "fault"
points = [[1, 2], [4, 2]]
[rock.rock]
youngs_modulus = "50 GPa"
poissons_ratio = 0.25
[fracture.fault]
normal_stiffness = "10 GPa/m"
shear_stiffness = "5 GPa/m"
friction_angle_deg = 30
aperture = "1 mm"
[fluid]
viscosity = "1e-3 Pa s"
[output]
pictures = false
[[support]]
on = ["west", "east", "south", "north"]
[[well]]
name = "well"
at = [3, 2]
flow_rate = 1e-9
[[probe]]
name = "probe"
at = [3, 2]
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 1
"""


def said(words, monkeypatch, capfd):
    """Exit code of a command in this process, and its one line."""
    monkeypatch.setattr(sys, "argv", ["fracflow", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    line = capfd.readouterr().err
    assert line.startswith("fracflow: ") and line.count("\n") == 1 and line[:-1].isprintable(), line
    return ended.value.code, line


def contents(folder):
    """All that lies in a folder: what links point to, bytes and times."""
    found = {}
    for path in sorted(folder.rglob("*")):
        is_plain = path.is_file() and not path.is_symlink()
        found[path] = (path.lstat().st_mtime_ns, path.read_bytes() if is_plain else None)
    return found
