"""A hydraulic aperture that grows with slip, a law from outside the package: this file, and the line that registers it.

python tests/physics/rough_walls.py run SCENE -o DIR      the command line, with method.conductance = "rough"
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from fracflow.laws import FLOW_LAWS, LawStep
from fracflow.laws.base import Floats, History, Parameter, key
from fracflow.laws.cubic_flow import ExactCubic


@dataclass(frozen=True, eq=False)
class RoughWalls(ExactCubic):
    """Rough walls ride up: the hydraulic aperture is d0 + opening + a share of slip."""

    rides_up: Parameter = field(default=0.0, metadata=key("hydraulic aperture by slip [1]", at_least=0.0))

    knows_slip: ClassVar[bool] = True

    def hydraulic(
        self, opening: Floats, slip: Floats, history: History, step: LawStep
    ) -> tuple[Floats, Floats, Floats | None]:
        """Hydraulic aperture (n, 2), and its derivatives."""
        aperture, by_opening, _ = ExactCubic.hydraulic(self, opening, slip, history, step)
        share, size = np.broadcast_to(self.rides_up, aperture.shape), np.linalg.norm(slip, axis=2)
        direction = slip / np.where(size > 0.0, size, 1.0)[:, :, None]
        return aperture + share * size, by_opening, share[:, :, None] * direction


if __name__ == "__main__":
    FLOW_LAWS["rough"] = RoughWalls
    from fracflow.cli.app import main

    main()
