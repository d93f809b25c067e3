"""A step in parts: halved where it fails or is not accurate, longer again when calm, divided anew after an event."""

from typing import ClassVar

import pytest

from fracflow.advance.outcome import Outcome
from fracflow.advance.substeps import MOST_UNSOLVED, InSmallStrains, Rules, SubstepCursor, Substepped
from fracflow.errors import NotConverged, SolveError, Unsolved
from fracflow.model.state import StepReport
from fracflow.scene.materials import Rock
from fracflow.scene.units import UnitSystem
from fracflow.solve.request import LoadStep

pytestmark = pytest.mark.serial


class Fake:
    """A state that knows where it is, and that counts what is freed."""

    freed = 0
    controls: ClassVar = {}

    def __init__(self, at):
        self.at = at

    def destroy(self):
        type(self).freed += 1


class Inner:
    """An attempt as a way to advance."""

    def __init__(self, attempt):
        self.attempt = attempt

    def advance(self, state, request):
        return self.attempt(state, request.begin, request.end, request.may_stop)


def taken(attempt, rules, place=None, start=0.0):
    """(from, to, place after) of each part of a step; the place after the last is that before the next step."""
    steps, state, found = (
        Substepped(Inner(attempt), rules, lambda line: None, place or SubstepCursor()),
        Fake(start),
        [],
    )
    step = LoadStep(0.0, 1, 1.0, 1.0, 1.0, {}, None)
    while not found or found[-1][1] < 1.0:
        begin = steps.place.fraction
        done = steps.advance(state, step.part({}, begin, 1.0))
        state = done.state
        found.append((begin, done.reached, steps.place))
    return found


def reaching(longest=1.0, event=None, error=0.0, newton=1):
    """An attempt that converges for parts up to ``longest``, and stops at the event where it may."""
    tried = []

    def attempt(state, begin, end, may_stop):
        assert state.at == pytest.approx(begin)
        tried.append((begin, end))
        if end - begin > longest:
            raise NotConverged("too long", 3)
        at = event if event is not None and may_stop and begin < event < end else end
        wrong = error(at - begin) if callable(error) else error
        return Outcome(Fake(at), StepReport(newton=newton), at, wrong)

    attempt.tried = tried
    return attempt


def test_whole_where_it_can_be():
    assert [part[:2] for part in taken(reaching(), Rules(6))] == [(0.0, 1.0)]


def test_halves_as_few_as_converge():
    assert [part[:2] for part in taken(reaching(0.3), Rules(6))] == [(0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.0)]


def test_a_step_that_is_given_up_tells_what_was_spent_on_it():
    with pytest.raises(NotConverged) as caught:
        taken(reaching(0.001), Rules(2))
    assert (caught.value.trials, caught.value.newton) == (3, 9)


@pytest.mark.parametrize(
    ("failure", "over", "ends"), [(Unsolved, 1.1, True), (Unsolved, 0.9, False), (NotConverged, 1.1, False)]
)
def test_a_stage_that_no_solver_solves_beyond_small_strains_ends(failure, over, ends):
    """Pressures above a tenth of E: that later results are meaningless is told before; now halves do not go on."""

    def attempt(state, begin, end, may_stop):
        raise failure("no digits; more words", 3)

    state, scene = Fake(0.0), Fake(0.0)
    scene.rock, scene.well = {"rock": Rock(youngs_modulus=1e9, poissons_ratio=0.25)}, []
    scene.unit_system = UnitSystem.parse("SI")
    steps = Substepped(InSmallStrains(Inner(attempt), scene), Rules(MOST_UNSOLVED + 1), lambda line: None)
    state.max_overpressure = over * 0.1 * 1e9
    with pytest.raises(SolveError) as caught:
        steps.advance(state, LoadStep(0.0, 1, 1.0, 1.0, 1.0, {}, None).part({}, 0.0, 1.0))
    tried = MOST_UNSOLVED + 2 * (not ends)
    assert (caught.value.trials, caught.value.newton) == (tried, 3 * tried)
    assert ("strains rock of E = 1e+09 N/m^2 by over 0.1" in str(caught.value)) == ends


