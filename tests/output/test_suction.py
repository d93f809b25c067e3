"""A well that pumps a fracture below a pressure of zero is told of, once, with place, value and remedy."""

import pytest

from fracflow._petsc import MPI
from fracflow.api import open as opened
from fracflow.scene.advice import advice
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run


def data(start, least=None, gradient=0.0):
    well = {"name": "out", "at": {"fracture": "seam", "end": "end"}, "flow_rate": [[0, 0], [10, -2e-5]]}
    fluid = {"viscosity": 1e-3, "specific_weight": 1e4, "initial_pressure": start}
    return {
        "output": {"pictures": False},
        "fluid": fluid | ({"pressure_gradient": gradient, "datum": 0.0} if gradient else {}),
        "rock": {"rock": {"rigid": True, "density": 2500}},
        "initial_stress": {"xx": -2e7, "yy": -2e7, "zz": -2e7},
        "geometry": {"domain": [0, 0, 10, 10], "size": 5, "fracture": [{"name": "seam", "points": [[0, 5], [10, 5]]}]},
        "fracture": {
            "default": {"normal_stiffness": 1e11, "shear_stiffness": 1e11, "aperture": 1e-4, "friction_angle_deg": 30}
        },
        "support": [{"on": "rock", "components": ["x", "y", "rotation"]}],
        "well": [
            {"name": "in", "at": {"fracture": "seam", "end": "start"}, "pressure": "initial"},
            well | ({"minimum_pressure": least} if least is not None else {}),
        ],
        "stage": [{"kind": "quasi-static", "time_step": 1, "steps": 10}],
    }


@pytest.mark.parametrize(
    ("start", "least"), [(1e6, None), (0.0, None), (1e6, 0.0)], ids=["pumped dry", "changes of pressure", "limited"]
)
def test_suction_is_told_once(start, least, shared_tmp, comm):
    """12 mu L Q/d^3 below 1 MPa: 1.08 MPa with the mean Q of the fifth step, of 4.5 s. Without initial pressure: changes."""
    done = run(Scene.from_data(data(start, least)), shared_tmp / "out", MPI.COMM_WORLD)
    log = comm.bcast((shared_tmp / "out" / "log.txt").read_text() if comm.rank == 0 else None)
    found = [line for line in done.doubts if "below zero" in line]
    held = [line for line in done.doubts if "is held at its minimum_pressure = 0" in line]
    assert len(held) == (least is not None) and all(line.startswith("time 5 s: well.out is held") for line in held)
    assert log.count("is held at its") == len(held)
    if not start or least is not None:
        assert not found and "below zero" not in log
        return
    (line,) = found
    assert line.startswith("time 5 s: the pressure in seam at (10, 5) m falls to -8e+04 ")
    assert "minimum_pressure" in line and log.count("below zero") == 1


@pytest.mark.parametrize(("least", "is_told"), [(2e6, True), (0.0, False)])
def test_a_limit_beyond_the_pressure_at_the_start_is_told_before_and_during_a_run(least, is_told, shared_tmp):
    """At 1 MPa, below the 2 MPa that it must not draw below, a well is shut: it draws nothing, and lets nothing in."""
    scene = Scene.from_data(data(1e6, least))
    lines = [line for line in advice(scene) if "well.out.minimum_pressure = 2e+06" in line and "lower it" in line]
    assert len(lines) == is_told
    if is_told:
        done = run(scene, shared_tmp / "out", MPI.COMM_WORLD)
        assert sum("well.out is shut, since the pressure around it is below" in line for line in done.doubts) == 1
        found = opened(shared_tmp / "out").history
        assert not found["well/out/rate"].any() and found["well/out/pressure"] == pytest.approx(1e6, rel=1e-12)
