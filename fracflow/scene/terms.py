"""Tables of a scene that add terms to the balances, and what others ask of them; those of ``TERM_LAWS`` are made here."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, create_model, model_validator

from fracflow.laws import TERM_LAWS, TermLaw, keys_of
from fracflow.scene.boundary import Names
from fracflow.scene.method import Table
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import VELOCITY, Quantity, fault
from fracflow.scene.values import Tabled


class TermTable(Table):
    """A table that adds a term to the balances; what one does not say, its term does not do.

    places   that ``on`` names: "sides" or "fractures"
    holds    displacements of its sides, at least where there is no inertia
    drains   its fractures: what they hold may leave
    absorbs  waves
    moving   why a stage that has inertia keeps it, whatever the loads are; empty where they decide
    """

    places: ClassVar[str] = "sides"
    holds: ClassVar[bool] = False
    drains: ClassVar[bool] = False
    absorbs: ClassVar[bool] = False
    moving: ClassVar[str] = ""

    on: Names
    """names of sides: one or a list"""

    @property
    def waves(self) -> tuple[TimeTable, ...]:
        """Velocities of the waves that come in."""
        return ()


class Wave(Table):
    """[absorbing.wave] A plane wave that comes in through absorbing sides."""

    kind: Literal["p", "s"] = "p"
    """p: the rock moves along the way of the wave; s: across it"""
    velocity: Annotated[TimeTable, Tabled(VELOCITY)]
    """velocity that it gives the rock where it arrives first: along its way, or of an s wave to the left of it
    [length/time]"""
    direction: tuple[Annotated[float, Quantity()], Annotated[float, Quantity()]] | None = None
    """[x, y], the way the wave goes, of any length: it arrives along the sides as it passes them; straight into the
    side if not given [1]"""

    @model_validator(mode="after")
    def _consistent(self) -> Wave:
        if self.direction is not None and not any(self.direction):
            raise fault("is no direction: give [x, y] other than [0, 0]", key="direction")
        return self


class Absorbing(TermTable):
    """[[absorbing]] Sides that waves leave through: dashpots rho c_p across and rho c_s along the side, of its own rock."""

    on: Names
    """names of sides: one or a list"""
    wave: Wave | None = None
    """a wave that comes in"""
    without_inertia: Literal["held", "free"] = "held"
    """in stages without inertia: held where they are, their reactions becoming loads when inertia comes in, or free,
    where loads and supports must hold the rock"""

    holds: ClassVar[bool] = True
    absorbs: ClassVar[bool] = True
    moving: ClassVar[str] = "absorbing sides, which give way to slow loads and stand still without inertia"

    @property
    def waves(self) -> tuple[TimeTable, ...]:
        """Velocity of the wave that comes in, where one does."""
        return () if self.wave is None else (self.wave.velocity,)


class LawTable(TermTable):
    """A table whose keys are those of a law in ``TERM_LAWS``."""

    law: ClassVar[type[TermLaw]]

    def made(self) -> TermLaw:
        """The law with its parameters."""
        kind: Any = self.law
        made: TermLaw = kind(**{name: getattr(self, name) for name in keys_of(self.law)})
        return made


def _meaning(law: type[TermLaw]) -> str:
    return (law.__doc__ or "").splitlines()[0].rstrip(".")


def _has(law: type[TermLaw], part: str) -> bool:
    return getattr(law, part) is not getattr(TermLaw, part)


def _table(name: str, law: type[TermLaw]) -> type[LawTable]:
    keys, found = keys_of(law), dict[str, Any]()
    for each in fields(law):  # type: ignore[arg-type]
        if (key := keys.get(each.name)) is not None:
            text = f"{key.meaning} [{key.dimension}]"
            default = ... if each.default is MISSING else each.default
            found[each.name] = Annotated[float, Quantity(key.dimension, **key.limits)], Field(default, description=text)
    on = (Names, Field(description=f"names of {law.places}: one or a list"))
    table = create_model(law.__name__, __base__=LawTable, __doc__=f"[[{name}]] {_meaning(law)}.", on=on, **found)
    table.law, table.places = law, law.places
    table.holds, table.drains = _has(law, "stiffness"), _has(law, "leakage")
    if _has(law, "damping"):
        table.moving = f"[[{name}]], which gives way to slow loads and does nothing without inertia"
    return table


if TYPE_CHECKING:
    TablesOfLaws = Table
else:
    TablesOfLaws = create_model(
        "TablesOfLaws",
        __base__=Table,
        **{
            name: (tuple[_table(name, law), ...], Field(default=(), description=_meaning(law)))
            for name, law in TERM_LAWS.items()
        },
    )
