"""Laws of matter: pure functions and frozen parameters, NumPy only."""

from typing import Any

from fracflow.laws.base import (
    HistoryVariable,
    JointLaw,
    JointResponse,
    Key,
    LawStep,
    Leakage,
    TermLaw,
    keys_of,
    parameters_of,
    published_history,
)
from fracflow.laws.cubic_flow import Conductance, ExactCubic, FlowLaw, FrontCubic, ReportCubic
from fracflow.laws.dilation import dilating, may_dilate
from fracflow.laws.hyperbolic_coulomb import HyperbolicCoulomb
from fracflow.laws.linear import Linear
from fracflow.laws.rate_and_state import RateAndState
from fracflow.laws.roughness import PlasticSlip, Roughness
from fracflow.laws.slip_weakening import SlipWeakening

# a law from outside the package is registered here, JOINT_LAWS["name"] = Law, before any scene is read
JOINT_LAWS: dict[str, type[JointLaw]] = {
    "hyperbolic-coulomb": HyperbolicCoulomb,
    "linear": Linear,
    "rate-and-state": RateAndState,
    "slip-weakening": SlipWeakening,
}

TERM_LAWS: dict[str, type[TermLaw]] = {}
"""Laws of terms by the key of their tables in a scene; one that is added before the scene is imported has its table there."""

# of fractures without a conductance of their own, as method.conductance names them; others are registered in the same way
FLOW_LAWS: dict[str, type[FlowLaw]] = {"front": FrontCubic, "exact": ExactCubic, "report": ReportCubic}


def make_law(name: str, **parameters: Any) -> JointLaw:
    """The law of that name, with parameters as numbers or arrays (n,)."""
    kind: Any = JOINT_LAWS[name]
    made: JointLaw = kind(**parameters)
    return made


__all__ = [
    "FLOW_LAWS", "JOINT_LAWS", "TERM_LAWS", "Conductance", "FlowLaw", "HistoryVariable", "HyperbolicCoulomb", "JointLaw",
    "JointResponse", "Key", "LawStep", "Leakage", "Linear", "PlasticSlip", "RateAndState", "Roughness", "SlipWeakening",
    "TermLaw", "dilating", "keys_of", "make_law", "may_dilate", "parameters_of", "published_history",
]  # fmt: skip
