"""``scripts/figures work-precision`` on a coarse level: every method is as exact as it was, or refuses."""

from dataclasses import replace

import numpy as np
import pytest
from figures_work_precision.problem import Method, Point, cheapest, front, measure, over_front
from figures_work_precision.problems import PROBLEMS, w6

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
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
