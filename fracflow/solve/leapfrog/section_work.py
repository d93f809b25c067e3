"""(2.27) Sections at the end of a step: their work, round-off and largest traction, in one compiled loop in the plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import Floats
from fracflow.model.energy import dissipated, joint_work
from fracflow.model.state import Sections
from fracflow.solve.leapfrog.compiled import address, library
from fracflow.solve.residual import round_off_of_jumps

RESPONSE = ("traction", "strain", "inelastic", "stored")


def taken_over(
    weights: Floats, before: Sections, found: Sections, moved: Floats, friction: Floats
) -> tuple[Sections, Floats, Floats]:
    """The sections with their records, friction (s,) after the step, and its work (5,) as of ``energy.joint_work``.

    weights   (s,) that each section stands for
    moved     (s, dim) sums of the sizes of its displacements [length]
    friction  (s,) before the step [energy/area]
    """
    loops, (count, dim) = library(), moved.shape
    if loops is None or dim != 2:
        record = np.maximum(before.record, np.linalg.norm(found.traction, axis=1))
        new = replace(found, blur=round_off_of_jumps(before.blur, moved), record=record)
        return new, friction + dissipated(before, found), joint_work(weights, before, new)
    sums, record, blur, friction = np.zeros(5), np.empty(count), np.empty((count, 2)), friction.copy()
    known = [weights, *(getattr(before, name) for name in (*RESPONSE, "record", "blur"))]
    known += [*(getattr(found, name) for name in RESPONSE), moved]
    known = [np.ascontiguousarray(each, float) for each in known]
    loops.fracflow_work(count, *map(address, (*known, record, blur, friction, sums)))
    return replace(found, blur=blur, record=record), friction, sums
