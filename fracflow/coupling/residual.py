"""How far the balances of a trial are out."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Residual:
    """Sizes of what is out of balance: largest entry over the largest of the terms that should balance, and (4.9a).

    solid, flow      largest entry, relative
    out_of_balance   Euclidean norm of the solid balance [force per thickness]
    """

    solid: float
    flow: float
    out_of_balance: float
