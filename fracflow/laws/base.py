"""What a joint law takes and gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Parameter = float | Floats
Past = Mapping[str, Floats]
Kind = Literal["shear", "scalar"]


@dataclass(frozen=True)
class Key:
    """What a scene must know of a parameter to read it: meaning, dimension ("1" without), range.

    not_above  another parameter of the law that it may not exceed
    """

    meaning: str
    dimension: str = "1"
    limits: Mapping[str, float] = field(default_factory=dict)
    not_above: str = ""


def key(meaning: str, dimension: str = "1", not_above: str = "", **limits: float) -> dict[str, Key]:
    """Metadata of a dataclass field that scenes give by its name; without a default of the field they must.

    limits  "above", "at_least", "below", "at_most"
    """
    return {"key": Key(meaning, dimension, limits, not_above)}


def keys_of(law: Any) -> dict[str, Key]:
    """The parameters that a law declares with ``key``, by name."""
    return {each.name: each.metadata["key"] for each in fields(law) if "key" in each.metadata}


@dataclass(frozen=True, eq=False)
class JointResponse:
    """(2.10b) Answer of n joint sections to a strain; components (s, n), normal last, tension positive.

    traction    (n, dim)       effective traction [stress]
    tangent     (n, dim, dim)  d traction_i / d strain_j [stress/length]
    stored      (n,)           stored energy since the initial state, int f d eps_e [stress x length]
    inelastic   (n, dim)       inelastic strain: plastic slip in shear, 0 in normal direction [length]
    strength    (n,)           (2.12) peak shear strength at the present normal traction; inf without limit [stress]
    utilisation (n,)           shear traction over peak strength; 0 where open or without limit
    is_sliding  (n,)           the section is on its sliding branch
    is_open     (n,)           the walls have lost contact
    margin      (n,)           dimensionless distance >= 0 of the choice of status from its threshold
    past        name -> array  the new history; commit it when the step is accepted
    """

    traction: Floats
    tangent: Floats
    stored: Floats
    inelastic: Floats
    strength: Floats
    utilisation: Floats
    is_sliding: Bools
    is_open: Bools
    margin: Floats
    past: dict[str, Floats]


class JointLaw(Protocol):
    """Frozen parameters, pure functions of strain and past; ``status`` is the latched part of ``history``.

    Parameters of its own are declared with ``key``; a scene refuses those of other laws, unless ``passes_over`` is set.
    ``opens`` tells whether its walls may part.
    """

    history: ClassVar[dict[str, Kind]]
    status: ClassVar[tuple[str, ...]]
    passes_over: ClassVar[bool]
    opens: ClassVar[bool]

    def rest(self, sections: int, dim: int) -> dict[str, Floats]:
        """History of the initial state, one array a name: "shear" (n, dim-1), "scalar" (n,)."""
        ...

    def respond(self, strain: Floats, past: Past, hold: bool = False) -> JointResponse:
        """Response to the total strain (n, dim) after ``past``: at most one change of status a section, none with ``hold``."""
        ...

    def has_changed(self, old: Past, new: Past) -> Bools:
        """Whether each section (n,) has another status in ``new`` than in ``old``."""
        ...

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Largest fraction (n,) of the increment (n, dim) that may be taken; inf where there is no limit."""
        ...

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of the increment (n, dim), above 0, at which the walls part or meet; inf where they do neither."""
        ...

    def approach(self, strain: Floats, change: Floats, past: Past) -> Floats:
        """Two distances (n, 2) from the next event, of friction and of contact; only their signs and zeros count.

        strain  (n, dim) at the instant looked at
        change  (n, dim) its rate there times the time step

        That of friction is positive while the status in ``past`` lasts, and falls through zero where it ends. That of
        contact is positive where the walls are apart, negative where they touch. Infinite for never.
        """
        ...

    def flip(self, strain: Floats, past: Past, chosen: Bools) -> dict[str, Floats]:
        """``past`` with the other status of friction at the chosen sections (n,)."""
        ...

    def steepness(self, traction: Floats, past: Past) -> Floats:
        """How fast the strength (n,) falls with slip after ``past``, over the shear stiffness, at tractions (n, dim).

        From 1 on the joint cannot unload as fast as its strength falls: it jumps, however stiff the rock is.
        """
        ...


def rest_history(history: Mapping[str, Kind], sections: int, dim: int) -> dict[str, Floats]:
    """Zero arrays of the shapes that ``history`` declares."""
    shapes: dict[Kind, tuple[int, ...]] = {"shear": (sections, dim - 1), "scalar": (sections,)}
    return {name: np.zeros(shapes[kind]) for name, kind in history.items()}


def per_section(value: Parameter, sections: int) -> Floats:
    """A parameter as an array (n,)."""
    return np.broadcast_to(np.asarray(value, dtype=float), (sections,))


def per_tangent(value: Parameter, sections: int, tangents: int) -> Floats:
    """A shear parameter as an array (n, dim-1); a number, (n,) in two dimensions, or (n, dim-1)."""
    array = np.asarray(value, dtype=float)
    return np.broadcast_to(array[:, None] if array.ndim == 1 else array, (sections, tangents))
