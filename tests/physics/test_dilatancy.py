"""Slip that opens a joint, by keys of its table: a layer sheared over it, against springs, and with the fluid shut in."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

K_N, K_S, D_0, F_N, MU = 50e9, 20e9, 1e-3, 5e6, 0.6
ROCK, SHEAR = 10e9 / 2.0, 5e9 / 2.0  # of the rock: E and G over its height [Pa/m]
PSI, DISTANCE, C_F = np.tan(np.radians(10.0)), 5e-3, 1e-8
LAYER = """
[output]
pictures = false
[geometry]
domain = [0, 0, 1, 2]
size = 0.5
cells = "quads"
fracture = [{name = "seam", points = [[0, 1], [1, 1]]}]
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0
density = 2700
[initial_stress]
yy = "-5 MPa"
[fracture.seam]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.6
dilation_angle_deg = 10
dilation_distance = "5 mm"
[[support]]
on = "south"
[[tie]]
on = ["west", "east"]
[[probe]]
name = "middle"
at = [0.5, 1]
on = "seam"
"""
SPRINGS = (
    LAYER
    + """
[[support]]
on = "north"
displacement = {x = [[0, 0], [20, 10e-3]], y = 0}
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 20
"""
)
SEALED = (
    LAYER
    + """
[fluid]
viscosity = 1e-3
compressibility = 1e-8
initial_pressure = "1 MPa"
[[support]]
on = "north"
components = ["x"]
displacement = {x = [[0, 0], [20, 10e-3]]}
[[load]]
on = "north"
traction = "initial-stress"
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 20
"""
)


def ridden_up(slip):
    slip = np.minimum(np.abs(slip), DISTANCE)
    return PSI * (slip - slip**2 / (2.0 * DISTANCE))


def closure(traction):
    """The hyperbola's opening (2.11) under a change of traction, compression negative."""
    return traction / (K_N - traction / D_0)


