"""A well's pressure jumps, and steps are divided: R06, Wijesinghe, with steps as accurate as asked."""

import numpy as np
import pytest
from figures_verification.cases.r05 import film, injection, similarity
from figures_verification.cases.r06 import APERTURE, AT_REST, CLEAN, DIFFUSIVITY, END, PUMPED, STIFFNESS

ACCURATE = "[accuracy]\nstep_error = 0.02\n"


@pytest.mark.serial
def test_parts_of_a_step_find_the_well_at_its_pressure():
    """Of steps of 12.5 s: a pressure that rose over the first of them would be 6 s late, and apertures wrong by 0.037."""
    w, _ = similarity(1 + (PUMPED - AT_REST) / (STIFFNESS * APERTURE))
    x = np.linspace(0, 9 * np.sqrt(DIFFUSIVITY * END), 49)
    found, _, opening = film(x, CLEAN + ACCURATE + injection(f"pressure = {PUMPED}", END, 8), "bdf2")
    assert len(found.history["time"]) > 20  # they were divided
    assert np.abs(opening / APERTURE - w(x / np.sqrt(4 * DIFFUSIVITY * END)) + 1).max() / 0.9 <= 5e-3
