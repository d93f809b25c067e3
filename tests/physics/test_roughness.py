"""A hydraulic aperture apart from the mechanical one, and a conductance that grows with slip, by keys of a fracture."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError

from .test_dilation import SCENE

TABLE = "fracture.seam"
STEADY = SCENE.replace("KIND", "steady").replace('law = "linear"', "friction_angle_deg = 20")
PER_CUBE = 12e-3 * 2.0 / 1e5  # of the flow rate between both wells


def mean_cube(found, hydraulic):
    """The mean of the cube that the flow rate at the middle has, and the hydraulic apertures' range cubed."""
    flow = found.probe("middle", "flow_rate")[-1] * PER_CUBE
    return flow, hydraulic.min() ** 3, hydraulic.max() ** 3


@pytest.mark.parametrize("law", ["front", "exact", "report"])
def test_the_hydraulic_aperture_conducts(run_scene, law):
    """w_h = w_h0 + f (w - w_0) carries the flow, whatever law; the mechanical one is as wide as without."""
    held = run_scene(STEADY, f"method.conductance={law}")
    found = run_scene(
        STEADY,
        f"{TABLE}.hydraulic_aperture=0.2 mm",
        f"{TABLE}.hydraulic_opening_ratio=0.5",
        f"method.conductance={law}",
    )
    if MPI.COMM_WORLD.rank:
        return
    ends = found.fields["fractures"]
    flow, least, most = mean_cube(found, 0.2e-3 + 0.5 * ends["opening"])
    assert least < flow < most
    assert ends["opening"].std() > 1e-3 * np.abs(ends["opening"]).max()
    assert held.probe("middle", "aperture")[0] == found.probe("middle", "aperture")[0] == pytest.approx(1e-3)
    assert found.closes()


def test_the_conductance_grows_with_slip(run_scene):
    found, before = (run_scene(STEADY, *each) for each in (GROWS, []))
    if MPI.COMM_WORLD.rank:
        return
    ends = found.fields["fractures"]
    factor = 8.0 - 7.0 * np.exp(-np.abs(ends["plastic_slip"]) / 5e-4)
    assert factor.max() > 2.0
    flow, least, most = mean_cube(found, ends["aperture"])
    assert (
        least * factor.min() < flow < most * factor.max()
        and flow > 1.5 * before.probe("middle", "flow_rate")[-1] * PER_CUBE
    )
    assert found.closes()


GROWS = [f"{TABLE}.slip_conductance=8", f"{TABLE}.slip_conductance_distance=0.5 mm"]


def test_a_given_conductance_grows_alike(run_scene):
    """Uniform slip under uniform shear: the flow is F(s) times that which is given."""
    given = f"{TABLE}.conductance=1e-7"
    ties = STEADY.replace("[[probe]]", '[[support]]\non = ["west", "east"]\ncomponents = ["y"]\n[[probe]]')
    found = run_scene(ties, given, *GROWS, "well.0.pressure=1000")
    if MPI.COMM_WORLD.rank:
        return
    slip = found.fields["fractures"]["plastic_slip"]
    factor = 8.0 - 7.0 * np.exp(-np.abs(slip) / 5e-4)
    flow = found.probe("middle", "flow_rate")[-1] / (1e-7 * 1000 / 2.0)
    assert factor.min() <= flow <= factor.max() and flow > 2.0 and found.closes()


REFUSED = {
    f"{TABLE}.hydraulic_aperture=0": r"hydraulic_aperture = 0: out of range",
    f"{TABLE}.slip_conductance=4": r"slip_conductance_distance: missing; slip_conductance needs it",
    f"{TABLE}.slip_conductance=-1": r"slip_conductance = -1: out of range",
    f"{TABLE}.hydraulic_opening_ratio=1 mm": r"hydraulic_opening_ratio",
}


@pytest.mark.serial
@pytest.mark.parametrize(("setting", "said"), REFUSED.items())
def test_what_is_refused(run_scene, setting, said):
    with pytest.raises(InputError, match=said):
        run_scene(STEADY, setting)


@pytest.mark.serial
def test_a_conductance_has_no_aperture(run_scene):
    with pytest.raises(InputError, match=r"hydraulic_aperture = .*: contradicts conductance"):
        run_scene(STEADY, f"{TABLE}.conductance=1e-7", f"{TABLE}.hydraulic_aperture=0.2 mm")
