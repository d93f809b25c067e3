"""Places of labels in a map: beside what they name, off each other, and off lines where that can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ALONG = (
    0.5,
    0.4,
    0.6,
    0.3,
    0.7,
    0.2,
    0.8,
    0.1,
    0.9,
    0.45,
    0.55,
    0.35,
    0.65,
    0.25,
    0.75,
    0.15,
    0.85,
    0.03,
    0.97,
)  # of the length of a trace, where a label may stand
GAP = 2.0  # between a label and its line, in the unit of the sizes
MOST_CROSSED = 1  # lines that the name of a trace may stand on at worst
NEAR = 0.5  # of a line crossed: the cost of a name that nearly touches another or a mark


@dataclass(frozen=True)
class Label:
    """A label to be placed.

    size     width and height
    centres  (k, 2) where it may stand, the best first
    crosses  lines that it may stand on at worst
    """

    size: tuple[float, float]
    centres: Floats
    crosses: int = MOST_CROSSED


def beside_trace(trace: Floats, size: tuple[float, float], clear: float = 0.0) -> Label:
    """Candidates on both sides of a trace (k, 2) at parts of its length and beyond its ends, ``clear`` and a gap away."""
    steps = np.linalg.norm(np.diff(trace, axis=0), axis=1)
    trace, steps = trace[np.r_[True, steps > 0.0]], steps[steps > 0.0]
    if not len(steps):
        return Label(size, np.zeros((0, 2)))
    along = np.r_[0.0, np.cumsum(steps)]
    at = np.array(ALONG) * along[-1]
    piece = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(steps) - 1)
    tangent = np.diff(trace, axis=0)[piece] / steps[piece, None]
    point = trace[piece] + (at - along[piece])[:, None] * tangent
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal *= np.where((normal[:, 1] < 0.0) | ((normal[:, 1] == 0.0) & (normal[:, 0] < 0.0)), -1.0, 1.0)[:, None]
    half = 0.5 * np.array(size)
    away = (np.abs(normal) @ half + GAP + clear)[:, None] * normal
    sides = np.stack([point + away, point - away], axis=1).reshape(-1, 2)
    outward = np.stack([trace[0] - trace[1], trace[-1] - trace[-2]]) / steps[[0, -1], None]
    beyond = trace[[0, -1]] + (half / np.abs(outward).max(axis=1, keepdims=True) + GAP + clear) * outward
    return Label(size, np.concatenate([sides, beyond]))


def beside_point(point: Floats, size: tuple[float, float], mark: float, clear: float = 0.0) -> Label:
    """Candidates around a mark of that radius at a point (2,): right, left, above, below and the corners between.

    clear  half the width of lines that may cross at the point
    """
    away = 0.5 * np.array(size) + max(mark, clear) + GAP
    around = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)]
    return Label(size, point + away * np.array(around), crosses=1000)


def placed(
    labels: Sequence[Label], lines: Floats, taken: Floats, bounds: Floats, clear: float = 0.0, air: float = 0.0
) -> list[Floats | None]:
    """Greedy: each label in turn at its candidate that stands on the fewest lines; None where none is free.

    lines   (m, 2, 2) ends of line pieces, which labels avoid
    taken   (n, 4) boxes, left, bottom, right, top, which they never meet
    bounds  (4,) the box that holds all labels
    clear   half the width of the lines
    air     distance from boxes that labels keep where they can
    """
    grown = np.array([-1.0, -1.0, 1.0, 1.0])
    boxes, found = [*np.reshape(taken, (-1, 4))], list[Floats | None]()
    for label in labels:
        best, least = None, label.crosses + 1.0
        half = 0.5 * np.array(label.size)
        for centre in label.centres:
            box = np.concatenate([centre - half, centre + half])
            if np.any(box[:2] < bounds[:2]) or np.any(box[2:] > bounds[2:]) or _meets(box, np.reshape(boxes, (-1, 4))):
                continue
            cost = float(crossing(lines, box + clear * grown).sum())
            cost += NEAR * _meets(box + air * grown, np.reshape(boxes, (-1, 4)))
            if cost < least:
                best, least = box, cost
            if not cost:
                break
        if best is not None:
            boxes.append(best)
        found.append(None if best is None else 0.5 * (best[:2] + best[2:]))
    return found


def _meets(box: Floats, others: Floats) -> bool:
    return bool(np.any(np.all((box[:2] < others[:, 2:]) & (others[:, :2] < box[2:]), axis=1)))


def crossing(lines: Floats, box: Floats) -> NDArray[np.bool_]:
    """Whether each line piece (m, 2, 2) has a point within a box (4,): clipped to its slabs, something is left."""
    start, step = lines[:, 0], lines[:, 1] - lines[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        enter, leave = (box[:2] - start) / step, (box[2:] - start) / step
    within = (box[:2] <= start) & (start <= box[2:])
    is_still = step == 0.0
    near = np.where(is_still, np.where(within, 0.0, np.inf), np.fmin(enter, leave)).max(axis=1, initial=0.0)
    far = np.where(is_still, np.where(within, 1.0, -np.inf), np.fmax(enter, leave)).min(axis=1, initial=1.0)
    return np.asarray(near <= far)
