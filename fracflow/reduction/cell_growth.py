"""How fast cells grow away from fractures: rock that is coarse beside them holds them too stiffly, however fine they are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fracflow.laws import JOINT_LAWS
from fracflow.mesh.data import Floats
from fracflow.mesh.plane.traces import is_within
from fracflow.mesh.read import GROWTH
from fracflow.reduction.decision import TOLERANCE
from fracflow.remarks import note
from fracflow.scene.advice import GENTLE
from fracflow.scene.method import Geometry
from fracflow.scene.scene import Scene

OF_CELLS, OF_JOINTS = 0.28, 0.74  # missing share of a crack's opening, over growth squared, and over joint by length
OUTWEIGHS = 2.0  # times the error of joints
BEYOND = 1e-6  # of the last stretch of a trace
LATE = "beside fractures that weaken with slip, cells that grow faster let it run away late, and send its waves back"
STIFF = "cells that grow faster make a larger error than the joints do, however fine these are"


def growth_beside(scene: Scene, length: float) -> tuple[float, str]:
    """Growth of cells beside fractures of a length, and why: the error of both is alike, or slip that weakens needs less.

    Both errors are those of the opening of a crack under pressure, as ``tests/plan/test_mesh_sizes.py`` measures them.
    """
    assert scene.geometry is not None
    if weakens(scene):
        return GENTLE, LATE
    joint = scene.geometry.size_at_fractures or scene.geometry.size
    assert joint is not None
    alike = (OF_JOINTS / OF_CELLS * joint / length) ** 0.5
    return (GROWTH, "") if not 0.0 < alike < GROWTH else (float(f"{alike:.2g}"), STIFF)


def of_stated(growth: float, alike: float) -> Iterator[str]:
    """A word on a growth that leaves a larger error than the joints do at ``alike``, and than TOLERANCE."""
    missing, left = OF_CELLS * growth**2, OF_CELLS * alike**2
    if missing > max(TOLERANCE, OUTWEIGHS * left):
        yield note(
            f"geometry.growth = {growth:g}: openings are some {missing:.1%} too small, however fine the joints are;"
            f" {alike:.2g} leaves {left:.1%}"
        )


def weakens(scene: Scene) -> bool:
    """Whether the strength of a fracture falls over a length of slip."""
    assert scene.geometry is not None
    return any(JOINT_LAWS[scene.fracture_named(trace.name).law].weakens_over for trace in scene.geometry.fracture)


def has_tip(geometry: Geometry, domain: Floats) -> NDArray[np.bool_]:
    """Whether each trace ends inside the domain (k, 2): it would go on there if it were a little longer."""
    last = [
        (trace.points[at], trace.points[before]) for trace in geometry.fracture for at, before in ((0, 1), (-1, -2))
    ]
    ends = np.array(last, dtype=float).reshape(-1, 2, 2)
    ahead = ends[:, 0] + BEYOND * (ends[:, 0] - ends[:, 1])
    return np.asarray(is_within(ahead, domain).reshape(-1, 2).any(axis=1))
