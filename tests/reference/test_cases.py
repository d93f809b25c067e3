"""The program against closed forms, each case on the coarser of the meshes and steps of ``scripts/figures verification``."""

import pytest
from figures_verification.case import measure
from figures_verification.cases import CASES


@pytest.mark.parametrize("case", [case for case in CASES if case.quick], ids=lambda case: case.name)
def test_case(case):
    missed = [outcome for outcome in measure(case, quick=True) if not outcome.ok]
    assert not missed
