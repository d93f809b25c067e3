"""Orders and errors from sequences whose limit is known; what tells nothing, or is missing, is said."""

import io

import numpy as np
import pytest
from rich.console import Console

from fracflow.output.convergence import Row, compare, judged, write
from fracflow.output.convergence_plot import tell
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
    assert "below 0.7" in row(0.1, 0.1 / 2**0.5).warning
    assert "above 2" in row(0.1, 0.01).warning
    slid = row(796.0, 0.0)  # on the coarsest level only: nothing tells what a further one would do
    assert slid.order == np.inf and slid.error == 0.0 and "above 2" in slid.warning
    assert "jump" in row(0.2, 0.2, 0.1).warning and "jump" in row(0.0, 0.2, 0.1).warning
    assert not row(0.4, 0.2, 0.1).warning
    low = row(0.1, 0.05)  # of tips: the estimate goes by the order seen
    assert not low.warning and low.error == pytest.approx(0.05)
    still = row(1e-12, 2e-12)
    assert not still.warning and not still.is_seen


def test_errors_that_cancel_are_no_order(tmp_path):
    """Of h f - h^2 f, and a little more, differences fall as of order 2.0, and the estimate is 7.8 times too small."""

    def level(h, extra):
        def value(t):
            f, g = np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)
            return h * f + h**2 * (extra * f + 0.2 * g)

        return value

    for extra, told in ((-1.0, "change their course"), (1.0, "")):
        runs = [folder(tmp_path / f"{extra}{k}", 1 / 64, level(0.5**k, extra)) for k in range(3)]
        found = {each.name: each for each in compare(runs, 1)}["a slip"]
        true = np.sqrt(np.mean([level(0.25, extra)(t) ** 2 for t in np.arange(0, 1.0001, 1 / 64)]))
        assert told in found.warning and bool(told) == bool(found.warning) and found.order < 2.6
        assert (found.error < true / 5) if told else (true / 2 <= found.error <= 2 * true)


def folder(path, step, value, events=(), units=None):
    """A run to t = 1 whose history is value(t), with its events (kind, x, start)."""
    path.mkdir()
    with HistoryFile(path / "history.h5", {"units": units} if units else {}) as history:
        for time in np.arange(0.0, 1.0 + step / 2, step):
            energies = {"energy/kinetic": 0.0, "energy/scheme": step}
            history.append({"time": time, "probe/a/slip": value(time), "probe/a/stress": 1e3 + value(time), **energies})
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
    assert not found["kinetic"].is_seen and "scheme" not in found


def test_errors_are_over_the_change_since_the_start(tmp_path):
    """1000 + (1 + h) t changes by 1.5 on the finer of two levels; tips make order 1 the one assumed, as gradients do."""
    runs = [folder(tmp_path / str(h), h, lambda t, h=h: (1 + h) * t) for h in (1.0, 0.5)]
    rms = 0.5 / np.sqrt(2)  # of differences, over t = 0 and 1
    for has_tips, order in ((False, 2), (True, 1)):
        found = {each.name: each for each in compare(runs, 2, has_tips)}
        assert found["a slip"].relative == pytest.approx(rms / (2**order - 1) / 1.5)
        assert found["a stress"].relative == pytest.approx(rms / 1.5)
    alone = {
        each.name: each for each in compare([folder(tmp_path / f"x{k}", 2.0, lambda t, k=k: 4 + k) for k in (0, 1)], 2)
    }
    assert alone["a slip"].change == 5.0  # of a single time there is no change


def test_what_slips_on_the_coarsest_level_only(tmp_path):
    """Neither two levels nor three tell its error; noise of 1e-20 is no slip."""
    runs = [folder(tmp_path / str(k), 0.5, lambda t, k=k: t * (8.0, 1e-20, 0.0)[k]) for k in range(3)]
    for count in (2, 3):
        found = {each.name: each for each in compare(runs[:count], 2)}["a slip"]
        assert found.warning == ("no change at level 1", "no change at level 1, 2")[count - 2]
        assert np.isnan(found.relative)


def test_quantities_have_the_units_of_the_scene(tmp_path):
    units = {"length": "ft", "force": "lbf", "time": "s"}
    runs = [
        folder(tmp_path / str(h), h, lambda t, h=h: (1 + h) * t, [("slip", 0.0, h)], units) for h in (1.0, 0.5, 0.25)
    ]
    rows = compare(runs, 1)
    assert {row.name: row.unit for row in rows} == {
        "a slip": "ft", "a stress": "lbf/ft^2", "kinetic": "lbf ft/ft", "fault slips first": "s",
    }  # fmt: skip
    text = io.StringIO()
    tell(rows, Console(file=text, width=120), 3, 1)
    assert all(f"{name} " in text.getvalue() for name in ("a slip [ft]", "a stress [lbf/ft^2]", "slips first [s]"))
    write(rows, tmp_path, 1, runs)
    named = [line.split(",")[1:3] for line in (tmp_path / "converge.csv").read_text().splitlines()]
    assert named[0] == ["name", "unit"] and ["a stress", "lbf/ft^2"] in named


def test_what_is_told():
    """Of tips in one line and without a mark; what two levels assume; a mark for what is not to be trusted."""

    def told(rows, *how):
        text = io.StringIO()
        tell(rows, Console(file=text, width=120), *how)
        return [line.rstrip() for line in text.getvalue().splitlines()]

    low, bad = row(0.1, 0.05, least=1.0), row(0.1, 0.1, name="far slip")
    lines = told([low, bad], 3, 2, True)
    assert [line.endswith("!") for line in lines if "there slip" in line] == [False, False]
    assert [line.endswith("!") for line in lines if line.startswith("probe")] == [False, True]
    assert "orders below the method's, 2: there slip: tips of fractures in rock" in lines
    assert "! not to be trusted: far slip: differences do not fall" in lines
    assert "errors assume 1, that of fractures' tips in rock" in told([row(0.1, least=1.0)], 2, 2, True)[-1]
    assert "errors are less where these open or slide" in told([row(0.1, least=1.0)], 2, 2, True, True)[-1]
    assert "errors assume that of the method, 2" in told([row(0.1)], 2, 2)[-1]
