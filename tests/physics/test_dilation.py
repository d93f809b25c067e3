"""A law whose slip opens the joint, as tests have it: the opening reaches aperture, flow and energy."""

from typing import ClassVar

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.laws import JOINT_LAWS, HistoryVariable, JointResponse, Linear
from fracflow.laws.base import INSTANT

STRENGTH, DILATES, K_N, K_S, D_0, F_N = 2e5, 0.1, 2e10, 5e9, 1e-3, 1e6


class Dilatant(Linear):
    """Two springs, a constant shear strength, and an opening of a tenth of the path of the plastic slip."""

    history: ClassVar = {
        "plastic_slip": HistoryVariable("shear", "length", "plastic slip", published=False),
        "dilation": HistoryVariable("scalar", "length", "opening by slip"),
    }
    slides: ClassVar = True

    def evaluate(self, strain, history, step=INSTANT):
        sections, dim = strain.shape
        trial = np.reshape(self.initial_shear_traction, (-1, dim - 1)) + K_S * (
            strain[:, :-1] - history["plastic_slip"]
        )
        size = np.linalg.norm(trial, axis=1)
        slip = np.maximum(size - STRENGTH, 0.0) / K_S
        direction = trial / np.where(size > 0.0, size, 1.0)[:, None]
        plastic = history["plastic_slip"] + slip[:, None] * direction
        dilation = history["dilation"] + DILATES * slip
        f_s, elastic = trial - K_S * slip[:, None] * direction, strain[:, -1] - dilation
        f_n = self.initial_normal_traction + K_N * elastic
        tangent = np.zeros((sections, dim, dim))
        outer = (slip > 0.0)[:, None, None] * direction[:, :, None] * direction[:, None, :]
        tangent[:, :-1, :-1] = K_S * (np.eye(dim - 1) - outer)
        tangent[:, -1, :-1] = -K_N * DILATES * (slip > 0.0)[:, None] * direction
        tangent[:, -1, -1] = K_N
        shear = (
            np.sum(f_s**2, axis=1) - np.sum(np.reshape(self.initial_shear_traction, (-1, dim - 1)) ** 2, axis=1)
        ) / 2.0
        none = np.zeros(sections, dtype=bool)
        return JointResponse(
            traction=np.concatenate([f_s, f_n[:, None]], axis=1),
            tangent=tangent,
            stored=(self.initial_normal_traction + 0.5 * K_N * elastic) * elastic + shear / K_S,
            inelastic=np.concatenate([plastic, dilation[:, None]], axis=1),
            strength=np.full(sections, STRENGTH),
            utilisation=np.linalg.norm(f_s, axis=1) / STRENGTH,
            is_sliding=slip > 0.0,
            is_open=none,
            margin=np.full(sections, np.inf),
            history={"plastic_slip": plastic, "dilation": dilation},
        )


SCENE = """
[output]
pictures = false
[geometry]
domain = [0, 0, 2, 2]
size = 0.5
cells = "quads"
fracture = [{name = "seam", points = [[0, 1], [2, 1]]}]
[rock.rock]
youngs_modulus = "100 GPa"
poissons_ratio = 0
density = 2700
[initial_stress]
yy = "-1 MPa"
[fluid]
viscosity = 1e-3
[fracture.seam]
law = "linear"
normal_stiffness = "20 GPa/m"
shear_stiffness = "5 GPa/m"
aperture = "1 mm"
[[support]]
on = "south"
[[support]]
on = "north"
components = ["x"]
displacement = {x = [[0, 0], [4, 1e-3]]}
[[load]]
on = "north"
traction = "initial-stress"
[[well]]
name = "in"
at = {fracture = "seam", end = "start"}
pressure = 1e5
[[well]]
name = "out"
at = {fracture = "seam", end = "end"}
pressure = 0
[[probe]]
name = "middle"
at = [1, 1]
on = "seam"
[[stage]]
kind = "KIND"
time_step = 1
steps = 4
"""


@pytest.mark.parametrize(
    "kind, coupling", [("quasi-static", "monolithic"), ("quasi-static", "condensed"), ("dynamic", "monolithic")]
)
def test_slip_that_opens_a_joint_reaches_aperture_flow_and_energy(run_scene, monkeypatch, kind, coupling):
    monkeypatch.setitem(JOINT_LAWS, "linear", Dilatant)
    stepper = ["method.stepper=hht", "well.in.pressure=100"] if kind == "dynamic" else []
    found = run_scene(SCENE.replace("KIND", kind), f"method.coupling={coupling}", *stepper)
    if MPI.COMM_WORLD.rank:
        return
    slip, opening, normal, aperture = (
        found.probe("middle", name) for name in ("plastic_slip", "opening", "normal_traction", "aperture")
    )
    assert slip[-1] > 5e-4
    assert opening == pytest.approx((normal + F_N) / K_N + DILATES * slip, abs=1e-15)
    assert aperture == pytest.approx(D_0 + opening, rel=1e-12) and aperture[-1] > 1.05 * D_0
    assert (
        found.closes()
        and np.abs(found.history["energy/residual_closed"]).max() < 0.02 * found.history["energy/friction"][-1]
    )
    # what slips pushes the walls apart, against what presses them
    shear = found.probe("middle", "shear_traction")
    mean = 0.5 * (shear[1:] + shear[:-1] + DILATES * (normal[1:] + normal[:-1]))
    spent = found.fields["fractures"]["friction_energy"]
    assert np.abs(spent / np.sum(mean * np.diff(slip)) - 1.0).min() < 1e-9
    ends = found.fields["fractures"]["aperture"]
    if kind == "quasi-static":
        flow = found.probe("middle", "flow_rate")[-1] * 12e-3 * 2.0 / 1e5
        assert ends.min() ** 3 < flow < ends.max() ** 3
