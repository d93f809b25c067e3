"""The program against closed forms, each case on the coarser of the meshes and steps of ``scripts/figures verification``."""

from pathlib import Path

import numpy as np
import pytest
from figures_verification.case import measure
from figures_verification.cases import CASES, r08

ON_RANKS = (
    "R01 inclined joint, 0.9",
    "R02-C",
    "R03 P through 135",
    "R04 network",
    "R07 Sneddon, row, unstructured",
    "R08 Viesca, T = 0.5, coupled",
)
"""Beginnings of the names of those that run on more ranks than one too."""


def marked(case):
    """The case, for one rank only unless it is one of the few."""
    marks = () if case.name.startswith(ON_RANKS) else pytest.mark.serial
    return pytest.param(case, marks=marks, id=case.name)


@pytest.mark.parametrize("case", [marked(case) for case in CASES if case.quick])
def test_case(case):
    missed = [outcome for outcome in measure(case, quick=True) if not outcome.ok]
    assert not missed


@pytest.mark.serial
def test_bars_are_no_looser_than_what_is_asked_unless_the_table_says_so():
    bars = [(case.name, bar) for case in CASES for bar in case.bars if bar.asked is not None]
    assert {bar.asked for _, bar in bars} == {0.0001, 0.001, 0.002, 0.005, 0.01, 0.02}
    rows = Path(__file__, "../../../scripts/README.md").resolve().read_text().splitlines()
    told = {row.split("|")[1].strip() for row in rows if row.endswith("| not reached |")}
    assert {name for name, bar in bars if bar.most > bar.asked} == told


@pytest.mark.serial
@pytest.mark.parametrize("stress", r08.LOADS)
def test_the_front_of_the_exact_slip_is_where_it_is(stress):
    x = np.arange(0.0, 1.0, 0.02)
    assert r08.front(x, r08.slip(x, stress)) == pytest.approx(1.0, abs=2e-4)
