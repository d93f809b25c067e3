"""Tables of a scene that add terms to the balances, and what others ask of them; those of ``TERM_LAWS`` are made here."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import Field, create_model

from fracflow.laws import TERM_LAWS, TermLaw, keys_of
from fracflow.scene.boundary import Names
from fracflow.scene.method import Table
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import Quantity


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
