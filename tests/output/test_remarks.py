"""Lines that only inform stand apart from those that ask for a change, on a terminal and on a page."""

import pytest

from fracflow.output.remarks import FROZEN, MOST_RESULTS, alike, last_limit, saved
from fracflow.remarks import bare, counted, digits, has_mark, marked, note, parted
from fracflow.run_report.words import log_lines

pytestmark = pytest.mark.serial

NOTES = [
    note("well.injection is on Anna at (472.804, 376.916) m"),
    note("probe.middle of J3 sits on the fracture at (237.527, 154.888) m, 0.487 m from where it was asked"),
    note(
        "stage a: time steps made an error of 0.01 (estimated) of the largest displacement, accuracy.tolerance = 0.02"
    ),
]
WARNINGS = [
    "fracture.default.aperture = 1 m is unusually large: is its unit right?",
    'near miss: fracture "a": end (50, 50) is 0.4 short of fracture "b" at (50.4, 50); geometry.snap = 0.4 joins them',
    "time 4.17 h: well.injection is held at its maximum_pressure = 10 MPa, and takes less: give a higher limit",
]


def test_a_remark_is_a_warning_unless_it_is_written_as_a_note():
    assert parted([*NOTES, *WARNINGS]) == (WARNINGS, [bare(line) for line in NOTES])
    assert parted(map(marked, [*NOTES, *WARNINGS])) == (WARNINGS, [bare(line) for line in NOTES])
    assert marked(NOTES[0]) == NOTES[0] and marked(WARNINGS[0]) == marked(marked(WARNINGS[0])) == f"! {WARNINGS[0]}"
    assert has_mark(NOTES[0]) and has_mark(marked(WARNINGS[0])) and not has_mark(WARNINGS[0])


def test_a_page_has_each_line_once_with_its_head():
    log = [*NOTES, *map(marked, WARNINGS), marked(WARNINGS[2]), "fracflow 0.1.0, 1 rank: 24 cells"]
    heads = dict(log_lines(log, of_notes=False))
    assert set(heads) == {"fracture.default.aperture = 1 m is unusually large", "near miss", "time 4.17 h"}
    assert "(and 1 more like it)" in heads["time 4.17 h"]
    assert [head for head, _ in log_lines(log, of_notes=True)] == ["log", "log", "stage a"]


def test_lines_that_differ_by_names_and_numbers_are_one():
    lines = [
        f"probe.{name} sits on the fracture at ({k}, 2), 0.4 m from where it was asked" for k, name in enumerate("ABC")
    ]
    assert alike([*lines, "other"]) == [f"{lines[0]} (and 2 more like it)", "other"]
    results = [f"rock without a mesh; its stress differs by {k} MPa, {FROZEN}" for k in (1, 2, 2, *range(3, 12))]
    shown = alike(results)
    assert shown[:2] == [results[0], f"{results[1]} (and 1 more like it)"] and len(shown) == MOST_RESULTS + 1
    assert shown[-1] == f"rock without a mesh; its stress differs by 7 MPa, {FROZEN} (and 4 more like it)"


@pytest.mark.parametrize("head", ["", "within 5 min slip goes on by itself, and no state at rest is near: "])
def test_the_last_limit_point_has_its_place(head):
    line = (
        f"time 5 days: limit point: {head}fracture f (1, 2) at (-3.5e+02, 300), slipping patch 190 m, rigid rock; its"
    )
    earlier = line.replace("300", "1")
    assert last_limit([earlier, line, "x"]) == (
        "fracture f (1, 2) at (-3.5e+02, 300), slipping patch 190 m, rigid rock",
        (-350.0, 300.0),
    )
    assert last_limit([line.replace("300", "1e999")]) is None is last_limit(["limit point: somewhere"])


def test_a_verdict_is_not_said_twice():
    kept = {"verdict": "kept", "saves": "nothing: kept, it costs no more"}
    assert saved(kept) == "it costs no more" and saved({**kept, "verdict": "left out"}) == kept["saves"]


def test_numbers_in_words():
    assert [counted(1, "rank"), counted(0, "section"), counted(2, "rank")] == ["1 rank", "0 sections", "2 ranks"]
    assert [digits(530.4), digits(1234.0, 3), digits(0.00123), digits(2.5e12)] == ["530", "1230", "0.0012", "2.5e+12"]
