"""The input and output of a joint law, and of the law of a term."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import Field, dataclass, field, fields
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Parameter = float | Floats
History = Mapping[str, Floats]
Kind = Literal["shear", "scalar"]


@dataclass(frozen=True)
class HistoryVariable:
    """Meaning of one history variable of a law, for checkpoints and for output.

    kind       "shear" (n, dim-1), in the directions of the shear traction, or "scalar" (n,)
    dimension  as scenes write them: "1", "length", "time", "force/length**2", ...
    published  it is a quantity of its own in output; False where another quantity says the same
    """

    kind: Kind
    dimension: str
    meaning: str
    published: bool = True


@dataclass(frozen=True)
class LawStep:
    """The way from the accepted history of a section to the instant at which its law is evaluated.

    time     at that instant [time]; a number, or (n,) where sections are looked at one by one
    dt       since the history was accepted [time], as ``time``; 0: at once, in which no finite rate moves anything
    inertia  the rock has inertia on that way
    hold     every section keeps the status that it has in the history
    """

    time: Parameter = 0.0
    dt: Parameter = 0.0
    inertia: bool = False
    hold: bool = False

    def of(self, sections: NDArray[Any]) -> LawStep:
        """The same step for some sections, by their numbers (n,)."""
        time, dt = (value if np.ndim(value) == 0 else np.asarray(value)[sections] for value in (self.time, self.dt))
        return LawStep(time, dt, self.inertia, self.hold)


INSTANT, HELD = LawStep(), LawStep(hold=True)


@dataclass(frozen=True)
class Key:
    """A parameter as a scene reads it: meaning, dimension ("1" without), range.

    not_above  another parameter of the law that it may not exceed
    choices    the words that it may be, where it is no number; the law takes one, or an array (n,) of them
    """

    meaning: str
    dimension: str = "1"
    limits: Mapping[str, float] = field(default_factory=dict)
    not_above: str = ""
    choices: tuple[str, ...] = ()


def key(
    meaning: str, dimension: str = "1", not_above: str = "", choices: tuple[str, ...] = (), **limits: float
) -> dict[str, Key]:
    """Metadata of a dataclass field that scenes give by its name; without a default of the field they must.

    limits  "above", "at_least", "below", "at_most"
    """
    return {"key": Key(meaning, dimension, limits, not_above, choices)}


def parameters_of(law: type[Any]) -> tuple[Field[Any], ...]:
    """All parameters of a law, in order."""
    return fields(law)


def keys_of(law: Any) -> dict[str, Key]:
    """The parameters that a law declares with ``key``, by name."""
    return {each.name: each.metadata["key"] for each in fields(law) if "key" in each.metadata}


@dataclass(frozen=True, eq=False)
class JointResponse:
    """(2.10b) Response of n joint sections to a strain; components (s, n), normal last, tension positive.

    traction    (n, dim)       effective traction [stress]
    tangent     (n, dim, dim)  d traction_i / d strain_j [stress/length]
    stored      (n,)           stored energy since the initial state, int f d eps_e [stress x length]
    inelastic   (n, dim)       inelastic strain: plastic slip, and last the opening that it brings, dilation [length]
    strength    (n,)           (2.12) peak shear strength at the present normal traction; inf without limit [stress]
    utilisation (n,)           shear traction over peak strength; 0 where open or without limit
    is_sliding  (n,)           the section is on its sliding branch
    is_open     (n,)           the walls have lost contact
    margin      (n,)           dimensionless distance >= 0 of the choice of status from its threshold
    history     name -> array  the new history; accepted with the step
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
    history: dict[str, Floats]


