"""The error of a step knows neither axes nor units: a scene that is turned, or told in other units, takes the same steps."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial

GEO = """// A block of 1 x 0.6 on a wall, turned about the origin.
c = {cos}; s = {sin}; l = {unit};
Macro At
  Point(n) = {{l*(c*x - s*y), l*(s*x + c*y), 0}};
Return
n = 1; x = 0; y = -0.4; Call At;
n = 2; x = 1; y = -0.4; Call At;
n = 3; x = 1; y = 0; Call At;
n = 4; x = 0; y = 0; Call At;
n = 5; x = 1; y = 0.6; Call At;
n = 6; x = 0; y = 0.6; Call At;
Line(1) = {{1, 2}}; Line(2) = {{2, 3}}; Line(3) = {{3, 4}}; Line(4) = {{4, 1}};
Line(5) = {{3, 5}}; Line(6) = {{5, 6}}; Line(7) = {{6, 4}};
Curve Loop(1) = {{1, 2, 3, 4}}; Plane Surface(1) = {{1}};
Curve Loop(2) = {{-3, 5, 6, 7}}; Plane Surface(2) = {{2}};
Transfinite Curve {{1, 3, 6}} = 4; Transfinite Curve {{2, 4, 5, 7}} = 3;
Transfinite Surface "*"; Recombine Surface "*";
Physical Surface("wall") = {{1}};
Physical Surface("block") = {{2}};
Physical Curve("base") = {{1}};
Physical Curve("seam") = {{3}};
Physical Curve("west") = {{7}};
"""


def _history(folder, rock, angle=0.0, unit=1.0, error=1e-3):
    """The block pushed aside for 2 s by a push along its own axes, on springs; ``unit`` is the length told for one."""
    comm, turn = MPI.COMM_WORLD, np.radians(angle)
    c, s = float(np.cos(turn)), float(np.sin(turn))
    push = [[[0.0, 0.0], [1.0, 0.3 * along], [2.0, 0.0]] for along in (c, s)]
    corner = [unit * (c - 0.6 * s), unit * (s + 0.6 * c)]
    elastic = "youngs_modulus = 20.0, poissons_ratio = 0.25"
    base = '"wall"' if rock == "rigid" else '"base"'
    held = ["x", "y", "rotation"] if rock == "rigid" else ["x", "y"]
    text = f"""
units = "none"
output.pictures = false
mesh.file = "block.geo"
rock.block = {{density = {1.0 / unit**2}, {"rigid = true" if rock == "rigid" else elastic}}}
rock.wall = {{density = {1.0 / unit**2}, {"rigid = true" if rock == "rigid" else elastic}}}
fracture.seam = {{law = "linear", normal_stiffness = {1.0 / unit}, shear_stiffness = {0.5 / unit}}}
support = [{{on = {base}, components = {held}}}]
load = [{{on = "west", traction = {push}}}]
accuracy.step_error = {error}
accuracy.max_halvings = 12
probe = [{{name = "block", at = {corner}, on = "block"}}]
stage = [{{kind = "dynamic", time_step = 0.8, end = 8}}]
"""
    if comm.rank == 0:
        folder.mkdir()
        (folder / "block.geo").write_text(GEO.format(cos=c, sin=s, unit=unit))
        (folder / "scene.toml").write_text(text)
    comm.barrier()
    run(load(folder / "scene.toml"), folder / "run", comm)
    comm.barrier()
    return read_history(folder / "run" / "history.h5")


@pytest.mark.parametrize("rock", ["rigid", "elastic"])
def test_turned_and_in_other_units_it_takes_the_same_steps(shared_tmp, rock):
    plain = _history(shared_tmp / "plain", rock)
    assert len(set(np.round(np.log2(0.8 / plain["step/dt"][1:])))) > 1  # the error does choose steps
    turned = _history(shared_tmp / "turned", rock, angle=37.0)
    assert np.array_equal(turned["time"], plain["time"])
    c, s = np.cos(np.radians(37.0)), np.sin(np.radians(37.0))
    moved = plain["probe/block/displacement"] @ np.array([[c, s], [-s, c]])
    assert turned["probe/block/displacement"] == pytest.approx(moved, abs=1e-8 * np.abs(moved).max())
    for unit in (1000.0, 0.001):
        told = _history(shared_tmp / f"unit{unit}", rock, unit=unit)
        assert np.array_equal(told["time"], plain["time"])
        assert told["probe/block/displacement"] / unit == pytest.approx(
            plain["probe/block/displacement"], abs=1e-8 * np.abs(moved).max()
        )
