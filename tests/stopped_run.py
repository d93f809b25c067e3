"""A run that was stopped half way, for tests that damage or forge its folder."""

from __future__ import annotations

import os
import signal
import sys

import h5py
import numpy as np
import pytest

from fracflow.cli.app import main
from fracflow.errors import Interrupted
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = """
rock.rock = {youngs_modulus = "50 GPa", poissons_ratio = 0.25, density = "2700 kg/m^3"}
fluid = {viscosity = "1e-3 Pa s", specific_weight = "9.81 kN/m^3", initial_pressure = "5 MPa", flow_depth = "100 m"}
initial_stress = {xx = "-13 MPa", yy = "-25 MPa", zz = "-15 MPa"}
support = [{on = ["west", "east", "south", "north"]}]
stage = [{kind = "quasi-static", time_step = "6 h", end = "60 h"}]
probe = [{name = "middle", at = [500, 400], on = "Bruno"}]
geometry = {domain = [0, 0, 1000, 800], size = 400, size_at_fractures = 200, fracture = [
  {name = "Bruno", points = [[400, 600], [600, 200]]}]}
output = {fields_every = 2, checkpoint_every = 3, pictures = false}
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.2 mm"
friction_coefficient = 0.6
pressure = [[0, "5 MPa"], ["60 h", "12 MPa"]]
"""
STOP = 6  # steps taken before the stop; slip begins at the fourth


def stop_half_way(home):
    """Run the scene in a folder, stop it half way, and give the folder of the run."""
    (home / "scene.toml").write_text(SCENE)
    count = [0]

    def progress(_):
        count[0] += 1
        if count[0] == STOP:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted):
        run(load(home / "scene.toml"), home / "out", progress=progress)
    return home / "out"


def contents(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file() and path.name[0] != "."}


def spoken(words, monkeypatch, capfd):
    """Exit code and the line of a command."""
    monkeypatch.setattr(sys, "argv", ["fracflow", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    lines = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("note:")]
    return end.value.code or 0, "\n".join(lines)


def refused(folder, monkeypatch, capfd, *, command="resume"):
    """The one line of a command that leaves the folder as it is."""
    before = contents(folder)
    code, said = spoken([command, folder, *(["--csv"] if command == "export" else [])], monkeypatch, capfd)
    assert code == 2 and len(said.splitlines()) == 1 and said.startswith("fracflow: "), said
    assert contents(folder) == before
    return said


def flip(path, name, at=0, bit=0):
    """Flip a bit of an array in a file, which stays whole for HDF5."""
    with h5py.File(path, "r+") as file:
        values = file[name][()]
        values.reshape(-1).view(np.uint8)[at] ^= 1 << bit
        file[name][...] = values


def flat(found):
    """The values read, as a text that is the same for the same bits."""
    if isinstance(found, np.ndarray):
        return f"{found.dtype}{found.shape}{found.tobytes().hex()}"
    if isinstance(found, dict):
        return str({key: flat(found[key]) for key in sorted(found)})
    return str([flat(each) for each in found]) if isinstance(found, list | tuple) else str(found)
