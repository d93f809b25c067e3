"""A fracture that fluid lifts open up to its end would grow in rock: a line says so, none where it was open at the start."""

import pytest

from fracflow._petsc import MPI
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

TOLD = "is open up to its end"


def data(compression, rate, domain):
    sides = [] if domain == "unbounded" else [{"on": ["south", "north", "west", "east"]}]
    return {
        "output": {"pictures": False},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 0.0, "compressibility": 4.5e-10},
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500}},
        "initial_stress": {"xx": -compression, "yy": -compression, "zz": -compression},
        "geometry": {
            "domain": domain, "size_at_fractures": 1, "fracture": [{"name": "seam", "points": [[-5, 0], [5, 0]]}],
        } | ({} if domain == "unbounded" else {"size": 10}),
        "fracture": {"default": {
            "normal_stiffness": 1e11, "shear_stiffness": 1e11, "aperture": 1e-4, "friction_angle_deg": 30,
        }},
        "support": sides,
        "well": [{"name": "in", "at": {"fracture": "seam", "fraction": 0.5}, "flow_rate": rate}],
        "stage": [{"kind": "quasi-static", "time_step": 10, "steps": 10}],
    }  # fmt: skip


@pytest.mark.serial
@pytest.mark.parametrize("domain", ["unbounded", [-25, -25, 25, 25]], ids=["unmeshed", "meshed"])
@pytest.mark.parametrize(("compression", "rate", "is_told"), [(1e6, 5e-5, 1), (1e6, 5e-8, 0), (0.0, 5e-5, 0)])
def test_growth_that_is_left_out_is_told_once(compression, rate, is_told, domain, tmp_path):
    """100 s of 5e-5 m^2/s bring five times the volume at rest; a thousandth of it leaves the walls in contact."""
    done = run(Scene.from_data(data(compression, rate, domain)), tmp_path / "out", MPI.COMM_SELF)
    found = [line for line in done.doubts if TOLD in line]
    assert len(found) == is_told and (tmp_path / "out" / "log.txt").read_text().count(TOLD) == is_told
    assert all("seam is open" in line and "(-5, 0) m" in line and "maximum_pressure" in line for line in found)
