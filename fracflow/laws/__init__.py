"""Laws of matter: pure functions and frozen parameters, NumPy only."""

from typing import Any

from .base import JointLaw, JointResponse, Key, keys_of
from .hyperbolic_coulomb import HyperbolicCoulomb
from .linear import Linear
from .slip_weakening import SlipWeakening

JOINT_LAWS: dict[str, type[Any]] = {
    "hyperbolic-coulomb": HyperbolicCoulomb,
    "linear": Linear,
    "slip-weakening": SlipWeakening,
}

__all__ = [
    "JOINT_LAWS", "HyperbolicCoulomb", "JointLaw", "JointResponse", "Key", "Linear", "SlipWeakening", "keys_of",
]  # fmt: skip
