"""Orders and errors from sequences whose limit is known; what tells nothing, or is missing, is said."""

import numpy as np
import pytest

from fracflow.output.convergence import Row, compare, judged
from fracflow.output.events import COLUMNS
from fracflow.output.history import HistoryFile

pytestmark = pytest.mark.serial


def row(*differences, least=2.0, name="there slip"):
    return judged(Row("probe", name, least, 1.0, differences), 1.0)


def test_order_and_error():
    """q = 1 + 0.1 h^2: the last of h = 1, 1/2, 1/4 is 0.1/16 off."""
    found = row(0.1 * (1 - 1 / 4), 0.1 * (1 / 4 - 1 / 16))
    assert found.order == pytest.approx(2.0) and found.error == pytest.approx(0.1 / 16) and not found.warning
    assert row(0.1 * (1 - 1 / 4)).error == pytest.approx(0.1 / 4)  # of two levels, by the order of the method
    assert row(0.1 * (1 - 1 / 2), least=1.0).error == pytest.approx(0.1 / 2)


def test_outside_the_asymptotic_range():
    assert "do not fall" in row(0.1, 0.1).warning and np.isnan(row(0.1, 0.1).error)
    assert "below 2" in row(0.1, 0.05).warning and row(0.1, 0.05).error == pytest.approx(0.05)
    assert "above 2" in row(0.1, 0.01).warning
    assert not row(0.1, 0.05, least=1.0).warning and not row(0.1, 0.05, name="there stress").warning
    still = row(1e-12, 2e-12)
    assert not still.warning and not still.is_seen


def folder(path, step, value, events=()):
    """A run to t = 1 whose history is value(t), with its events (kind, x, start)."""
    path.mkdir()
    with HistoryFile(path / "history.h5") as history:
        for time in np.arange(0.0, 1.0 + step / 2, step):
            history.append({"time": time, "probe/a/slip": value(time), "energy/kinetic": 0.0})
    lines = [f"{kind},fault,1,,{x},0.0,{start},,0.0,0.0" for kind, x, start in events]
    (path / "events.csv").write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    return path


def test_histories_and_events(tmp_path):
    """Histories t + h are 1/4 off in the end; the first slip is at 0.5 + h^2/8, the opening is there but once."""
    sizes = (1.0, 0.5, 0.25)
    runs = [
        folder(
            tmp_path / str(h),
            h / 2,
            lambda t, h=h: t + h,
            [("slip", x, 0.5 + x + h**2 / 8) for x in (0.0, 0.1)] + [("open", 0.0, 0.2)] * (h == 0.5),
        )
        for h in sizes
    ]
    found = {each.name: each for each in compare(runs, 1)}
    assert found["a slip"].order == pytest.approx(1.0) and found["a slip"].error == pytest.approx(0.25)
    assert found["fault slips first"].order == pytest.approx(2.0)
    assert found["fault slips first"].error == pytest.approx(1 / 128)
    assert found["fault slips at 2 places"].error == pytest.approx(1 / 128)
    assert found["fault opens"].warning == "not at level 0, 2"
    assert not found["kinetic"].is_seen