class JointLaw(Protocol):
    """Frozen parameters, pure functions of strain, history and step; ``status`` is the latched part of ``history``.

    Parameters of its own are declared with ``key``; a scene refuses those of other laws, unless ``passes_over`` is set. A
    law that inherits the bodies here has no history, no status, no strength, and walls that never part. One with a rate
    has no status either: its traction follows its slip without choice.

    slides        whether its plastic slip may grow
    opens         whether its walls may part
    creeps        whether it slips at any traction, at a rate that depends on it; steps follow its ``slip_rate``
    weakens_over  key of the slip over which its strength falls; empty where it has none
    no_drop       setting with which its strength does not drop at once; empty where it never does
    compiled      number of its copy in the plane, in ``friction.h`` or ``joints.c``. It is not inherited, since a
                  law that inherits may respond otherwise. None without a copy
    """

    history: ClassVar[dict[str, HistoryVariable]] = {}
    status: ClassVar[tuple[str, ...]] = ()
    passes_over: ClassVar[bool] = False
    slides: ClassVar[bool] = False
    opens: ClassVar[bool] = False
    creeps: ClassVar[bool] = False
    weakens_over: ClassVar[str] = ""
    no_drop: ClassVar[str] = ""
    compiled: ClassVar[int | None] = None

    def initial_history(self, sections: int, dim: int) -> dict[str, Floats]:
        """History of the initial state, one array a name: "shear" (n, dim-1), "scalar" (n,)."""
        return zero_history(self.history, sections, dim)

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """Response to the total strain (n, dim) after ``history``, which stays as it is.

        At most one change of status a section, none with ``step.hold``.
        """
        ...

    def has_changed(self, old: History, new: History) -> Bools:
        """Whether each section (n,) has another status in ``new`` than in ``old``."""
        return np.zeros(len(next(iter(new.values()), ())), dtype=bool)

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Largest fraction (n,) of the increment (n, dim) that may be taken from a strain less the dilation there; or inf."""
        return np.full(len(strain), np.inf)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of the increment (n, dim), above 0, at which the walls part or meet; inf where they do neither.

        ``strain`` is without the dilation there.
        """
        return np.full(len(strain), np.inf)

    def approach(self, strain: Floats, change: Floats, history: History, step: LawStep = INSTANT) -> Floats:
        """Two distances (n, 2) from the next event, of friction and of contact; only their signs and zeros count.

        strain  (n, dim) at the instant looked at
        change  (n, dim) its rate there times the time step
        step    from the history to that instant; ``dt`` may be (n,)

        That of friction is positive while the status in ``history`` lasts, and falls through zero where it ends. That of
        contact is positive where the walls are apart, negative where they touch. Infinite for never.
        """
        return np.full((len(strain), 2), np.inf)

    def with_other_status(self, strain: Floats, history: History, chosen: Bools) -> dict[str, Floats]:
        """``history`` with the other status of friction at the chosen sections (n,)."""
        return dict(history)

    def steepness(self, traction: Floats, history: History) -> Floats:
        """How fast the strength (n,) falls with slip after ``history``, over the shear stiffness, at tractions (n, dim).

        From 1 on the joint cannot unload as fast as its strength falls: it jumps, however stiff the rock is.
        """
        return np.zeros(len(traction))

    def most_steepness(self, compression: float) -> float:
        """No ``steepness`` is larger where no section has a larger ``compression`` [stress]."""
        return 0.0

    def softening(self, traction: Floats, history: History) -> Floats:
        """How fast the strength (n,) falls with slip after ``history`` at tractions (n, dim) [stress/length]."""
        return np.zeros(len(traction))

    def strength_drop(self, compression: Floats) -> Floats:
        """By how much strength (n,) falls in all once a section slips under a ``compression`` (n,) >= 0 [stress]."""
        return np.zeros(len(compression))

    def slip_length(self, sections: int) -> Floats:
        """Slip (n,) over which it does: 0 where it falls at once, inf where it does not fall [length]."""
        return np.full(sections, np.inf)

    def state_length(self, history: History) -> Floats:
        """Slip (n,) over which the friction's state evolves after ``history``, for steps to resolve; inf without [length]."""
        return np.full(len(next(iter(history.values()), ())), np.inf)

    def front_length(self, history: History) -> Floats:
        """The same (n,) at a front of fast slip that comes after ``history``, for joints to resolve [length]."""
        return self.state_length(history)

    def slip_rate(self, history: History) -> Floats:
        """Rate (n,) of plastic slip after ``history``, of a law that creeps [length/time]."""
        return np.zeros(len(next(iter(history.values()), ())))

    def contact_age(self, history: History) -> Floats:
        """The friction's state theta (n,) after ``history``; not a number of a law without a state [time]."""
        return np.full(len(next(iter(history.values()), ())), np.nan)

    def rate_effects(self, compression: Floats) -> tuple[Floats, Floats]:
        """By how much strength (n,) rises where slip is e times as fast, at once, and how much of it the state takes back.

        Under a ``compression`` (n,) >= 0 [stress].
        """
        return np.zeros(len(compression)), np.zeros(len(compression))

    def radiated(self, slip: Floats, step: LawStep) -> Floats:
        """Part (n,) of the work of the traction on a plastic slip (n,) of a step that waves carry away [energy/area]."""
        return np.zeros(len(slip))


