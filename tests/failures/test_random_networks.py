"""Networks with apertures over four decades under injection: each ends right, or named. 200 of them: scripts/benches."""

import numpy as np
import pytest
import random_networks

from fracflow._petsc import MPI
from fracflow.solve.residual import UNIT_ROUND_OFF, flow_residual

pytestmark = pytest.mark.serial


def test_six_networks(tmp_path):
    """Two without an outlet, three pumped at a rate, both kinds of stage, one with a halved step; books check what is right."""
    for seed in (*range(5), 25):
        end = random_networks.end_of(seed, tmp_path / str(seed))
        assert end.what in ("right", "named"), end
        assert end.what != "right" or end.steps >= random_networks.STEPS


def test_the_networks_span_four_decades_and_are_the_same_again():
    tables = [random_networks.scene(seed)["fracture"].items() for seed in range(200)]
    apertures = np.array([table["aperture"] for each in tables for name, table in each if name != "default"])
    assert apertures.min() < 1.1e-5 and apertures.max() > 0.09
    assert random_networks.scene(7) == random_networks.scene(7)
    assert sum(len(random_networks.scene(seed)["well"]) == 1 for seed in range(200)) == 40


def test_a_narrow_fracture_is_held_to_its_own_terms():
    """1e-14 out of balance is nothing beside 1, and all of what a fracture 1e-5 as wide carries."""
    balance, terms = np.array([0.0, 1e-14, 1e-20]), np.array([1.0, 1e-14, 0.0])
    assert flow_residual(balance, terms, 1.0, [], MPI.COMM_SELF) == 1.0
    assert flow_residual(balance, None, 1.0, [], MPI.COMM_SELF) == 1e-14
    assert flow_residual(balance, terms, 1.0, [np.array([1])], MPI.COMM_SELF) == pytest.approx(1e-20 / UNIT_ROUND_OFF)
    assert flow_residual(np.array([np.nan]), np.ones(1), 1.0, [], MPI.COMM_SELF) == np.inf
