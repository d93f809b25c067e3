"""``scripts/figures benchmarks`` on coarse sizes: the cheap problems keep their bars; the table and both pictures are made."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figures_benchmarks import benchmark as core
from figures_benchmarks.__main__ import beside, row, table, write
from figures_benchmarks.benchmark import DATA, Line, Other, Ran, front, measure, table_of
from figures_benchmarks.cases import BENCHMARKS, bp6
from figures_benchmarks.pictures import KINDS, chart, curves

pytestmark = pytest.mark.serial


@pytest.fixture(autouse=True)
def no_start(monkeypatch):
    """The start of a process is measured by two of them, which takes seconds."""
    monkeypatch.setattr(core, "start", lambda: 1.0)
    monkeypatch.setattr("figures_benchmarks.__main__.start", lambda: 1.0)


@pytest.mark.parametrize("problem", [each for each in BENCHMARKS if each.quick], ids=lambda each: each.short)
def test_a_problem_at_coarse_sizes(problem):
    result = measure(problem, quick=True)
    assert [outcome for outcome in result.outcomes if not outcome.ok] == []
    assert all(ran.seconds > 1.0 for ran in result.runs)
    assert result.runs[-1].lines and result.others == []
    for line in result.runs[-1].lines:
        assert len(line.found[0]) == len(line.found[1]) > 4 and len(line.right[0]) == len(line.right[1]) > 4


def test_boundary_elements_against_the_table():
    """Those of the table took steps and intervals of their own: 0.3 % apart."""
    z, slip, potency = bp6.boundary_elements(50.0, bp6.FINE)
    table = table_of("bp6_constant_friction.csv")
    assert np.interp(0.0, z, slip) == pytest.approx(table["slip_0_m"][-1], rel=3e-3)
    assert np.interp(2000.0, z, slip) == pytest.approx(table["slip_2000_m"][-1], rel=1e-2)
    assert potency[-1] == pytest.approx(table["potency_m2"][-1], rel=3e-3)
    assert np.all(np.diff(potency) >= 0.0)  # slip never goes back


def invented(problem, error):
    """The same problem with errors that grow with the size."""
    line = Line("slip", "x [m]", "slip [mm]", (np.arange(5.0), np.ones(5)), (np.arange(5.0), np.ones(5)))
    return replace(problem, run=lambda size: Ran((error * size,) * len(problem.bars), 1.0 / size, (line,)))


def test_table_and_pictures(tmp_path):
    """A missed bar is said; of another program the cheapest run as exact as ours counts, or its own best."""
    others = [
        Other("OpenGeoSys", 0.1, 0.2, True), Other("OpenGeoSys", 0.2, 0.3, True), Other("OpenGeoSys", 1e-9, 0.5, True),
        Other("PorePy", 0.05, 3.0, False),
    ]  # fmt: skip
    assert front(others[:3]) == [others[0], others[2]]
    problem = replace(invented(BENCHMARKS[0], 1e-4), sizes=(0.5, 0.25), others=lambda _: others)
    good, bad = measure(problem, Path()), measure(invented(BENCHMARKS[1], 1e3))
    assert good.ok and not bad.ok
    assert "OpenGeoSys 0.5; PorePy 3 (5.0e-02), not run here" in row(good) and row(good).endswith("| ok |")
    assert beside(measure(replace(problem, others=lambda _: others[:1]), Path())) == ["OpenGeoSys 0.2 (1.0e-01)"]
    assert "**missed**" in row(bad) and table([good, bad]).count(". Not verified: ") == 2
    write([good, bad], tmp_path)
    chart([good, bad], tmp_path, "a command")
    curves([good, bad], tmp_path, "a command")
    assert {path.name for path in tmp_path.iterdir()} == {"benchmarks.csv", "benchmarks.png", "curves.png"}
    assert (tmp_path / "benchmarks.csv").read_text().count("PorePy") == 1


def test_each_problem_has_a_look_and_each_table_a_source():
    assert sorted(each.short for each in BENCHMARKS) == sorted(name for _, names in KINDS.values() for name in names)
    for path in DATA.iterdir():
        lines = path.read_text(encoding="utf-8").splitlines()
        assert lines[0].startswith("# ") and not lines[1].startswith("#"), path.name
