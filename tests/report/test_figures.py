"""``scripts/figures report``: every figure is drawn, its numbers are in a CSV that says where from, its bars hold."""

import sys

import pytest
from figures_report import __main__, fault, finer_fault, oscillator, rupture
from sheets import Check

pytestmark = pytest.mark.serial
FIGURES = {oscillator: (12, 13, 14), fault: (15,), finer_fault: (16, 17, 18, 19), rupture: (20, 21, 22, 23)}


@pytest.mark.parametrize("group", FIGURES, ids=lambda group: group.__name__.split(".")[-1])
def test_figures_and_their_bars(group, ran, tmp_path):
    checks = group.draw(tmp_path, ran)
    assert [check for check in checks if not check.ok] == []
    assert {int(check.name.split()[0]) for check in checks} == set(FIGURES[group])
    for number in FIGURES[group]:
        assert (tmp_path / f"fig_{number}.png").read_bytes().startswith(b"\x89PNG")
        lines = (tmp_path / f"fig_{number}.csv").read_text(encoding="utf-8").splitlines()
        head = [line for line in lines if line.startswith("# ")]
        for word in ("machine", "versions", "command: fracflow run meshes/report_5_"):
            assert any(line.startswith(f"# {word}") for line in head)
        assert any("(R)" in line for line in head)
        columns, *rows = lines[len(head) :]
        assert len(rows) > 50 and {row.count(",") for row in rows} == {columns.count(",")}


@pytest.mark.parametrize(("ok", "code"), [(True, 0), (False, 1)])
def test_a_red_bar_is_exit_code_1(ok, code, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["figures", "-o", str(tmp_path), "--only", "fault"])
    monkeypatch.setattr(fault, "draw", lambda folder, run: [Check("15 slips", 4.0, "3", ok)])
    assert __main__.main() == code
    assert ("missed" in capsys.readouterr().out) == (not ok)
