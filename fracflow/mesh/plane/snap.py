"""How near parts of traces must come to be one, from the traces alone: a network does not depend on its mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fracflow.mesh.data import Floats
from fracflow.mesh.plane.traces import Trace, polygon_area

FRACTION = 0.004  # a pencil's line, 0.4 mm, on a map on which the median trace is 10 cm long
SPARE = 0.25  # of the shortest trace or side, which snapping must not swallow
STRETCH = 20.0  # snaps that two traces may share


def natural_snap(domain: Floats, traces: Sequence[Trace]) -> tuple[float, str]:
    """The snap of traces that state none [length], and why: 0.4 % of their median length.

    The median stays where one trace more is drawn far away. It counts at most as the width of the domain, the root of
    its area. No trace or side may be shorter than four snaps.

    domain  (k, 2) corners of a polygon [length]
    """
    lengths = np.array([np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for _, points in traces])
    sides = np.linalg.norm(np.roll(domain, -1, axis=0) - domain, axis=1)
    width, percent = float(np.sqrt(polygon_area(domain))), f"{100.0 * FRACTION:g} % of"
    found = [
        (FRACTION * width, f"{percent} the domain's width"),
        (SPARE * float(sides.min()), f"{SPARE:g} of the domain's shortest side"),
    ]
    if len(lengths):
        shortest = int(np.argmin(lengths))
        found += [
            (FRACTION * float(np.median(lengths)), f"{percent} the median length of traces"),
            (
                SPARE * float(lengths[shortest]),
                f'{SPARE:g} of the length of fracture "{traces[shortest][0]}", the shortest',
            ),
        ]
    return min(each for each in found if each[0] > 0.0)  # a domain that is none is refused by name later
