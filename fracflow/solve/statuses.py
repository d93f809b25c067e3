"""Statuses of sections from round to round of a step, each held while the balance is found.

Laws let a section slide that is at its strength, up to the round-off of its elastic trial. Where the balance would then carry
it backward it sticks, is at its strength again, and so on without end. So a section that sliding has carried backward in a step
slides again only beyond that round-off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracflow.laws.friction import ONSET_ROUND_OFF
from fracflow.mesh.data import Bools
from fracflow.model.joints import Joints
from fracflow.model.state import SectionHistory, Sections


class Statuses(NamedTuple):
    """Those of a round.

    history  of the sections before the step, with the present statuses
    refused  (s,) sections that sliding has carried backward in this step
    """

    history: SectionHistory
    refused: Bools

    @staticmethod
    def of(sections: Sections) -> Statuses:
        """As a step begins after these sections."""
        return Statuses(sections.history, np.zeros(len(sections.strain), dtype=bool))

    def after(self, joints: Joints, before: SectionHistory, held: Sections, found: Sections) -> tuple[Statuses, Bools]:
        """The next ones, and which (s,) of this rank's sections have changed.

        held   the sections with the present statuses, and ``found`` as the laws have them without
        """
        reached, kept = joints.with_status(before, found.history), self.refused & _barely_slides(held, found)
        if kept.any():
            reached = joints.with_other_status(held.strain, reached, kept)
        refused = self.refused | (held.is_sliding & ~found.is_sliding & ~found.is_open)
        return Statuses(reached, refused), joints.have_changed(self.history, reached)


def _barely_slides(held: Sections, found: Sections) -> Bools:
    """Sections (s,) that stick, and would slide by no more than the round-off of their elastic trial."""
    carried = (np.abs(held.tangent) @ np.abs(held.strain)[:, :, None])[:, :-1, 0].sum(axis=1)
    strength = np.abs(found.strength)
    with np.errstate(invalid="ignore"):  # of laws without a strength
        near = found.margin * strength <= ONSET_ROUND_OFF * (strength + carried)
    return ~held.is_sliding & found.is_sliding & near
