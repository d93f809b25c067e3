from __future__ import annotations

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.output.events import EventLog, FractureNodes, read_events

pytestmark = pytest.mark.serial

NODES = FractureNodes(
    ["A", "A", "B, lower"], np.array([7, 3, 5]), np.array([0.0, 1.0, 2.0]), np.zeros(3), ["", "mid", ""]
)
NO = np.zeros(3, bool)


def flags(*which):
    return np.isin(np.arange(3), which)


def test_an_event_is_a_node_from_first_to_last_sliding_section(tmp_path):
    log = EventLog(tmp_path / "events.csv", NODES, plastic_slip=np.array([0.5, 0.0, 0.0]))
    assert read_events(log.path) == []
    assert not log.update(1.0, NO, NO, np.array([0.5, 0.0, 0.0]), np.zeros(3))
    assert log.update(2.0, flags(0, 1), NO, np.array([0.4, 0.1, 0.0]), np.array([-3.0, 1.0, 0.0]))
    assert not log.update(3.0, flags(0, 1), NO, np.array([0.2, 0.2, 0.0]), np.array([-1.0, 2.0, 0.0]))
    latest, kept = [(row["slip"], row["peak_slip_rate"]) for row in log.rows()], log.memory()["rows"]
    assert latest == [(0.2, 2.0), (pytest.approx(-0.3), 3.0)]  # under way, and not in the file yet
    np.testing.assert_array_equal(kept[:, -2:], [[2.0, 0.2], [3.0, 0.2 - 0.5]])
    first, second = read_events(log.path)  # as known when the events started
    assert (first["node"], second["node"]) == (3, 7)
    assert (first["end"], first["slip"], first["probe"]) == (None, 0.1, "mid")
    assert log.update(4.0, flags(1), flags(2), np.array([0.1, 0.3, 0.0]), np.array([-0.5, 0.5, 0.0]))
    log.update(5.0, flags(0, 1), NO, np.array([0.0, 0.4, 0.0]), np.array([-0.25, 0.5, 0.0]))
    log.close()
    rows = read_events(log.path)
    assert [(row["kind"], row["node"], row["start"], row["end"]) for row in rows] == [
        ("slip", 3, 2.0, None),
        ("slip", 7, 2.0, 4.0),
        ("open", 5, 4.0, 5.0),
        ("slip", 7, 5.0, None),
    ]
    assert [row["start_latest"] for row in rows] == [2.0, 2.0, 4.0, 5.0]
    assert [row["slip"] for row in rows] == pytest.approx([0.4, -0.4, 0.0, -0.1])
    assert [row["peak_slip_rate"] for row in rows] == [2.0, 3.0, 0.0, 0.25]
    assert rows[2]["fracture"] == "B, lower" and rows[2]["x"] == 2.0


def test_an_event_starts_where_the_step_began(tmp_path):
    log = EventLog(tmp_path / "events.csv", NODES)
    log.update(1.0, NO, NO, np.zeros(3), np.zeros(3), began=0.0)
    log.update(2.0, flags(0), flags(2), np.array([0.1, 0.0, 0.0]), np.zeros(3), began=1.0)
    log.update(3.0, NO, flags(2), np.array([0.1, 0.0, 0.0]), np.zeros(3), began=2.0)
    rows = [(row["kind"], row["node"], row["start"], row["end"]) for row in read_events(log.path)]
    assert rows == [("open", 5, 1.0, None), ("slip", 7, 1.0, 3.0)]


def test_another_table_is_refused(tmp_path):
    (tmp_path / "events.csv").write_text("a,b\n1,2\n")
    for name in ("events.csv", "none.csv"):
        with pytest.raises(InputError, match=name):
            read_events(tmp_path / name)


def test_a_log_goes_on_from_a_checkpoint_and_from_that_of_an_earlier_version(tmp_path):
    log = EventLog(tmp_path / "events.csv", NODES)
    log.update(1.0, flags(0, 1), NO, np.array([0.1, 0.0, 0.0]), np.zeros(3), began=0.5)
    log.add({"place": 2, "start": 0.5, "end": 1.0, "slip": 0.1, "peak_slip_rate": 3.0, "sections": 2, "moment": None})
    log.update(2.0, flags(1), NO, np.array([0.3, 0.0, 0.0]), np.ones(3), began=1.0)
    rows = list(log.rows())
    assert [row["kind"] for row in rows] == ["slip", "slip", "event"] and rows[2]["fracture"] == "B, lower"
    known = [{name: value for name, value in row.items() if value is not None or name == "end"} for row in rows]
    before = {"row": [-1, 0, -1], "slip_before": [0.0] * 3, "peak_rate": [0.0, 1.0, 0.0]}
    none = {"row": [-1] * 3, "slip_before": [0.0] * 3, "peak_rate": [0.0] * 3}
    lists = {"rows": known, "plastic_slip": [0.3, 0.0, 0.0], "running": {"slip": before, "open": none}}
    text = log.path.read_bytes()
    for memory in (log.memory(), lists):
        again = EventLog(tmp_path / "again.csv", NODES)
        again.remember(memory)
        assert again.path.read_bytes() == text
        again.update(3.0, NO, flags(2), np.array([0.3, 0.2, 0.0]), np.zeros(3), began=2.0)
        found = list(again.rows())
        assert [(row["kind"], row["end"]) for row in found] == [
            ("slip", 3.0),
            ("slip", 2.0),
            ("event", 1.0),
            ("open", None),
        ]
        assert (found[0]["slip"], found[0]["peak_slip_rate"], found[2]["sections"]) == (0.2, 1.0, 2)
