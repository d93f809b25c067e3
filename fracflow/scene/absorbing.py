"""The table of a scene that says which sides let waves out and in."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from fracflow.scene.boundary import Names
from fracflow.scene.method import Table
from fracflow.scene.terms import TermTable
from fracflow.scene.units import VELOCITY, Quantity, fault
from fracflow.scene.values import Tabled, TimeTable


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
