"""Units of axes: one that a person would choose, and noise that is not drawn large."""

import numpy as np
import pytest

from fracflow.output.drawing.axes import axis_of, shown, unit_for
from fracflow.scene.units import ENERGY, FLOW_RATE, LENGTH, PLAIN, STRESS, TIME, VELOCITY

pytestmark = pytest.mark.serial

SI = {"length": "m", "force": "N", "time": "s"}
FEET = {"length": "ft", "force": "lbf", "time": "s"}
DAYS = {"length": "m", "force": "N", "time": "day"}
HOURS = SI | {"shown_time": "h"}  # the unit of the author


@pytest.mark.parametrize(
    ("dimension", "largest", "units", "drawn"),
    [
        (TIME, 0.24, SI, "240 ms"),
        (TIME, 90.0, SI, "90 s"),
        (TIME, 1800.0, SI, "30 min"),
        (TIME, 43200.0, FEET, "12 h"),
        (TIME, 432000.0, SI, "5 days"),
        (TIME, 3.15576e8, SI, "10 years"),
        (TIME, 30.0, DAYS, "30 day"),
        (TIME, 259200.0, HOURS, "72 h"),
        (TIME, 1800.0, HOURS, "0.5 h"),
        (TIME, 12e-3, HOURS, "12 ms"),
        (STRESS, -2.5e7, SI, "-25 MPa"),
        (STRESS, 5e10, SI, "50 GPa"),
        (STRESS, 0.25, SI, "0.25 Pa"),
        (LENGTH, 1.5e-3, SI, "1.5 mm"),
        (LENGTH, 2e-4, SI, "200 µm"),
        (LENGTH, 0.25, SI, "25 cm"),
        (LENGTH, 700.0, SI, "700 m"),
        (LENGTH, 30e3, SI, "30 km"),
        (FLOW_RATE, 5e-3, SI, "5 L/s"),
        (VELOCITY, 3e-6, SI, "3 µm/s"),
        (ENERGY, 1.4e6, SI, "1.4 MJ/m"),
        (STRESS, 3e4, FEET, "30000 lbf/ft²"),
        (LENGTH, 0.1, FEET, "0.1 ft"),
        (LENGTH, 0.01, FEET, "0.01 ft"),
        (STRESS, 3e7, FEET, "30×10⁶ lbf/ft²"),
        (LENGTH, 5e-6, {}, "5×10⁻⁶"),
        (PLAIN, 0.5, SI, "0.5"),
    ],
)
def test_the_unit_suits_the_size(dimension, largest, units, drawn):
    assert shown(dimension, largest, units) == drawn


@pytest.mark.parametrize("largest", [0.0, np.nan, np.inf, 1e-310, 1e300, -1e300])
@pytest.mark.parametrize("units", [SI, FEET, {}])
def test_any_number_has_a_finite_factor(largest, units):
    for dimension in (TIME, LENGTH, STRESS, PLAIN):
        factor, _ = unit_for(dimension, largest, units)
        assert 0.0 < factor < np.inf
        assert axis_of(dimension, [[largest, 1.0], []], units).factor > 0.0


def test_a_small_change_of_a_large_value_is_drawn_from_a_round_number():
    """Flow between 5.001 and 5 MPa: no "1e-8 + 5" in a corner."""
    axis = axis_of(STRESS, [[5.001e6, 5.0012e6], [5e6, 5e6]], SI)
    assert axis.label("pressure") == "pressure less 5 MPa [kPa]"
    assert axis([5.001e6, np.nan]) == pytest.approx([1.0, np.nan], nan_ok=True)
    assert axis_of(TIME, [[466560.0, 466560.6]], SI).label("time") == "time less 5.4 days [s]"


def test_a_line_that_varies_by_round_off_is_constant():
    noisy = 5e6 * (1.0 + 1e-15 * np.arange(9))
    axis = axis_of(STRESS, [noisy, [7e6, np.nan]], SI)
    assert axis.is_constant and np.ptp(axis(noisy)) == 0.0 and axis(noisy)[0] == pytest.approx(5.0)
    assert not axis_of(STRESS, [5e6 * (1.0 + 1e-6 * np.arange(9))], SI).is_constant


def test_values_below_the_noise_are_none():
    axis = axis_of(LENGTH, [[1e-14, -3e-14]], SI, noise=1e-12)
    assert axis.is_constant and not axis([1e-14, -3e-14]).any()
    assert not axis_of(LENGTH, [[1e-14, -3e-14]], SI).is_constant
