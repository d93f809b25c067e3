"""Labels of a map: none on another, none on a line where there is room."""

import numpy as np
import pytest

from fracflow.output.drawing.labels import beside_point, beside_trace, crossing, placed

pytestmark = pytest.mark.serial

BOUNDS = np.array([0.0, 0.0, 600.0, 600.0])


def boxes_of(labels, places):
    half = [0.5 * np.array(label.size) for label in labels]
    return [np.r_[at - h, at + h] for at, h in zip(places, half, strict=True) if at is not None]


def overlap(a, b):
    return bool(np.all(a[:2] < b[2:]) and np.all(b[:2] < a[2:]))


def test_sixty_names_in_a_random_network_do_not_overlap():
    start, angle = np.random.default_rng(3).uniform([60, 60, 0], [540, 540, np.pi], (60, 3)).T[:2].T, np.arange(60.0)
    ends = np.stack([start, start + 90.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)], axis=1)
    labels = [beside_trace(trace, (14.0, 9.0)) for trace in ends]
    places = placed(labels, ends, np.zeros((0, 4)), BOUNDS)
    boxes = boxes_of(labels, places)
    assert len(boxes) >= 55
    assert not any(overlap(a, b) for i, a in enumerate(boxes) for b in boxes[:i])
    assert all(np.all(box[:2] >= BOUNDS[:2]) and np.all(box[2:] <= BOUNDS[2:]) for box in boxes)
    assert sum(crossing(ends, box).any() for box in boxes) <= 3


def test_a_name_moves_away_from_a_line_across_the_middle():
    trace, line = np.array([[100.0, 100.0], [500.0, 100.0]]), np.array([[[300.0, 0.0], [300.0, 600.0]]])
    (at,) = placed([beside_trace(trace, (60.0, 10.0))], np.concatenate([trace[None], line]), np.zeros((0, 4)), BOUNDS)
    assert abs(at[0] - 300.0) > 30.0 and at[1] == pytest.approx(107.0)


def test_a_name_without_room_is_left_out():
    trace, wall = np.array([[100.0, 100.0], [120.0, 100.0]]), np.array([[0.0, 0.0, 600.0, 600.0]])
    assert placed([beside_trace(trace, (60.0, 10.0))], trace[None], wall, BOUNDS) == [None]
    assert placed([beside_trace(np.array([[1.0, 1.0], [1.0, 1.0]]), (6.0, 1.0))], trace[None], wall[:0], BOUNDS) == [
        None
    ]


def test_a_mark_keeps_its_name_off_a_line():
    label = beside_point(np.array([300.0, 300.0]), (40.0, 10.0), 5.0)
    (at,) = placed([label], np.array([[[300.0, 300.0], [600.0, 300.0]]]), np.zeros((0, 4)), BOUNDS)
    assert at[0] < 300.0


def test_at_a_crossing_of_wide_lines_a_name_stands_in_a_corner():
    """The lines are drawn 6 wide; a name 80 long keeps its box off both of them."""
    across = np.array([[[0.0, 300.0], [600.0, 300.0]], [[300.0, 0.0], [300.0, 600.0]]])
    label = beside_point(np.array([300.0, 300.0]), (80.0, 10.0), 2.0, clear=3.0)
    (at,) = placed([label], across, np.zeros((0, 4)), BOUNDS, clear=3.0)
    assert np.all(np.abs(at - 300.0) - [40.0, 5.0] > 3.0)


def test_a_name_keeps_its_distance_from_a_mark_where_it_can():
    trace, mark = np.array([[100.0, 300.0], [500.0, 300.0]]), np.array([[295.0, 295.0, 305.0, 305.0]])
    label = beside_trace(trace, (20.0, 10.0), 3.0)
    (close,), (apart,) = (placed([label], trace[None], mark, BOUNDS, air=air) for air in (0.0, 9.0))
    assert close[0] == 300.0 and abs(apart[0] - 300.0) >= 24.0


@pytest.mark.parametrize(
    ("ends", "meets"),
    [
        ([[-5, 5], [15, 5]], True),
        ([[5, 5], [6, 6]], True),
        ([[-5, 0], [0, -5.1]], False),
        ([[11, -5], [11, 15]], False),
        ([[5, -5], [5, -1]], False),
        ([[5, 5], [5, 5]], True),
        ([[50, 5], [50, 5]], False),
    ],
)
def test_a_line_meets_a_box(ends, meets):
    assert bool(crossing(np.array([ends], dtype=float), np.array([0.0, 0.0, 10.0, 10.0]))[0]) is meets
