"""The tables of a scene that say what is held, loaded, pumped, watched, and in which stages."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, model_validator

from fracflow.scene.method import Count, Fraction, Name, Table
from fracflow.scene.quantities import MeasuredName
from fracflow.scene.units import FLOW_RATE, LINE_FORCE, STRESS, TIME, Quantity, fault
from fracflow.scene.values import DISPLACED, STRESSED, At, Position, Tabled, TabledVector, TimeTable

Component = Literal["x", "y", "rotation"]
Duration = Annotated[float, Quantity(TIME, above=0.0)]
Measured = Annotated[str, MeasuredName()]
Entry = Annotated[TimeTable, Tabled()]
Row = tuple[Entry, Entry]
_LISTED = BeforeValidator(lambda on: [on] if isinstance(on, str) else on)
Names = Annotated[tuple[Name, ...], Field(min_length=1, json_schema_extra={"one_is_enough": True}), _LISTED]
AnyNames = Annotated[tuple[Name, ...], Field(json_schema_extra={"one_is_enough": True}), _LISTED]


class Support(Table):
    """[[support]] Sides, points or rocks that are held, or moved as prescribed."""

    on: Names
    """names of sides, points or rocks: one or a list"""
    components: tuple[Component, ...] = Field(default=("x", "y"), min_length=1)
    """what is held; by default x and y, or the keys of displacement"""
    displacement: Annotated[dict[str, TimeTable], DISPLACED] | None = None
    """prescribed {x = ..., y = ...} [length]; rotation of a rigid rock in radians"""
    displacement_gradient: tuple[Row, Row] | None = None
    """[[du_x/dx, du_x/dy], [du_y/dx, du_y/dy]], each a number or a time table, added to displacement: a motion affine
    in x and y [1]"""

    @model_validator(mode="before")
    @classmethod
    def _follow_displacement(cls, data: Any) -> Any:
        moved = data.get("displacement") if isinstance(data, dict) else None
        if not isinstance(moved, dict) or "components" in data or "displacement_gradient" in data:
            return data
        known = [part for part in get_args(Component) if part in moved]
        return {**data, "components": known} if known else data

    @model_validator(mode="after")
    def _consistent(self) -> Support:
        moved = set(self.displacement or {})
        if not moved <= set(self.components):
            extra = ", ".join(sorted(moved - set(self.components)))
            raise fault(f"contradicts displacement, which prescribes {extra} too; leave it out", key="components")
        if self.displacement_gradient is not None and not {"x", "y"} <= set(self.components):
            raise fault("contradicts displacement_gradient, which prescribes x and y; leave it out", key="components")
        return self


class Tie(Table):
    """[[tie]] One side whose nodes move alike, as under a platen, or two facing sides that move as each other."""

    on: Names = Field(max_length=2)
    """one side, or two that a translation brings to coincide (periodic)"""
    components: tuple[Literal["x", "y"], ...] = Field(default=("x", "y"), min_length=1)
    """what is tied"""

    @model_validator(mode="after")
    def _consistent(self) -> Tie:
        if len(set(self.on)) < len(self.on):
            why = "names one side twice; give it once to let it move as one, or two that face each other"
            raise fault(why, key="on")
        return self


class Load(Table):
    """[[load]] A traction on sides, as [x, y], as a pressure, or that of the initial stress; a force on rocks; a far stress."""

    on: AnyNames = ()
    """names of sides, or of rocks where a force is given: one or a list; not with stress"""
    traction: Annotated[tuple[TimeTable, TimeTable] | str, TabledVector(STRESS, "initial-stress")] | None = None
    """[t_x, t_y] in global axes [force/length**2], or "initial-stress"
    """
    pressure: Annotated[TimeTable, Tabled(STRESS)] | None = None
    """pressure against the side, positive pushes inwards [force/length**2]"""
    force: Annotated[tuple[TimeTable, TimeTable], TabledVector(LINE_FORCE)] | None = None
    """[F_x, F_y] per unit thickness on each rock named, spread evenly over its area [force/length]"""
    stress: Annotated[dict[str, TimeTable], STRESSED] | None = None
    """{xx = ..., yy = ..., xy = ...} that is added to the initial stress of an unbounded domain, tension positive
    [force/length**2]"""
    control: Name | None = None
    """name of the [control] whose factor multiplies the load"""

    @model_validator(mode="after")
    def _consistent(self) -> Load:
        given = [key for key in ("traction", "pressure", "force", "stress") if getattr(self, key) is not None]
        if not given:
            raise fault("missing; a load needs traction, pressure or force, or stress", key="traction")
        if len(given) > 1:
            raise fault(f"contradicts {given[1]}; give one of them", key=given[0])
        if not self.on and self.stress is None:
            raise fault(f"missing; a {given[0]} needs the names of its sides or rocks: give them", key="on")
        if self.on and self.stress is not None:
            raise fault("contradicts stress, which is far from all sides; leave it out", key="on")
        if self.control is not None and self.traction == "initial-stress":
            raise fault('contradicts traction = "initial-stress", which has no factor; remove one', key="control")
        return self


class Well(Table):
    """[[well]] A place where fluid is pumped in or out, or its pressure is kept; or all fracture ends on a side.

    On a side a pressure holds at each end. A flow_rate is that of all ends together: they are one node of the network, with
    one pressure, so each takes its share by its conductance.
    """

    name: Name
    """name of the well"""
    at: Annotated[Position, At()] | None = None
    """[x, y] [length], the name of a point, or {fracture = "name", end = "start" or "end"}; for end may stand at = the
    distance from its start [length], or fraction = 0 to 1 of its length"""
    on: Name | None = None
    """in place of at: a side, of which all fracture ends are the well; a flow_rate is shared by conductance at one
    pressure"""
    flow_rate: Annotated[TimeTable, Tabled(FLOW_RATE)] | None = None
    """volume pumped in per time, over the whole flow_depth [length**3/time]"""
    pressure: Annotated[TimeTable | str, Tabled(STRESS, "initial")] | None = None
    """pressure kept [force/length**2], or "initial"
    """
    control: Name | None = None
    """name of the [control] whose factor multiplies flow_rate"""
    maximum_pressure: Annotated[float, Quantity(STRESS)] | None = None
    """pressure that pumping must not exceed: the well then takes what it can, and is shut while the pressure around it is
    higher [force/length**2]"""
    minimum_pressure: Annotated[float, Quantity(STRESS)] | None = None
    """pressure below which it must not draw: it then gives what it can, and is shut while the pressure around it is lower
    [force/length**2]"""

    @model_validator(mode="after")
    def _consistent(self) -> Well:
        if self.at is None and self.on is None:
            raise fault("missing; a well needs a place, or on = a side", key="at")
        if self.at is not None and self.on is not None:
            raise fault(
                "contradicts at: on is a side, and a well at a place is on the fracture there; give one", key="on"
            )
        if self.flow_rate is None and self.pressure is None:
            raise fault("missing; a well needs flow_rate or pressure", key="flow_rate")
        if self.flow_rate is not None and self.pressure is not None:
            raise fault("contradicts flow_rate; give one of them", key="pressure")
        if self.pressure is not None:
            self._refuse("contradicts pressure; a limit belongs to a flow_rate", "maximum_pressure", "minimum_pressure")
            self._refuse("contradicts pressure; a control multiplies a flow_rate", "control")
        most, least = self.maximum_pressure, self.minimum_pressure
        if most is not None and least is not None and most <= least:
            raise fault(f"must be above minimum_pressure = {least:g}; raise it, or lower that", key="maximum_pressure")
        return self


class Control(Table):
    """[control.NAME] A factor that several wells or loads share, and that a stage may search."""

    initial: Annotated[float, Quantity()] = 0.0
    """value at the start [1]"""
    increment: Annotated[float, Quantity(above=0.0)] = 1.0
    """first guess of the search for failure, in the unit of the factor itself [1]"""


class Probe(Table):
    """[[probe]] A place whose history is written."""

    name: Name
    """name in the run folder"""
    at: Annotated[Position, At()]
    """[x, y] [length], the name of a point, or {fracture = "name", end = "start" or "end"}; for end may stand at = the
    distance from its start [length], or fraction = 0 to 1 of its length"""
    on: Name | None = None
    """fracture or rock that is meant, where several meet at the place"""
    quantities: tuple[Measured, ...] | None = None
    """what to write; all there is if not given; slip_rate is that of the instant: in waves behind sharp fronts it rings
    with periods of a few cell transits h/c_s, which finer cells do not lessen; read slip, or its increase over at least
    8 h/c_s"""


class Stage(Table):
    """[[stage]] A part of the run."""

    name: Name | None = None
    """name by which --set and the log call the stage"""
    kind: Literal["equilibrate", "steady", "quasi-static", "dynamic", "auto"]
    """equilibrate: from an initial state out of balance to rest, at the initial pressure, in no time; steady: no
    storage, no inertia; quasi-static: no inertia; dynamic: both; auto: quasi-static but while slip runs away"""
    end: Annotated[float, Quantity(TIME)] | None = None
    """time at which the stage ends [time]"""
    time_step: Duration | None = None
    """time step; of a stage auto, the longest one without inertia; a steady stage of a number of steps may do without,
    and takes no time [time]"""
    dynamic_time_step: Duration | None = None
    """of a stage auto: step with inertia, and how well an onset is known; by default what a P wave takes through a
    typical joint, at most a fiftieth of the longest period [time]"""
    at_rest: Fraction = 1e-3
    """of a stage auto: an event is over when kinetic energy stays below this share of its peak [1]"""
    rest_periods: Annotated[float, Quantity(above=0.0)] = 1.0
    """for so many of the longest periods of vibration; below 1 may cut events short [1]"""
    steps: Count | None = None
    """number of steps, in place of end; increments of a stage that equilibrates"""
    until: Literal["incipient"] | None = None
    """incipient: raise the control until the first section is about to slip"""
    control: Name | None = None
    """name of the [control] that the stage raises"""
    tolerance: Fraction = 1e-6
    """of the search: strength (1 - tolerance) f_sy is used up when it ends [1]"""
    increment_per_step: Annotated[float, Quantity(above=0.0)] | None = None
    """raise of the control each step over its value at the start of the stage [1]"""
    then: Literal["hold"] | None = None
    """hold: keep the control after the first failure"""

    @model_validator(mode="after")
    def _consistent(self) -> Stage:
        asking = [key for key in ("until", "increment_per_step", "then") if getattr(self, key) is not None]
        if asking and self.control is None:
            raise fault(f"missing; {asking[0]} needs the name of a [control]", key="control")
        if self.until is not None and self.increment_per_step is not None:
            raise fault("contradicts until, which finds its own increments; leave it out", key="increment_per_step")
        if self.then is not None and self.increment_per_step is None:
            raise fault("needs increment_per_step: there is nothing to hold; give it, or leave then out", key="then")
        self._check_time()
        return self

    def _check_time(self) -> None:
        if self.kind == "equilibrate":
            why = 'contradicts kind = "equilibrate", which takes no time and only steps; leave it out'
            return self._refuse(why, "time_step", "end", "until", "control", "increment_per_step")
        if self.takes_no_time:
            why = "contradicts a steady stage until incipient, which takes no time; leave it out"
            return self._refuse(why, "time_step", "end", "steps")
        if self.kind == "auto":
            why = 'contradicts kind = "auto", which chooses its steps until end; leave it out'
            self._refuse(why, "steps", "until", "control", "increment_per_step")
        else:
            self._refuse(f'contradicts kind = "{self.kind}"; it belongs to kind = "auto"', "dynamic_time_step")
        if self.kind == "dynamic":
            self._refuse('contradicts kind = "dynamic"; allowed kinds: "steady", "quasi-static"', "until")
        stands_still = self.kind == "steady" and self.steps is not None and self.end is None
        if self.time_step is None and not stands_still:
            raise fault(f"missing; a stage of kind {self.kind} needs it", key="time_step")
        if self.until is None and self.end is None and self.steps is None:
            raise fault(f"missing; a stage of kind {self.kind} needs end or steps", key="end")
        if self.end is not None:
            self._refuse(f"contradicts end = {self.end:g}; give one of them", "steps")

    @property
    def title(self) -> str:
        """The stage in the log and in messages: its name, or its kind."""
        return self.name or self.kind

    @property
    def takes_no_time(self) -> bool:
        """Whether the stage only searches a steady state, at a standing clock."""
        return self.kind == "equilibrate" or (self.kind == "steady" and self.until is not None)

    def step_length(self, start: float, number: int = 1) -> float:
        """Length of step ``number`` (from 1) of a stage that begins at ``start``, 0 if it has none; one ends at ``end``."""
        if self.time_step is None or self.end is None or number != self.step_count(start):
            return self.time_step or 0.0
        last = self.end - start - (number - 1) * self.time_step
        return self.time_step if abs(last - self.time_step) <= 1e-9 * self.time_step else last

    def finish(self, start: float) -> float:
        """When the stage ends that begins at ``start``, as far as the scene bounds it."""
        count = self.step_count(start) or 0
        return start + max(count - 1, 0) * (self.time_step or 0.0) + (self.step_length(start, count) if count else 0.0)

    def step_count(self, start: float) -> int | None:
        """Count the steps of a stage that begins at ``start`` until ``end``; None where nothing bounds it."""
        if self.steps is not None or self.end is None or self.time_step is None:
            return self.steps
        return max(0, math.ceil((self.end - start) / self.time_step * (1.0 - 1e-12) - 1e-9))