@dataclass(frozen=True)
class Leakage:
    """Fluid that leaves a fracture through both walls together, per area of it.

    rate         (n,) [length/time]
    by_pressure  (n,) its derivative by the pressure [length/(time stress)]
    by_aperture  (n,) its derivative by the aperture [1/time]
    """

    rate: Floats
    by_pressure: Floats
    by_aperture: Floats


class TermLaw(Protocol):
    """The table of a scene that its name in ``TERM_LAWS`` is the key of; its parameters are declared with ``key``.

    A law that inherits the bodies here has no effect; the first line of its own docstring names its effect.

    places  that the names of the table's ``on`` are of
    entry   of the energy balance for the work on it; an entry of work done by it begins with "work_"
    """

    places: ClassVar[Literal["sides", "fractures"]]
    entry: ClassVar[str]

    def stiffness(self, dim: int) -> Floats | None:
        """Traction against a displacement, (dim, dim) along and, last, across a side [stress/length]."""
        return None

    def damping(self, dim: int) -> Floats | None:
        """Traction against a velocity where there is inertia, (dim, dim) as for ``stiffness`` [stress time/length]."""
        return None

    def leakage(self, pressure: Floats, aperture: Floats) -> Leakage | None:
        """Leakage from a fracture at pressures (n,) [stress] and apertures (n,) [length]."""
        return None


def zero_history(history: Mapping[str, HistoryVariable], sections: int, dim: int) -> dict[str, Floats]:
    """Zeros of the shapes that ``history`` declares: (sections, dim - 1) or (sections,)."""
    shapes: dict[Kind, tuple[int, ...]] = {"shear": (sections, dim - 1), "scalar": (sections,)}
    return {name: np.zeros(shapes[variable.kind]) for name, variable in history.items()}


def published_history(laws: Iterable[JointLaw | type[JointLaw]]) -> dict[str, HistoryVariable]:
    """History variables of these laws that output publishes, by name. Raises ValueError where two differ under one name."""
    found: dict[str, HistoryVariable] = {}
    for law in laws:
        for name, variable in law.history.items():
            if variable.published and found.setdefault(name, variable) != variable:
                raise ValueError(f"two joint laws give different meanings to the history variable {name}")
    return found


def per_section(value: Parameter, sections: int) -> Floats:
    """A parameter as an array (n,)."""
    array = np.asarray(value, dtype=float)
    if array.shape == (sections,):
        return array
    return np.full(sections, array)  # laws are evaluated often: a view of one number takes twice as long to make


def per_tangent(value: Parameter, sections: int, tangents: int) -> Floats:
    """A shear parameter as an array (n, dim-1); a number, (n,) in two dimensions, or (n, dim-1)."""
    array = np.asarray(value, dtype=float)
    return np.broadcast_to(array[:, None] if array.ndim == 1 else array, (sections, tangents))
