"""``scripts/figures schedules``: the fault of 5.5 in a stage auto fails where the report says, and a front is a front."""

import numpy as np
import pytest
from figures_schedules import study
from figures_schedules.front import front

pytestmark = pytest.mark.serial
NAMES = {"5.5 at once": 3000.0, "centre at once": 5000.0}


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """First events, by schedule."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "DURATION", 9.0)
        for schedule in study.SCHEDULES:
            if schedule.name in NAMES:
                found[schedule.name] = study.follow(schedule, tmp_path_factory.mktemp("run") / "out")
    return found


def test_withdrawal_locks_the_lateral_parts(first):
    """5.5: "Only the three center nodes failed"; without "fluid removal through the artificial sources" five do."""
    report, centre = (first[name] for name in NAMES)
    assert report.is_over and (report.length[0], centre.length[0]) == pytest.approx(tuple(NAMES.values()))
    assert centre.moment[0] > 2.0 * report.moment[0]


def test_an_event_closes_its_books_and_drops_next_to_nothing(first):
    for found in first.values():
        assert found.unclosed[0] <= 1e-6 and abs(found.dropped[0]) <= 1e-3


def test_none_on_the_front_is_beaten():
    def of(total, largest):
        moment = np.array([largest, total - largest])
        return study.Found(*[moment] * 5, 0.0, True)

    found = [of(10.0, 8.0), of(5.0, 4.0), of(4.0, 5.0), of(9.0, 8.0), of(3.0, 2.0)]
    assert front(found) == [4, 1, 0]
    assert found[0].ratio == pytest.approx(1.25)
