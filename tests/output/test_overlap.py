"""Springs let walls close beyond their aperture; a run says so once, with place, value and remedy."""

import pytest

from fracflow._petsc import MPI
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run


def data(law, load):
    return {
        "output": {"pictures": False},
        "fluid": {"viscosity": 1e-3},
        "rock": {"rock": {"youngs_modulus": 5e10, "poissons_ratio": 0.25, "density": 2700}},
        "geometry": {
            "domain": [0, 0, 10, 10],
            "size": 2.5,
            "fracture": [{"name": "seam", "points": [[0, 5], [10, 5]]}],
        },
        "fracture": {"seam": {"normal_stiffness": 5e10, "shear_stiffness": 2e10, "aperture": 1e-4} | law},
        "support": [{"on": "south", "components": ["y"]}, {"on": ["west", "east"], "components": ["x"]}],
        "load": [{"on": "north", "traction": [0, -load]}],
        "well": [{"name": end, "at": {"fracture": "seam", "end": end}, "pressure": 0} for end in ("start", "end")],
        "stage": [{"kind": "steady", "time_step": 1, "steps": 1}],
    }


@pytest.mark.parametrize(
    ("law", "load", "expected"),
    [
        ({"law": "linear"}, 10e6, "m close by 0.0001 m more than their aperture"),
        ({"law": "linear"}, 4e6, ""),
        ({"friction_coefficient": 0.6}, 10e6, ""),
    ],
    ids=["springs", "springs, less load", "hyperbola"],
)
def test_walls_that_overlap_are_told_of(law, load, expected, shared_tmp):
    """Closure is load/k_n, 0.2 mm and 0.08 mm of 0.1 mm; a hyperbola leaves some of the aperture."""
    doubts = run(Scene.from_data(data(law, load)), shared_tmp / "out", MPI.COMM_WORLD).doubts
    found = [line for line in doubts if "more than their aperture" in line]
    assert len(found) == bool(expected)
    assert not expected or (expected in found[0] and "normal_stiffness" in found[0])
