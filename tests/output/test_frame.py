"""Histories and events as pandas tables."""

from __future__ import annotations

import sys

import numpy as np
import pandas
import pytest
from stopped_run import stop_half_way

import fracflow
from fracflow.errors import InputError

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return fracflow.open(stop_half_way(tmp_path_factory.mktemp("frame")))


def test_a_row_a_state_with_all_that_the_history_has(found):
    table = found.frame()
    assert isinstance(table, pandas.DataFrame) and table.columns[0] == "time"
    assert np.array_equal(table["time"], found.times) and np.array_equal(
        table["energy/friction"], found.energy["friction"]
    )
    assert np.array_equal(table["probe/middle/displacement_y"], found.probe("middle")["displacement"][:, 1])
    assert sum(values.reshape(len(values), -1).shape[1] for values in found.history.values()) == len(table.columns)
    units = table.attrs["units"]
    assert (units["time"], units["probe/middle/displacement_y"], units["probe/middle/pressure"]) == ("s", "m", "N/m^2")


def test_a_row_an_event(found):
    table = found.frame("events")
    assert len(table) == len(found.events) > 0 and set(table["fracture"]) == {"Bruno"}
    assert np.array_equal(table["slip"], found.events["slip"]) and set(table["kind"]) <= {"slip", "open"}


def test_what_is_missing_is_one_line(found, monkeypatch):
    with pytest.raises(InputError, match='"wells" is no table; name "history" or "events"'):
        found.frame("wells")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="needs the package pandas: pip install pandas"):
        found.frame()
