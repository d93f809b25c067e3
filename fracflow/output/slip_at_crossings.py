"""Fractures that begin to slip where another slides: the crossing transfers stress, whose peak has no length scale.

An example has two fractures in elastic rock, one ending on the other, on cells of 10, 5, 2.5 and 1.25 m. Slip beside the
crossing converges at first order. The pressure at which the crossing itself first slips goes on falling (9.0, 8.6, 8.4, 8.2
MPa).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from fracflow.mesh.data import SplitMesh
from fracflow.output.drawing.axes import shown
from fracflow.remarks import note
from fracflow.scene.units import TIME

MOST_NODES = 2  # of a fracture in its first slip: it has spread along no more of it
MOST_LISTED = 8


@dataclass(frozen=True)
class SlipAtCrossing:
    """A fracture whose slip begins at a crossing.

    fracture  its name
    beside    the fracture that slides there already
    x, y      place of the crossing [length]
    start     when it begins [time]
    alone     how long no more than two of its nodes slip, inf where it stays so [time]
    """

    fracture: str
    beside: str
    x: float
    y: float
    start: float
    alone: float

    def text(self, units: Mapping[str, str]) -> str:
        """In words; ``units`` as for ``shown``."""
        start = shown(TIME, self.start, units, 6)
        return f"{self.fracture} beside {self.beside} at ({self.x:.6g}, {self.y:.6g}) from {start}"


def handed_on(events: Iterable[Mapping[str, Any]], mesh: SplitMesh) -> list[SlipAtCrossing]:
    """Fractures whose first slip is at a crossing with one that slides already, by descending ``alone``.

    events  rows of events.csv
    """
    slips: dict[str, list[tuple[float, int]]] = {}
    places: dict[int, tuple[float, float]] = {}
    for row in events:
        if row["kind"] == "slip":
            slips.setdefault(row["fracture"], []).append((row["start"], row["node"]))
            places[row["node"]] = (row["x"], row["y"])
    began = {name: min(rows) for name, rows in slips.items()}
    nodes = mesh.origin[mesh.joint_bottom]
    found = []
    for name, rows in slips.items():
        start = began[name][0]
        first = {node for when, node in rows if when == start}
        later = sorted({node: when for when, node in sorted(rows, reverse=True)}.values())
        for node in sorted(first) if len(first) <= MOST_NODES else ():
            here = {mesh.fractures[k] for k in mesh.joint_fracture[np.any(nodes == node, axis=1)]} - {name}
            sliding = sorted((began[other][0], other) for other in here if other in began and began[other][0] < start)
            if sliding:
                alone = later[MOST_NODES] - start if len(later) > MOST_NODES else inf
                found.append(SlipAtCrossing(name, sliding[0][1], *places[node], start, alone))
                break
    return sorted(found, key=lambda each: (-each.alone, each.start, each.fracture))


def crossing_lines(events: Iterable[Mapping[str, Any]], mesh: SplitMesh, units: Mapping[str, str]) -> list[str]:
    """A line about fractures that begin to slip at crossings, none where there are none.

    units  names of length, force and time, as for ``shown``
    """
    found = handed_on(events, mesh)
    if not found:
        return []
    more = f" and {len(found) - MOST_LISTED} more" if len(found) > MOST_LISTED else ""
    places = ", ".join(each.text(units) for each in found[:MOST_LISTED])
    line = (
        f"slip that begins where another fracture slides: {places}{more}: the"
        " sliding one hands its stress on, before the rest of the fracture comes to its strength. How much slips beside the"
        " crossing converges with the mesh; the time at which the crossing itself first slips need not"
    )
    return [note(line)]
