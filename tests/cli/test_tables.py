"""The tables of ``check`` and of a run at 100 columns, for every scene of the repository."""

import io
import re
from functools import partial

import pytest
from pages import SCENES
from rich.console import Console

from fracflow.cli.answer import report_checks, report_plan, short_answer
from fracflow.cli.check import set_up
from fracflow.diagnostics import as_records as card_records
from fracflow.output.remarks import saved
from fracflow.reduction import as_records
from fracflow.scene.advice import advice, degrees
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial
WHOLE = [path for path in SCENES if path.name == "scene.toml"]
NARROW = 100


def printed(show, records, width) -> str:
    text = io.StringIO()
    show(records, Console(file=text, width=width, highlight=False))
    return text.getvalue()


@pytest.mark.parametrize("path", WHOLE, ids=[path.parent.name for path in WHOLE])
def test_tables_fit_and_lose_nothing(path):
    scene = load(path)
    assert not [*degrees(scene)]
    sizes, moved, numbers, decisions, _ = set_up(scene)
    for show, records in ((report_checks, card_records(numbers)), (report_plan, as_records(decisions))):
        for width in (NARROW, 300):
            lines = printed(show, records, width).splitlines()
            table = [line for line in lines if not line.startswith("! ")]
            assert max(map(len, table)) <= NARROW
            assert "…" not in "".join(lines)
    plan = printed(report_plan, as_records(decisions), NARROW)
    for each in as_records(decisions):
        words = f"{each['part']} {each['criterion']} {saved(each)}".split()
        assert [word for word in words if len(word) < 20 and word not in plan] == []
    assert plan.index("Plan: left out") < plan.index("Plan: kept")
    remarks, plan = [*advice(scene), *moved], as_records(decisions)
    answer = printed(partial(short_answer, "It", sizes, remarks, card_records(numbers)), plan, NARROW).splitlines()
    acts, notes = ([k for k, line in enumerate(answer) if re.match(mark, line)] for mark in (r"! \S", "note: "))
    assert len(answer) <= 40 and answer[0].startswith(f"It: can be run; {len(acts) or 'nothing'} ")
    assert acts == [*range(1, 1 + len(acts))] and all(k > len(acts) for k in notes)


def test_rock_without_cells_has_joints_and_the_mesh_of_its_events():
    sizes = {"cells": 0, "nodes": 28, "joints": 14, "steps": 3, "mesh of the first event, about": "1.8e+03 cells"}
    said = printed(partial(short_answer, "It", sizes, [], []), [], NARROW).splitlines()
    shown = [
        "cells: none, the rock is not meshed",
        "joints: 14",
        "steps: 3",
        "mesh of the first event, about: 1.8e+03 cells",
    ]
    assert said[1:5] == shown
    assert "joints" not in printed(partial(short_answer, "It", {**sizes, "cells": 60}, [], []), [], NARROW)
