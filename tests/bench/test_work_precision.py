"""``scripts/figures work-precision`` on a coarse level: every method is as exact as it was, or refuses."""

from dataclasses import replace

import numpy as np
import pytest
from figures_benchmarks.benchmark import table_of
from figures_benchmarks.cases.bp6_rate import FRONT_COLUMN, Ended
from figures_work_precision.problem import Method, Order, Point, cheapest, front, measure, over_front
from figures_work_precision.problems import PROBLEMS, w6, w10

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    "problem", [each for each in PROBLEMS if each is not w10.PROBLEM], ids=lambda problem: problem.name
)
def test_every_method_at_its_second_level(problem, monkeypatch):
    """Those that must refuse do so at their first level too. The reference of W6 is a run on larger cells here, and nearer."""
    monkeypatch.setattr(w6, "FINEST", w6.FINER[-1])
    methods = [replace(each, levels=each.levels[0 if each.fails else 1 : 2]) for each in problem.methods]
    problem = replace(problem, methods=tuple(methods), most=0.1 if problem is w6.PROBLEM else problem.most)
    points = measure(problem, repeats=1)
    assert {p.method.name for p in points if p.reason} == {m.name for m in problem.methods if m.fails}
    assert sum(method.default for method in problem.methods) == 1
    assert {p.method.name for p in points if not p.reason} == {m.name for m in problem.methods if not m.fails}
    for point in points:
        if not point.reason:
            assert point.error <= (point.method.most or problem.most), point.method.name
            assert min(point.seconds, point.work["products"]) > 0


def test_errors_of_slow_slip():
    """W10 takes too long here: its errors alone, of the reference itself, with its front a joint of 100 m behind."""
    table = table_of("bp6_rate_and_state.csv")
    right = table["slip_0_m"][-1], table["potency_m2"][-1], table["max_rate_m_per_s"].max(), table[FRONT_COLUMN][-1]
    found = w10.errors(Ended(*right[:3], right[3] - 100.0, (np.zeros(0), np.zeros(0)), 1.0, 1), 100.0, "ageing")
    assert found == {"slip": 0.0, "potency": 0.0, "rate": 0.0, "front": 1.0} and w10.worst(found) == 0.01
    assert w10.worst({"slip": 0.0, "rate": 0.04}) == 0.02
    of_slip_law = w10.errors(Ended(0.276244, 2000.0, 0.0, 0.0, (np.zeros(0), np.zeros(0)), 1.0, 1), 100.0, "slip")
    assert of_slip_law == pytest.approx({"slip": 0.0, "potency": 1.0 - 2000.0 / 2652.14053}, abs=1e-6)


def test_front_and_its_interpolation():
    """The default at error 1e-2 takes 4 s; the other passes from (1 s, 1e-1) to (4 s, 1e-3), so through 2 s there."""
    default, other, idle = (Method(name, lambda _: None, (), default=name == "a") for name in "abc")
    points = [
        Point(default, 1, 1e-2, 4.0, {}), Point(other, 1, 1e-1, 1.0, {}), Point(other, 2, 0.5, 3.0, {}),
        Point(other, 3, 1e-3, 4.0, {}), Point(idle, 1, np.nan, np.nan, {}, "diverges"),
    ]  # fmt: skip
    assert [(p.seconds, p.error) for p in front(points)] == [(1.0, 1e-1), (4.0, 1e-3)]
    ratio, worst, best = over_front(points)
    assert ratio == pytest.approx(2.0) and worst is points[0] and best == "b"
    assert cheapest(points, 0.3) == (1.0, "b")


def test_order_of_two_meshes_at_a_level():
    coarse, fine = (Method(name, lambda _: None, ()) for name in ("20 m", "5 m"))
    points = [Point(coarse, 0.9, 0.3, 1.0, {}), Point(coarse, 0.4, 0.16, 2.0, {}), Point(fine, 0.4, 0.01, 9.0, {})]
    assert Order("20 m", "5 m", 0.4, 4.0, 1.5).of(points) == pytest.approx(2.0)
