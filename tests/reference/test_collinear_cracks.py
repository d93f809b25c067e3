"""Two cracks in line, opened by a pressure, attract each other: rock that is not meshed against elliptic integrals."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipe, ellipk

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

INNER, OUTER, PLACE = 0.2, 2.2, 1.2  # ends of the right one, and where its opening is looked at
YOUNG, NU, NET = 3e10, 0.25, 4e6


def opening():
    """At ``PLACE``, of the pair under ``NET`` (Tada, Paris and Irwin 2000, by integration of their slopes) [length]."""
    span, k2 = OUTER**2 - INNER**2, 1.0 - (INNER / OUTER) ** 2
    even = OUTER**2 * ellipe(k2) / ellipk(k2)

    def slope(angle):
        square = OUTER**2 - span * np.sin(angle) ** 2
        return (square - even) / np.sqrt(square)

    until = np.arcsin(np.sqrt((OUTER**2 - PLACE**2) / span))
    return 4.0 * NET * (1.0 - NU**2) / YOUNG * quad(slope, 0.0, until)[0]


def computed(folder, joints):
    traces = [{"name": n, "points": [[s * INNER, 0.0], [s * OUTER, 0.0]]} for n, s in (("left", -1), ("right", 1))]
    law = {"normal_stiffness": 1e15, "shear_stiffness": 1e13, "aperture": 1e-3, "friction_coefficient": 0.6}
    scene = {
        "geometry": {"domain": "unbounded", "size_at_fractures": (OUTER - INNER) / joints, "fracture": traces},
        "rock": {"rock": {"youngs_modulus": YOUNG, "poissons_ratio": NU}},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 0.0},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -1e7},
        "fracture": {"default": law | {"pressure": [[0, 0.0], [1, 1e7 + NET]]}},
        "probe": [{"name": "p", "at": [PLACE, 0.0], "on": "right"}],
        "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
        "output": {"pictures": False},
    }
    run(Scene.from_data(scene), folder, MPI.COMM_WORLD)
    return float(read_history(folder / "history.h5")["probe/p/opening"][-1])


def test_openings_converge_to_the_exact_one(shared_tmp):
    errors = [abs(computed(shared_tmp / str(n), n) / opening() - 1.0) for n in (20, 40)]
    assert errors[0] < 2.5e-4 and errors[1] < 4e-5
    assert errors[0] / errors[1] == pytest.approx(7.0, rel=0.3)
