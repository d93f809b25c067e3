"""Requests of a load step for its parts, and outcomes of the wrappers of a way to advance."""

from types import SimpleNamespace

import pytest

from fracflow.advance.outcome import Outcome
from fracflow.advance.stage import SplitAtJumps
from fracflow.model.state import StepReport
from fracflow.solve.leapfrog.ahead import StepsAhead
from fracflow.solve.request import LoadStep

pytestmark = pytest.mark.serial

HALF = LoadStep(start=10.0, number=3, spacing=2.0, length=1.0, following=0.0, controls={"p": 3.0}, loads=None)


class Straight:
    """Goes wherever it is asked to, and keeps what it was asked."""

    def __init__(self):
        self.asked = []

    def advance(self, state, request):
        self.asked.append(request)
        return Outcome(at(request.controls), StepReport(), request.end)


def at(controls):
    return SimpleNamespace(controls=controls, destroy=lambda: None)


def test_parts_of_the_last_shorter_step_of_a_stage():
    """It is the third, from 14 to 15: halves of it are as long as what follows them, but for the last."""
    first, last = HALF.part({"p": 1.0}, 0.0, 0.5), HALF.part({"p": 2.0}, 0.5, 1.0)
    assert (first.time, first.length, first.next_length, first.controls) == (14.5, 0.5, 0.5, {"p": 2.0})
    assert (last.time, last.length, last.next_length, last.controls) == (15.0, 0.5, 0.0, {"p": 3.0})


def test_the_rest_of_the_step_follows_a_part_that_is_shortened():
    part = HALF.part({"p": 1.0}, 0.0, 0.5).shortened({"p": 1.0}, 0.5)
    assert (part.time, part.length, part.end, part.next_length) == (14.25, 0.25, 0.25, 0.75)
    assert part.controls == {"p": 1.5}


def test_what_jumps_arrives_evenly_over_the_parts_unless_a_film_fills():
    dry = LoadStep(0.0, 1, 1.0, 1.0, 1.0, {}, None, ends=(0.5,), jumps=(0.5,), fills=False)
    assert [dry.part({}, begin, begin + 0.25).unapplied for begin in (0.0, 0.25, 0.5)] == [0.5, 0.0, 0.5]
    assert HALF.part({"p": 1.0}, 0.0, 0.5).unapplied == 0.0


def test_a_part_ends_at_a_jump_and_is_followed_by_none():
    """A bend only ends a part; after a jump the state is taken over anew, but not where the stage ends."""
    inner, entered = Straight(), []
    stepping = SimpleNamespace(enter=lambda state, stepper, ahead: entered.append(ahead) or state)
    split = SplitAtJumps(inner, stepping, None, renews=True)
    step = LoadStep(0.0, 1, 1.0, 1.0, 1.0, {}, None, ends=(0.25, 0.5), jumps=(0.5,))
    bend = split.advance(at({}), step.part({}, 0.0, 1.0))
    assert (bend.reached, bend.foreseen, entered, inner.asked[0].next_length) == (0.25, True, [], 0.25)
    jump = split.advance(at({}), step.part({}, 0.25, 1.0))
    assert (jump.reached, jump.foreseen, entered, inner.asked[1].next_length) == (0.5, True, [0.5], 0.0)
    rest = split.advance(at({}), step.part({}, 0.5, 1.0))
    assert (rest.reached, rest.foreseen, entered) == (1.0, False, [0.5])


def test_explicit_substeps_are_equal_and_know_what_follows_them():
    steps = StepsAhead(HALF.part({"p": 1.0}, 0.0, 1.0), {"p": 1.0}, 4, 0.0)
    asked = [steps.after(done).next_one[0] for done in range(4)]
    assert [each.time for each in asked] == [14.25, 14.5, 14.75, 15.0] and {each.length for each in asked} == {0.25}
    assert [each.controls["p"] for each in asked] == [1.5, 2.0, 2.5, 3.0]
    assert [each.next_length for each in asked] == [0.25, 0.25, 0.25, 0.0]
    later = steps.after(1)
    assert (later.left, later.times(0, 3).tolist(), later.control("p", 0, 3).tolist()) == (
        3,
        [14.5, 14.75, 15.0],
        [2.0, 2.5, 3.0],
    )
    assert later.around(0, 3) == [(slice(0, 2), (0.25, 0.25)), (slice(2, 3), (0.25, 0.0))]
