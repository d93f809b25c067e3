"""A row of the catalogue of events, by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fracflow.output.catalogue import Catalogue, FaultEnds, Instant

pytestmark = pytest.mark.serial
ENDS = FaultEnds(np.array([4, 5, 6]), np.array([10.0, 30.0, 0.0]), np.full(3, 3e10), 100.0, 1e3)  # forces in kN
BOOKS = {"friction": 0.0, "radiated": 0.0, "dropped": 0.0, "scheme": 0.0, "residual": 0.0}


def _at(time, slip, traction, sliding=(), rate=(0.0, 0.0, 0.0), injected=0.0, **books):
    slides = np.isin(np.arange(3), sliding)
    return Instant(
        time, *(np.array(v, float)[:, None] for v in (slip, traction, rate)), slides, {**BOOKS, **books}, injected
    )


def test_an_event_goes_from_the_first_section_that_slides_to_the_last_that_sticks():
    log = Catalogue(ENDS)
    assert log.update(_at(1.0, [0.2, 0.0, 0.0], [8e6, 8e6, 8e6], injected=7.0), False) is None
    assert log.update(_at(1.1, [0.2, 0.0, 0.0], [8e6, 8e6, 8e6]), True) is None
    log.update(_at(1.2, [0.2, 0.01, 9.0], [8e6, 8e6, 8e6], (1, 2), (0.0, 2.0, 9.0)), True)
    log.update(_at(1.3, [0.1, 0.05, 9.0], [9e6, 6e6, 8e6], (0, 1), (-3.0, 1.0, 9.0)), True)
    kept = json.loads(json.dumps(log.memory()))  # as a checkpoint keeps it
    log = Catalogue(ENDS)
    log.remember(kept)
    log.update(_at(1.4, [0.1, 0.05, 9.0], [9e6, 6e6, 8e6]), True)
    log.update(_at(1.5, [0.1, 0.05, 9.0], [9e6, 6e6, 8e6]), True)
    after = _at(2.0, [0.1, 0.05, 9.0], [9e6, 6e6, 8e6], friction=6.0, radiated=3.0, dropped=1.0, residual=-1e-9)
    row = log.update(after, False)
    assert (row["place"], row["start"], row["end"]) == (5, 1.2, 1.4)
    assert (row["slip"], row["peak_slip_rate"], row["sections"], row["length"]) == (-0.1, 3.0, 2, 40.0)
    assert row["mean_slip"] == pytest.approx(0.0625) and row["stress_drop"] == pytest.approx(1.75e6)  # 1 and 2 MPa
    assert row["moment"] == pytest.approx(3e10 * (10 * 0.1 + 30 * 0.05))
    assert row["magnitude"] == pytest.approx(2 / 3 * (np.log10(7.5e10 * 100 * 1e3) - 9.05))
    assert (row["radiated"], row["dissipated"], row["dropped"], row["injected"]) == (3.0, 6.0, 1.0, 7.0)
    assert row["unclosed"] == pytest.approx(1e-10)
    assert log.update(_at(3.0, [0.1, 0.05, 9.0], [9e6, 6e6, 8e6]), False) is None


def test_an_event_starts_where_the_step_began():
    log = Catalogue(ENDS)
    log.update(_at(1.1, [0.2, 0.0, 0.0], [8e6, 8e6, 8e6]), False)
    log.update(replace(_at(1.2, [0.2, 0.01, 0.0], [8e6, 8e6, 8e6], (1,)), began=1.1), True)
    assert log.row(_at(1.3, [0.2, 0.02, 0.0], [8e6, 8e6, 8e6]))["start"] == 1.1


def test_an_event_begins_at_its_fastest_section_the_first_of_those_alike():
    for rate, place in (((1.0, -2.0, 9.0), 5), ((2.0, -2.0 - 1e-13, 0.0), 4)):
        log = Catalogue(ENDS)
        log.update(_at(1.1, [0.2, 0.0, 0.0], [8e6, 8e6, 8e6]), False)
        log.update(_at(1.2, [0.2, 0.01, 0.0], [8e6, 8e6, 8e6], (0, 1, 2), rate), True)
        assert log.row(_at(1.3, [0.2, 0.02, 0.0], [8e6, 8e6, 8e6]))["place"] == place


def test_where_nothing_slides_there_is_no_event():
    log = Catalogue(ENDS)
    still = ([0.0, 0.0, 0.0], [8e6, 8e6, 8e6])
    assert [log.update(_at(time, *still), moves) for time, moves in ((1, False), (2, True), (3, False))] == [None] * 3


def test_creep_meanwhile_is_not_of_the_rupture():
    """Every section creeps with friction of rate and state: a network of kilometres is no rupture, its slip is moment."""
    log = Catalogue(FaultEnds(np.arange(3), np.full(3, 10.0), np.full(3, 3e10)))
    log.update(_at(1.0, [0.0, 0.0, 0.0], [8e6, 8e6, 8e6]), False)
    log.update(_at(1.1, [0.04, 0.0, 0.0], [6e6, 8e6, 9e6], (0,), (1.0, 0.0, 0.0)), True)
    row = log.update(_at(2.0, [0.1, 0.0011, 0.0009], [5e6, 7e6, 9e6]), False)
    assert (row["sections"], row["length"]) == (2, 20.0)
    assert row["mean_slip"] == pytest.approx(0.05055, rel=1e-12) and row["stress_drop"] == pytest.approx(2e6, rel=1e-12)
    assert row["moment"] == pytest.approx(3e10 * 10 * 0.102, rel=1e-12)
