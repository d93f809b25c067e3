"""Wells on a side: all fracture ends there, at a pressure each or with one flow rate that they share."""

import numpy as np
import pytest

from fracflow.errors import InputError

from .conftest import HELD
from .test_books import CRACK, QUASI

APERTURES = {"low": 0.5e-3, "mid": 1e-3, "high": 0.8e-3}
PARALLEL = (
    HELD.replace("steps = 1", "steps = 2").replace("1e-3", "1e-3\nflow_depth = 5")
    + """
[geometry]
domain = [0, 0, 4, 4]
size = 1.5
fracture = [
  {name = "low", points = [[0, 1], [4, 0.7]]},
  {name = "mid", points = [[0, 2], [4, 2]]},
  {name = "high", points = [[0, 3], [4, 3.5]]},
]
[[well]]
name = "west"
on = "west"
flow_rate = 1e-3
[[well]]
name = "east"
on = "east"
pressure = 0
"""
    + "".join(
        f"[fracture.{name}]\nnormal_stiffness = 1e12\nshear_stiffness = 1e12\naperture = {d}\nfriction_angle_deg = 30\n"
        f'[[probe]]\nname = "{name}"\nat = {{fracture = "{name}", fraction = 0.3}}\n'
        for name, d in APERTURES.items()
    )
)
ENDS = {"low": np.hypot(4, 0.3), "mid": 4.0, "high": np.hypot(4, 0.5)}
CONDUCTANCE = {name: d**3 / (12e-3 * ENDS[name]) for name, d in APERTURES.items()}


def test_ends_share_a_rate_by_their_conductance(run_scene):
    """q_i = Q c_i / sum c at one pressure Q / sum c, with c = d^3 / (12 mu L)."""
    found = run_scene(PARALLEL)
    whole = 5 * sum(CONDUCTANCE.values())
    assert found.history["well/west/pressure"][-1] == pytest.approx(1e-3 / whole, rel=1e-9)
    for name, conductance in CONDUCTANCE.items():
        assert found.probe(name, "flow_rate")[-1] == pytest.approx(1e-3 * 5 * conductance / whole, rel=1e-9)
        assert found.probe(name, "pressure")[-1] == pytest.approx(0.7e-3 / whole, rel=1e-9)
    assert found.history["well/east/rate"][-1] == pytest.approx(-1e-3, rel=1e-9)
    assert found.history["well/east/volume"][-1] == pytest.approx(-2e-3, rel=1e-9)
    assert np.abs(found.history["volume/unaccounted"]).max() <= 1e-12


def test_a_pressure_holds_at_every_end(run_scene):
    """In place of the rate: the same flow the other way round; and a limit of the rate's pressure."""
    whole = 5 * sum(CONDUCTANCE.values())
    given = run_scene(PARALLEL.replace("flow_rate = 1e-3", "pressure = 7e3"))
    limited = run_scene(PARALLEL.replace("flow_rate = 1e-3", "flow_rate = 1\nmaximum_pressure = 7e3"))
    for found in (given, limited):
        assert found.history["well/west/rate"][-1] == pytest.approx(7e3 * whole, rel=1e-9)
        assert found.history["well/west/injectivity"][-1] == pytest.approx(whole, rel=1e-9)


def test_fluid_at_rest_stays_so_between_sides(run_scene):
    """Kept at pressures that change with depth, as initially, no fluid flows."""
    found = run_scene(
        PARALLEL.replace("flow_rate = 1e-3", 'pressure = "initial"').replace(
            "pressure = 0\n", 'pressure = "initial"\n'
        ),
        "fluid.pressure_gradient=9810",
        "fluid.initial_pressure=1e6",
        "initial_stress={xx = -1e8, yy = -1e8}",
    )
    assert np.abs(found.history["well/west/rate"]).max() <= 1e-12 * 1e6 * sum(CONDUCTANCE.values())
    assert found.history["well/west/pressure"][-1] != 1e6


def test_walls_that_move_take_up_what_a_side_brings(run_scene):
    """Through one end, as a well at that end."""
    ends = CRACK.replace('at = {fracture = "crack", end = "start"}', 'on = "west"') + QUASI
    one, other = run_scene(CRACK + QUASI).history, run_scene(ends).history
    for key in ("well/in/rate", "well/in/volume", "probe/middle/pressure", "volume/stored"):
        assert one[key] == pytest.approx(other[key], rel=1e-9, abs=1e-12 * np.abs(other[key]).max())


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("well.west.on=north", r'well.west: on = "north": no fracture reaches that side'),
        ("well.west.on=up", r'well.west.on = "up": not in the mesh'),
        ("well.west.at=[0, 1]", r"well.west.on = .*contradicts at"),
        ("fluid.pressure_gradient=9810", r"well.west.flow_rate.* contradicts fluid.pressure_gradient"),
    ],
)
def test_sides_that_cannot_be_wells_are_refused(run_scene, setting, message):
    """Naming key, value and remedy."""
    with pytest.raises(InputError, match=message):
        run_scene(PARALLEL, setting)