def test_constant_normal_stiffness(run_scene):
    """Walls ride up by the integral of tan psi (1 - s/d); rock and closure share it, and strength follows; books close."""
    ran = run_scene(SPRINGS)
    slip, opening, normal, shear, dilation = (
        ran.probe("middle", name)
        for name in ("plastic_slip", "opening", "normal_traction", "shear_traction", "dilation")
    )
    assert slip[-1] > DISTANCE > slip[len(slip) // 2] > 0.0
    assert dilation == pytest.approx(ridden_up(slip), rel=1e-12, abs=1e-17)
    # f = -K (e + u) and f = k_n e/(1 + e/d0): a quadratic equation for e
    u, b = ridden_up(slip), K_N + ROCK + ROCK * ridden_up(slip) / D_0
    e = -2.0 * ROCK * u / (b + np.sqrt(b**2 - 4.0 * ROCK**2 * u / D_0))
    assert opening == pytest.approx(e + u, rel=1e-12, abs=1e-16)
    assert normal == pytest.approx(-F_N - ROCK * (e + u), rel=1e-12)
    slides = slip > 0.0
    assert shear[slides] == pytest.approx(-MU * normal[slides], rel=1e-12)
    pull = slip + shear * (1.0 / K_S + 1.0 / SHEAR)
    assert pull == pytest.approx(0.5e-3 * ran.history["time"], rel=1e-12, abs=1e-16)
    assert ran.closes()
    work = np.sum(-0.5 * (normal[1:] + normal[:-1]) * np.diff(dilation))
    heat = np.sum(0.5 * (shear[1:] + shear[:-1]) * np.diff(slip)) - work
    assert ran.history["energy/dilation"][-1] == pytest.approx(work, rel=1e-12)
    assert ran.history["energy/friction"][-1] == pytest.approx(heat, rel=1e-12)


def test_sealed(run_scene):
    """Walls that ride up draw the pressure of the fluid down that is shut in, and so press each other."""
    ran = run_scene(SEALED, "accuracy.residual=1e-13")
    slip, aperture, normal, pressure = (
        ran.probe("middle", name) for name in ("plastic_slip", "aperture", "normal_traction", "pressure")
    )
    fallen = pressure - 1e6
    assert slip[-1] > 1e-3 and fallen[-1] < -1e6
    assert normal == pytest.approx(-F_N + pressure, rel=1e-12)
    assert aperture == pytest.approx(D_0 + closure(fallen) + ridden_up(slip), rel=1e-12)
    assert aperture * np.exp(C_F * fallen) == pytest.approx(D_0, rel=1e-12)
    assert ran.closes()


@pytest.mark.parametrize(
    "law",
    [
        [],
        ["fracture.seam.law=slip-weakening", "fracture.seam.dynamic_friction_coefficient=0.5",
         "fracture.seam.slip_weakening_distance=5 mm"],
        ["fracture.seam.law=rate-and-state", "fracture.seam.reference_slip_rate=1e-6", "fracture.seam.direct_effect=0.01",
         "fracture.seam.evolution_effect=0.005", "fracture.seam.characteristic_slip=1 mm",
         "fracture.seam.initial_slip_rate=1e-12"],
    ],
    ids=["coulomb", "slip-weakening", "rate-and-state"],
)  # fmt: skip
@pytest.mark.parametrize("way", ["condensed", "monolithic", "dynamic", "explicit", "explicit without fluid"])
def test_every_law_in_every_way(run_scene, law, way):
    """The same opening of the same slip, whoever solves, and books that close."""
    if way.startswith("explicit"):
        sets = ["method.stepper=explicit", "stage.0.kind=dynamic", "stage.0.time_step=0.2 ms", "stage.0.steps=60"]
        sets.append("support.1.displacement={x = [[0, 0], [0.01, 10e-3]]%s}" % ("" if way == "explicit" else ", y = 0"))
    else:
        sets = ["stage.0.kind=dynamic"] if way == "dynamic" else [f"method.coupling={way}"]
    ran = run_scene(SPRINGS if "without" in way else SEALED, *sets, *law)
    slip, dilation = ran.probe("middle", "plastic_slip"), ran.probe("middle", "dilation")
    assert np.abs(slip).max() > 1e-4
    path = np.concatenate([[0.0], np.abs(np.diff(slip))]).cumsum()
    assert dilation == pytest.approx(ridden_up(path), rel=1e-11, abs=1e-16)
    assert ran.closes(1e-10 if way != "explicit" else 1e-3)


def test_resumed_to_the_last_bit(shared_tmp):
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(SEALED, encoding="utf-8")
    comm.barrier()
    given = load(shared_tmp / "scene.toml", ["output.checkpoint_every=1"])
    run(given, shared_tmp / "whole", comm)

    def stop(step):
        if step.state.time > 11.5:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(given, shared_tmp / "cut", comm, progress=stop)
    comm.barrier()
    resume(shared_tmp / "cut", comm)
    comm.barrier()
    one, other = (read_history(shared_tmp / name / "history.h5") for name in ("whole", "cut"))
    for key in ("probe/middle/dilation", "probe/middle/normal_traction", "energy/dilation", "energy/friction"):
        if comm.size == 1:
            assert np.array_equal(one[key], other[key])
        else:
            assert other[key] == pytest.approx(one[key], rel=1e-9)


OF = "fracture.seam"
REFUSED = {
    f"{OF}.dilation_angle_deg=40": r"dilation_angle_deg = 40: out of range; must be at most the angle of friction, 31",
    f"{OF}.dilation_angle_deg=-1": r"fracture\.seam\.dilation_angle_deg = -1: out of range",
    f"{OF}.dilation_distance=0": r"fracture\.seam\.dilation_distance = 0",
    f"{OF}={{normal_stiffness = 1, shear_stiffness = 1, aperture = 1, friction_angle_deg = 30, dilation_angle_deg = 5}}":
        r"fracture\.seam\.dilation_distance: missing; dilation_angle_deg needs it",
    "method.tangent=decoupled": r'dilation_angle_deg.*contradicts method\.tangent = "decoupled"',
    f"{OF}.dilation_distance=1 MPa": r"dilation_distance",
}  # fmt: skip


@pytest.mark.serial
@pytest.mark.parametrize(("setting", "said"), REFUSED.items())
def test_what_is_refused(run_scene, setting, said):
    with pytest.raises(InputError, match=said):
        run_scene(SPRINGS, setting)
