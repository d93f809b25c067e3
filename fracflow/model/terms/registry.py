"""The terms that a scene may have, a line each, and the operators with those of a scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from fracflow.model.operators import Operators
from fracflow.model.terms.absorbing import absorbing_sides
from fracflow.model.terms.fault_damping import fault_damping
from fracflow.model.terms.leak_off import leak_off
from fracflow.model.terms.of_laws import terms_of_laws
from fracflow.model.terms.term import Term, summed
from fracflow.model.terms.tips import tips
from fracflow.scene.scene import Scene

Maker = Callable[[Operators, Scene], Sequence[Term]]
"""Makes those terms of one kind that a scene has. Raises InputError, on every rank. Collective."""

TERMS: tuple[Maker, ...] = (
    absorbing_sides,
    fault_damping,
    leak_off,
    terms_of_laws,
    tips,
)


def with_terms(operators: Operators, scene: Scene) -> Operators:
    """The operators with the terms of a scene; K of the rock is used up. Raises InputError, on every rank. Collective."""
    terms = tuple(term for make in TERMS for term in make(operators, scene))
    stiffness = summed([operators.stiffness, *(term.stiffness for term in terms if term.stiffness is not None)])
    assert stiffness is not None
    if stiffness is not operators.stiffness:
        operators.stiffness.destroy()
    damping = summed([term.damping for term in terms if term.damping is not None])
    flow = operators.flow and replace(operators.flow, terms=tuple(term for term in terms if term.drains))
    return replace(operators, terms=terms, stiffness=stiffness, damping=damping, flow=flow)
