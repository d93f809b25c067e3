"""Solving the balances of rock and fluid of one step together."""

from fracflow.coupling.fixed_point import FixedPoint
from fracflow.coupling.monolithic import Monolithic, WholeLU

COUPLINGS = {"monolithic": Monolithic, "fixed-point": FixedPoint, "whole-lu": WholeLU}
