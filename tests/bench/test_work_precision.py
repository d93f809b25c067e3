"""``scripts/figures work-precision`` on its coarsest levels: every method is as exact as it was, or refuses."""

import numpy as np
import pytest
from figures_work_precision.problem import Method, Point, cheapest, front, measure, over_front
from figures_work_precision.problems import PROBLEMS

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
def test_every_method_at_two_levels(problem):
    points = measure(problem, repeats=1, levels=2)
    assert {p.method.name for p in points if p.reason} == {m.name for m in problem.methods if m.fails}
    assert sum(method.default for method in problem.methods) == 1
    for coarse, fine in zip(points[::2], points[1::2], strict=True):
        assert coarse.method is fine.method
        if not fine.reason:
            assert fine.error <= (fine.method.most or problem.most), fine.method.name
            assert min(coarse.seconds, fine.seconds, coarse.work["products"], fine.work["products"]) > 0


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
