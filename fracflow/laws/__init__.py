"""Laws of matter: pure functions and frozen parameters, NumPy only."""

from .base import JointLaw, JointResponse
from .hyperbolic_coulomb import HyperbolicCoulomb
from .linear import Linear

JOINT_LAWS: dict[str, type] = {
    "hyperbolic-coulomb": HyperbolicCoulomb,
    "linear": Linear,
}

__all__ = ["JOINT_LAWS", "HyperbolicCoulomb", "JointLaw", "JointResponse", "Linear"]
