"""A Winkler foundation from outside the package: one law, and one line that registers it."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from fracflow.laws import TERM_LAWS, TermLaw
from fracflow.laws.base import key


@dataclass(frozen=True)
class Springs(TermLaw):
    """Springs between sides and a ground that does not move (Winkler 1867)."""

    normal_stiffness: float = field(metadata=key("k_n across the side", "force/length**3", at_least=0.0))
    shear_stiffness: float = field(default=0.0, metadata=key("k_s along the side", "force/length**3", at_least=0.0))

    places: ClassVar[str] = "sides"
    entry: ClassVar[str] = "springs"

    def stiffness(self, dim):
        return np.diag([*[self.shear_stiffness] * (dim - 1), self.normal_stiffness])


TERM_LAWS["spring"] = Springs
