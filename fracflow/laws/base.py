"""What a joint law takes and gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from typing import Any, ClassVar, Literal, Protocol, cast

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


def parameters_of(law: type[JointLaw]) -> tuple[Field[Any], ...]:
    """All parameters of a law, in order."""
    return fields(cast(Any, law))


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

    Parameters of its own are declared with ``key``; a scene refuses those of other laws, unless ``passes_over`` is set. A
    law that inherits the bodies here has no history, no strength, and walls that never part.

    opens         whether its walls may part
    weakens_over  key of the slip over which its strength falls; empty where it has none
    no_drop       setting with which its strength does not drop at once; empty where it never does
    """

    history: ClassVar[dict[str, Kind]] = {}
    status: ClassVar[tuple[str, ...]] = ()
    passes_over: ClassVar[bool] = False
    opens: ClassVar[bool] = False
    weakens_over: ClassVar[str] = ""
    no_drop: ClassVar[str] = ""

    def rest(self, sections: int, dim: int) -> dict[str, Floats]:
        """History of the initial state, one array a name: "shear" (n, dim-1), "scalar" (n,)."""
        return rest_history(self.history, sections, dim)

    def respond(self, strain: Floats, past: Past, hold: bool = False) -> JointResponse:
        """Response to the total strain (n, dim) after ``past``: at most one change of status a section, none with ``hold``."""
        ...

    def has_changed(self, old: Past, new: Past) -> Bools:
        """Whether each section (n,) has another status in ``new`` than in ``old``."""
        return np.zeros(len(next(iter(new.values()), ())), dtype=bool)

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Largest fraction (n,) of the increment (n, dim) that may be taken; inf where there is no limit."""
        return np.full(len(strain), np.inf)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of the increment (n, dim), above 0, at which the walls part or meet; inf where they do neither."""
        return np.full(len(strain), np.inf)

    def approach(self, strain: Floats, change: Floats, past: Past) -> Floats:
        """Two distances (n, 2) from the next event, of friction and of contact; only their signs and zeros count.

        strain  (n, dim) at the instant looked at
        change  (n, dim) its rate there times the time step

        That of friction is positive while the status in ``past`` lasts, and falls through zero where it ends. That of
        contact is positive where the walls are apart, negative where they touch. Infinite for never.
        """
        return np.full((len(strain), 2), np.inf)

    def flip(self, strain: Floats, past: Past, chosen: Bools) -> dict[str, Floats]:
        """``past`` with the other status of friction at the chosen sections (n,)."""
        return dict(past)

    def steepness(self, traction: Floats, past: Past) -> Floats:
        """How fast the strength (n,) falls with slip after ``past``, over the shear stiffness, at tractions (n, dim).

        From 1 on the joint cannot unload as fast as its strength falls: it jumps, however stiff the rock is.
        """
        return np.zeros(len(traction))

    def softening(self, traction: Floats, past: Past) -> Floats:
        """How fast the strength (n,) falls with slip after ``past`` at tractions (n, dim) [stress/length]."""
        return np.zeros(len(traction))

    def strength_drop(self, pressed: Floats) -> Floats:
        """By how much strength (n,) falls in all once a section slips under a pressure ``pressed`` (n,) >= 0 [stress]."""
        return np.zeros(len(pressed))

    def slip_length(self, sections: int) -> Floats:
        """Slip (n,) over which it does: 0 where it falls at once, inf where it does not fall [length]."""
        return np.full(sections, np.inf)


def rest_history(history: Mapping[str, Kind], sections: int, dim: int) -> dict[str, Floats]:
    """Zero arrays of the shapes that ``history`` declares."""
    shapes: dict[Kind, tuple[int, ...]] = {"shear": (sections, dim - 1), "scalar": (sections,)}
    return {name: np.zeros(shapes[kind]) for name, kind in history.items()}


def per_section(value: Parameter, sections: int) -> Floats:
    """A parameter as an array (n,)."""
    array = np.asarray(value, dtype=float)
    if array.shape == (sections,):
        return array
    return np.full(sections, array)  # laws are asked often: a view of one number takes twice as long to make


def per_tangent(value: Parameter, sections: int, tangents: int) -> Floats:
    """A shear parameter as an array (n, dim-1); a number, (n,) in two dimensions, or (n, dim-1)."""
    array = np.asarray(value, dtype=float)
    return np.broadcast_to(array[:, None] if array.ndim == 1 else array, (sections, tangents))