def test_parts_that_fail_do_not_shrink_for_ever():
    """Nothing goes past 0.3: every part that converges before leaves 6 more halvings, but of none beyond the finest."""
    tried = []

    def attempt(state, begin, end, may_stop):
        tried.append(end - begin)
        if end > 0.3:
            raise NotConverged("no solution")
        assert len(tried) < 300  # shrinking on to round-off would take more
        return Outcome(Fake(end), StepReport(newton=1), end, 0.9)

    with pytest.raises(NotConverged, match=r"no solution \(after 6 halvings of the step\)"):
        taken(attempt, Rules(6, order=1, finest=10))
    assert min(tried) == 0.5**16


def test_gives_up_by_name():
    with pytest.raises(NotConverged, match=r"too long \(after 3 halvings of the step\)"):
        taken(reaching(0.1), Rules(3))


def test_another_cause_of_earlier_substeps_is_said():
    """Of another kind: that it is the same in another fracture is not said."""
    causes = {
        1.0: NotConverged("time 1: no support in x; hold it", kind="floating"),
        0.5: NotConverged("time 0.5: fault A is too long for it"),
        0.25: NotConverged("time 0.25: fault B is too long for it"),
    }

    def attempt(state, begin, end, may_stop):
        raise causes[end - begin]

    said = r"0.25: fault B is too long for it \(after 2 halvings of the step\); before that: time 1: no support in x$"
    with pytest.raises(NotConverged, match=said):
        taken(attempt, Rules(2))


def test_the_rest_after_an_event_is_one_part_and_ends_with_the_step():
    parts = taken(reaching(event=0.3), Rules(6, events=5))
    assert [part[:2] for part in parts] == [(0.0, 0.3), (0.3, 1.0)]
    assert parts[0][2].events == 1 and parts[1][1] == 1.0


def test_events_beyond_the_most_are_not_stopped_at():
    def attempt(state, begin, end, may_stop):
        at = begin + 0.01 if may_stop else end
        return Outcome(Fake(at), StepReport(newton=1), at)

    ends = [part[1] for part in taken(attempt, Rules(6, events=3))]
    assert ends == pytest.approx([0.01, 0.02, 0.03, 1.0])


def test_goes_on_from_any_place():
    parts = taken(reaching(0.3, event=0.3), Rules(6, events=5))
    for n, (_, end, place) in enumerate(parts[:-1]):
        again = SubstepCursor.of(place.as_progress())
        assert again == place
        assert taken(reaching(0.3, event=0.3), Rules(6, events=5), again, end) == parts[n + 1 :]


def test_an_inaccurate_part_is_freed_and_halved_and_the_level_is_kept():
    Fake.freed = 0
    attempt = reaching(error=lambda length: (length / 0.5) ** 3)  # right at halves
    parts = taken(attempt, Rules(6, order=2))
    assert [part[:2] for part in parts] == [(0.0, 0.5), (0.5, 1.0)]
    assert Fake.freed == 1 and attempt.tried[0] == (0.0, 1.0)
    assert parts[-1][2].level == 1


def test_calm_parts_make_the_next_one_longer():
    place, lengths = SubstepCursor(level=3), []
    for _ in range(3):
        parts = taken(reaching(error=1e-3), Rules(6, order=2), place)
        lengths += [end - start for start, end, _ in parts]
        place = parts[-1][2]
    assert lengths == [0.125] * 6 + [0.25] * 3 + [0.5] * 3


def test_lengths_do_not_depend_on_how_iterations_are_counted():
    """Couplings count them in their own ways: a part that is accurate is followed by the same one, whatever it cost."""
    for rules in (Rules(6, order=2), Rules(6), Rules(6, order=2, finest=24, prompt=True)):
        cheap, dear = (taken(reaching(0.5, newton=newton), rules) for newton in (1, 45))
        assert cheap == dear and len(cheap) == 2


