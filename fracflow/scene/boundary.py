"""The tables of a scene that say what is held, loaded, pumped, watched, and in which stages."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, model_validator

from fracflow.scene.method import Count, Fraction, Name, Table
from fracflow.scene.quantities import MeasuredName
from fracflow.scene.units import FLOW_RATE, LINE_FORCE, STRESS, TIME, Quantity, fault
from fracflow.scene.values import PLACES, At, Displaced, Position, Tabled, TabledVector, TimeTable

Component = Literal["x", "y", "rotation"]
Duration = Annotated[float, Quantity(TIME, above=0.0)]
Measured = Annotated[str, MeasuredName()]
Entry = Annotated[TimeTable, Tabled()]
Row = tuple[Entry, Entry]
Names = Annotated[
    tuple[Name, ...], Field(min_length=1), BeforeValidator(lambda on: [on] if isinstance(on, str) else on)
]


class Support(Table):
    """[[support]] Sides, points or rocks that are held, or moved as prescribed."""

    on: Names = Field(description="names of sides, points or rocks: one or a list")
    components: tuple[Component, ...] = Field(
        default=("x", "y"),
        min_length=1,
        description="what is held; by default x and y, or the keys of displacement",
    )
    displacement: Annotated[dict[str, TimeTable], Displaced()] | None = Field(
        default=None,
        description="prescribed {x = ..., y = ...} [length]; rotation of a rigid rock in radians",
    )
    displacement_gradient: tuple[Row, Row] | None = Field(
        default=None,
        description="[[du_x/dx, du_x/dy], [du_y/dx, du_y/dy]], each a number or a time table, added to displacement:"
        " a motion affine in x and y [1]",
    )

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

    on: Names = Field(max_length=2, description="one side, or two that a translation brings to coincide (periodic)")
    components: tuple[Literal["x", "y"], ...] = Field(default=("x", "y"), min_length=1, description="what is tied")

    @model_validator(mode="after")
    def _consistent(self) -> Tie:
        if len(set(self.on)) < len(self.on):
            raise fault(
                "names one side twice; give it once to let it move as one, or two that face each other", key="on"
            )
        return self


class Load(Table):
    """[[load]] A traction on sides, as [x, y], as a pressure, or that of the initial stress; or a force on rocks."""

    on: Names = Field(description="names of sides, or of rocks where a force is given: one or a list")
    traction: Annotated[tuple[TimeTable, TimeTable] | str, TabledVector(STRESS, "initial-stress")] | None = Field(
        default=None, description='[t_x, t_y] in global axes [force/length**2], or "initial-stress"'
    )
    pressure: Annotated[TimeTable, Tabled(STRESS)] | None = Field(
        default=None, description="pressure against the side, positive pushes inwards [force/length**2]"
    )
    force: Annotated[tuple[TimeTable, TimeTable], TabledVector(LINE_FORCE)] | None = Field(
        default=None,
        description="[F_x, F_y] per unit thickness on each rock named, spread evenly over its area [force/length]",
    )
    control: Name | None = Field(default=None, description="name of the [control] whose factor multiplies the load")

    @model_validator(mode="after")
    def _consistent(self) -> Load:
        given = [key for key in ("traction", "pressure", "force") if getattr(self, key) is not None]
        if not given:
            raise fault("missing; a load needs traction, pressure or force", key="traction")
        if len(given) > 1:
            raise fault(f"contradicts {given[1]}; give one of them", key=given[0])
        if self.control is not None and self.traction == "initial-stress":
            raise fault('contradicts traction = "initial-stress", which has no factor; remove one', key="control")
        return self


class Well(Table):
    """[[well]] A place where fluid is pumped in or out, or its pressure is kept; or all fracture ends on a side.

    On a side a pressure holds at each end. A flow_rate is that of all ends together: they are one node of the network, with
    one pressure, so each takes its share by its conductance.
    """

    name: Name = Field(description="name of the well")
    at: Annotated[Position, At()] | None = Field(default=None, description=PLACES)
    on: Name | None = Field(
        default=None,
        description="in place of at: a side, of which all fracture ends are the well; a flow_rate is shared by conductance at"
        " one pressure",
    )
    flow_rate: Annotated[TimeTable, Tabled(FLOW_RATE)] | None = Field(
        default=None, description="volume pumped in per time, over the whole flow_depth [length**3/time]"
    )
    pressure: Annotated[TimeTable | str, Tabled(STRESS, "initial")] | None = Field(
        default=None, description='pressure kept [force/length**2], or "initial"'
    )
    control: Name | None = Field(default=None, description="name of the [control] whose factor multiplies flow_rate")
    maximum_pressure: Annotated[float, Quantity(STRESS)] | None = Field(
        default=None,
        description="pressure that pumping must not exceed: the well then takes what it can [force/length**2]",
    )
    minimum_pressure: Annotated[float, Quantity(STRESS)] | None = Field(
        default=None, description="pressure below which it must not draw: it then gives what it can [force/length**2]"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Well:
        if self.at is None and self.on is None:
            raise fault("missing; a well needs a place, or on = a side", key="at")
        if self.at is not None and self.on is not None:
            raise fault("contradicts at; give one of them", key="on")
        if self.flow_rate is None and self.pressure is None:
            raise fault("missing; a well needs flow_rate or pressure", key="flow_rate")
        if self.flow_rate is not None and self.pressure is not None:
            raise fault("contradicts flow_rate; give one of them", key="pressure")
        for key in ("maximum_pressure", "minimum_pressure"):
            if getattr(self, key) is not None and self.pressure is not None:
                raise fault("contradicts pressure; a limit belongs to a flow_rate", key=key)
        if None not in (self.maximum_pressure, self.minimum_pressure):
            if self.maximum_pressure <= self.minimum_pressure:  # type: ignore[operator]
                raise fault(f"must be above minimum_pressure = {self.minimum_pressure:g}", key="maximum_pressure")
        if self.control is not None and self.pressure is not None:
            raise fault("contradicts pressure; a control multiplies a flow_rate", key="control")
        return self


class Control(Table):
    """[control.NAME] A factor that several wells or loads share, and that a stage may search."""

    initial: Annotated[float, Quantity()] = Field(default=0.0, description="value at the start [1]")
    increment: Annotated[float, Quantity(above=0.0)] = Field(
        default=1.0, description="first guess of the search for failure, in the unit of the factor itself [1]"
    )


class Probe(Table):
    """[[probe]] A place whose history is written."""

    name: Name = Field(description="name in the run folder")
    at: Annotated[Position, At()] = Field(description=PLACES)
    on: Name | None = Field(default=None, description="fracture or rock that is meant, where several meet at the place")
    quantities: tuple[Measured, ...] | None = Field(
        default=None,
        description="what to write; all there is if not given; slip_rate is that of the instant: in waves behind sharp fronts"
        " it rings with periods of a few cell transits h/c_s, which finer cells do not lessen; read slip, or its increase over"
        " at least 8 h/c_s",
    )


class Stage(Table):
    """[[stage]] A part of the run."""

    name: Name | None = Field(default=None, description="name by which --set and the log call the stage")
    kind: Literal["equilibrate", "steady", "quasi-static", "dynamic", "auto"] = Field(
        description="equilibrate: from an initial state out of balance to rest, at the initial pressure, in no time; steady: no"
        " storage, no inertia; quasi-static: no inertia; dynamic: both; auto: quasi-static but while slip runs away"
    )
    end: Annotated[float, Quantity(TIME)] | None = Field(
        default=None, description="time at which the stage ends [time]"
    )
    time_step: Duration | None = Field(
        default=None,
        description="time step; of a stage auto, the longest one without inertia; a steady stage of a number of steps may do"
        " without, and takes no time [time]",
    )
    dynamic_time_step: Duration | None = Field(
        default=None,
        description="of a stage auto: step with inertia, and how well an onset is known; by default what a P wave takes through"
        " a typical joint, at most a fiftieth of the longest period [time]",
    )
    at_rest: Fraction = Field(
        default=1e-3,
        description="of a stage auto: an event is over when kinetic energy stays below this share of its peak [1]",
    )
    rest_periods: Annotated[float, Quantity(above=0.0)] = Field(
        default=1.0, description="for so many of the longest periods of vibration; below 1 may cut events short [1]"
    )
    steps: Count | None = Field(
        default=None, description="number of steps, in place of end; increments of a stage that equilibrates"
    )
    until: Literal["incipient"] | None = Field(
        default=None, description="incipient: raise the control until the first section is about to slip"
    )
    control: Name | None = Field(default=None, description="name of the [control] that the stage raises")
    tolerance: Fraction = Field(
        default=1e-6, description="of the search: strength (1 - tolerance) f_sy is used up when it ends [1]"
    )
    increment_per_step: Annotated[float, Quantity(above=0.0)] | None = Field(
        default=None,
        description="raise of the control each step over its value at the start of the stage [1]",
    )
    then: Literal["hold"] | None = Field(default=None, description="hold: keep the control after the first failure")

    @model_validator(mode="after")
    def _consistent(self) -> Stage:
        if self.until is not None or self.increment_per_step is not None or self.then is not None:
            key = next(key for key in ("until", "increment_per_step", "then") if getattr(self, key) is not None)
            if self.control is None:
                raise fault(f"missing; {key} needs the name of a [control]", key="control")
        if self.until is not None and self.increment_per_step is not None:
            raise fault("contradicts until, which finds its own increments; leave it out", key="increment_per_step")
        if self.then is not None and self.increment_per_step is None:
            raise fault("needs increment_per_step: there is nothing to hold", key="then")
        self._check_time()
        return self

    def _check_time(self) -> None:
        if self.kind == "equilibrate":
            for key in ("time_step", "end", "until", "control", "increment_per_step"):
                if getattr(self, key) is not None:
                    raise fault(
                        'contradicts kind = "equilibrate", which takes no time and only steps; leave it out', key=key
                    )
            return
        if self.takes_no_time:
            for key in ("time_step", "end", "steps"):
                if getattr(self, key) is not None:
                    raise fault(
                        "contradicts a steady stage until incipient, which takes no time; leave it out", key=key
                    )
            return
        if self.kind == "auto":
            for key in ("steps", "until", "control", "increment_per_step"):
                if getattr(self, key) is not None:
                    raise fault('contradicts kind = "auto", which chooses its steps until end; leave it out', key=key)
        elif self.dynamic_time_step is not None:
            raise fault(f'contradicts kind = "{self.kind}"; it belongs to kind = "auto"', key="dynamic_time_step")
        if self.kind == "dynamic" and self.until is not None:
            raise fault('contradicts kind = "dynamic"; allowed kinds: "steady", "quasi-static"', key="until")
        stands_still = self.kind == "steady" and self.steps is not None and self.end is None
        if self.time_step is None and not stands_still:
            raise fault(f"missing; a stage of kind {self.kind} needs it", key="time_step")
        if self.until is None and self.end is None and self.steps is None:
            raise fault(f"missing; a stage of kind {self.kind} needs end or steps", key="end")
        if self.end is not None and self.steps is not None:
            raise fault(f"contradicts end = {self.end:g}; give one of them", key="steps")

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
