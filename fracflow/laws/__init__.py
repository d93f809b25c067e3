"""Laws of matter: pure functions and frozen parameters, NumPy only."""

from typing import Any

from fracflow.laws.base import JointLaw, JointResponse, Key, keys_of, parameters_of
from fracflow.laws.hyperbolic_coulomb import HyperbolicCoulomb
from fracflow.laws.linear import Linear
from fracflow.laws.slip_weakening import SlipWeakening
from fracflow.laws.terms import Leakage, TermLaw

JOINT_LAWS: dict[str, type[JointLaw]] = {
    "hyperbolic-coulomb": HyperbolicCoulomb,
    "linear": Linear,
    "slip-weakening": SlipWeakening,
}

TERM_LAWS: dict[str, type[TermLaw]] = {}
"""Laws of terms by the key of their tables in a scene; one that is added before the scene is imported has its table there."""


def make_law(name: str, **parameters: Any) -> JointLaw:
    """The law of that name, with parameters as numbers or arrays (n,)."""
    kind: Any = JOINT_LAWS[name]
    made: JointLaw = kind(**parameters)
    return made


__all__ = [
    "JOINT_LAWS", "TERM_LAWS", "HyperbolicCoulomb", "JointLaw", "JointResponse", "Key", "Leakage", "Linear",
    "SlipWeakening", "TermLaw", "keys_of", "make_law", "parameters_of",
]  # fmt: skip