@pytest.mark.serial
def test_two_solves_of_a_step_cost_what_both_do():
    """Costs add up; what is left of the balances is what the second leaves, and what happened in the first stays known."""
    first = StepReport(3, 40, 2, 5, 1e-9, 1e-8, handed_over="why", round_off=1e-13, located=2)
    second = StepReport(1, 10, 7, 1, 1e-12, 1e-12, (1.0, 0.1), 9.5, 0.5, 0.6, round_off=1e-14, located=1)
    right = StepReport(
        4, 50, 7, 6, 1e-12, 1e-12, (1.0, 0.1), 9.5, 0.5, 0.6, handed_over="why", round_off=1e-13, located=3
    )
    assert second.after(first) == right and second.after(StepReport()) == second


def test_a_tolerance_halves_on_where_convergence_gives_up():
    """1/32 is accurate; from there a part that does not converge is halved again as often as any."""
    rules = Rules(2, order=2, finest=5)
    sizes = [end - begin for begin, end, _ in taken(reaching(error=lambda size: (size / 0.04) ** 2), rules)]
    assert sizes == [1 / 32] * 32
    wrong = reaching(longest=1 / 128, error=lambda size: (size / 0.04) ** 2)
    place = SubstepCursor(level=5)
    assert taken(wrong, rules, place)[0][:2] == (0.0, 1 / 128)
    with pytest.raises(NotConverged, match="after 2 halvings"):
        taken(reaching(longest=1 / 256), rules, place)


def test_a_tolerance_comes_at_once_to_where_errors_fall_to():
    """Of errors that fall with dt^(1/2) from 48, 2304 parts are right; the rule's order says 7, what was tried the rest."""
    attempt = reaching(error=lambda size: 48.0 * size**0.5)
    first = taken(attempt, Rules(6, order=2, finest=24))[0]
    assert [end for _, end in attempt.tried[:3]] == [1.0, 1 / 8, 1 / 512] and first[:2] == (0.0, 1 / 4096)


PROMPT = Rules(6, order=2, finest=24, prompt=True)


def test_prompt_parts_double_as_their_errors_foretell():
    """A part of 0.6 is allowed, one of 1 is not; the last two share what is left, and none doubles more than once."""
    parts = taken(reaching(error=lambda size: (size / 0.6) ** 2), PROMPT, SubstepCursor(level=6))
    ends = [end for _, end, _ in parts]
    assert ends == [1 / 64, 3 / 64, 7 / 64, 15 / 64, 31 / 64, 31 / 64 + 33 / 128, 1.0]


def test_prompt_parts_are_as_long_as_their_errors_allow():
    """3/4 of the allowed error at 0.0866, of an error of order 2: rounded down to 0.0811 = 2**-3.625, a grade of lengths."""
    attempt = reaching(error=lambda size: (size / 0.1) ** 2)
    parts = taken(attempt, PROMPT)
    sizes = [end - begin for begin, end, _ in parts]
    assert len(attempt.tried) == len(parts) + 1 and sizes[:-2] == pytest.approx(
        [2**-3.625] * (len(sizes) - 2), rel=1e-9
    )
    assert sizes[-1] == pytest.approx(sizes[-2], abs=1e-12) and parts[-1][1] == 1.0


def test_prompt_parts_keep_their_length_beyond_an_event_and_the_end_of_a_step():
    """At the event at 0.9 a tenth of the step is left; parts of 1/64 stay, in it and in the next step."""
    rules = Rules(6, order=2, events=5, finest=24, prompt=True)
    wrong = reaching(event=0.9, error=lambda size: 0.75 * (64.0 * size) ** 2)
    parts = taken(wrong, rules, SubstepCursor(level=6))
    sizes = [end - begin for begin, end, _ in parts]
    assert max(sizes) == pytest.approx(1 / 64) and sum(size > 0.99 / 64 for size in sizes) >= 61
    assert taken(wrong, rules, parts[-1][2])[0][1] == pytest.approx(1 / 64, rel=0.1)
