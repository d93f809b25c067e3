"""The state of a run: output of one step and input of the next one. Nothing in it is changed in place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.data import Floats

SectionHistory = tuple[Mapping[str, Floats], ...]
"""Histories of the joint sections, one mapping a law."""


class MotionValues(NamedTuple):
    """A motion's values on this rank (n,)."""

    displacement: Floats
    velocity: Floats
    acceleration: Floats


@dataclass(frozen=True)
class Motion:
    """Displacement, velocity and acceleration of the solid unknowns."""

    displacement: PETSc.Vec
    velocity: PETSc.Vec
    acceleration: PETSc.Vec

    @property
    def vectors(self) -> tuple[PETSc.Vec, PETSc.Vec, PETSc.Vec]:
        """Its three parts."""
        return self.displacement, self.velocity, self.acceleration

    def values(self) -> MotionValues:
        """This rank's share as arrays, to read."""
        return MotionValues(*(v.getArray(readonly=True) for v in self.vectors))

    def copy(self) -> Motion:
        """The same in vectors of its own."""
        return Motion(self.displacement.copy(), self.velocity.copy(), self.acceleration.copy())

    def destroy(self) -> None:
        """Free the vectors; their owner calls it."""
        destroy(self.displacement, self.velocity, self.acceleration)


@dataclass(frozen=True)
class Sections:
    """Response of the laws at this rank's joint sections; meanings as in ``laws.base.JointResponse``.

    blur    (s, dim) round-off bound of the strain since the start [length]
    record  (s,) largest traction that the section has carried since the start [stress]
    """

    strain: Floats
    traction: Floats
    tangent: Floats
    stored: Floats
    inelastic: Floats
    strength: Floats
    utilisation: Floats
    is_sliding: NDArray[Any]
    is_open: NDArray[Any]
    margin: Floats
    blur: Floats
    record: Floats
    history: SectionHistory

    def less_dilation(self, strain: Floats) -> Floats:
        """Strains (s, dim) less the opening that slip has brought."""
        elastic = strain.copy()
        elastic[:, -1] -= self.inelastic[:, -1]
        return elastic


@dataclass(frozen=True)
class Forces:
    """Terms of the balances at one instant, kept for the energy balance.

    load        outer forces R on the solid unknowns [force per thickness]
    support     reactions at supported unknowns, zero elsewhere
    conduction  K_F p of (3.20) [volume rate per thickness]
    source      well rates Q, and inflow at prescribed pressures
    of_terms    by the names of terms: forces of their C and D against the motion, less those that they bring in
    powers      likewise: power of the forces that they bring in [energy/time per thickness]
    anchor      part of ``load``: reactions of terms that held unknowns until inertia came in; None without such terms
    """

    load: PETSc.Vec
    support: PETSc.Vec
    conduction: PETSc.Vec
    source: PETSc.Vec
    of_terms: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    powers: Mapping[str, float] = field(default_factory=dict)
    anchor: PETSc.Vec | None = None

    def copy(self) -> Forces:
        """The same in vectors of its own."""
        of_terms = {name: vector.copy() for name, vector in self.of_terms.items()}
        anchor = None if self.anchor is None else self.anchor.copy()
        others = {name: getattr(self, name).copy() for name in ("load", "support", "conduction", "source")}
        return replace(self, of_terms=of_terms, anchor=anchor, **others)

    def destroy(self) -> None:
        """Free the vectors; their owner calls it."""
        destroy(self.load, self.support, self.conduction, self.source, self.anchor, *self.of_terms.values())


@dataclass(frozen=True)
class PreviousStep:
    """Values of the step before in the same stage, which a multistep rule without inertia uses.

    time_step  its length, 0 where there was none [time]
    velocity   the mean velocity over it of the solid unknowns [length/time]
    uptake     the mean rate over it at which compression took up fluid; of a compressible fluid only
    through    the mean flow rate over it of each well with a pressure or a limit [volume rate]
    """

    time_step: float = 0.0
    velocity: PETSc.Vec | None = None
    uptake: PETSc.Vec | None = None
    through: Mapping[str, float] = field(default_factory=dict)

    def destroy(self) -> None:
        """Free the vectors; their owner calls it."""
        destroy(self.velocity, self.uptake)


class StageStart(NamedTuple):
    """Where a stage began, on this rank, to which ``accuracy.tolerance`` takes its changes.

    displacement  (n,) of the solid unknowns [length]
    compressed    (f,) fluid that compression held at the flow nodes [volume per thickness]; None of an incompressible one
    """

    displacement: Floats
    compressed: Floats | None


FRACTURES = ""
"""Stands for fractures with prescribed pressures among the names of wells."""


@dataclass(frozen=True)
class FluidVolumes:
    """Volumes since the start, over the whole flow_depth [length^3].

    wells   name -> net volume that a well has brought; under FRACTURES that of prescribed pressures of fractures
    rates   name -> mean rate of each in the last step, or the rate at its end where that took no time [volume rate]
    into    what wells have brought: a step of a well counts by its sign
    out_of  what they have drawn, positive
    stored  what fractures have taken up in steps with storage, by walls and by compression
    """

    wells: Mapping[str, float] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    into: float = 0.0
    out_of: float = 0.0
    stored: float = 0.0

    def after(self, rates: Mapping[str, float], stored: float, dt: float) -> FluidVolumes:
        """The same after a step of length ``dt`` with mean ``rates``, in which a volume was ``stored``."""
        brought = [rate * dt for name, rate in rates.items() if name != FRACTURES]
        return FluidVolumes(
            {name: self.wells.get(name, 0.0) + rate * dt for name, rate in rates.items()},
            rates,
            self.into + sum(each for each in brought if each > 0.0),
            self.out_of - sum(each for each in brought if each < 0.0),
            self.stored + stored,
        )

    def with_rates(self, rates: Mapping[str, float]) -> FluidVolumes:
        """The same volumes beside other rates."""
        return replace(self, rates=rates)

    @property
    def by_fractures(self) -> float:
        """The volume that prescribed pressures of fractures have brought [length^3]."""
        return self.wells.get(FRACTURES, 0.0)


@dataclass(frozen=True)
class State:
    """Everything at the end of a step.

    controls  value of each load factor
    energy    running totals of the energy balance [energy per thickness]
    wells_at_limit  wells that are kept at a limit of their pressure
    wells_shut  wells that are shut, since the pressure around them is beyond a limit
    friction  (s,) dissipation by friction at each joint section of this rank since the start [energy/area]
    injected  net volume that wells have brought since the start, in a scene with a stage auto [length^3]
    left      net volume that has left the network by each term since the start, by their names [length^3]
    volumes   that wells have brought since the start
    memory    of terms, of the pressures so far, by their names: arrays (j, 2, m) at this rank's joint ends
    adjacent_steps  lengths of the step that led here and of the planned next one, by which jumps in time were sampled
    uptake    rate at which compression takes up fluid at the flow nodes [volume rate per thickness]; None where it does not
    max_overpressure  largest pressure, above that at rest, at the end of a step since the start [stress]
    max_dissipation  largest dissipation of the flow at the end of a step since the start [energy/time per thickness]
    stage_start  where the stage began, if its steps are as long as an error allows; else None
    """

    time: float
    motion: Motion
    pressure: PETSc.Vec
    sections: Sections
    forces: Forces
    controls: Mapping[str, float]
    energy: Mapping[str, float]
    wells_at_limit: tuple[str, ...] = ()
    wells_shut: tuple[str, ...] = ()
    friction: Floats = field(default_factory=lambda: np.zeros(0))
    previous_step: PreviousStep = PreviousStep()
    uptake: PETSc.Vec | None = None
    max_overpressure: float = 0.0
    max_dissipation: float = 0.0
    injected: float = 0.0
    left: Mapping[str, float] = field(default_factory=dict)
    volumes: FluidVolumes = FluidVolumes()
    memory: Mapping[str, Floats] = field(default_factory=dict)
    adjacent_steps: tuple[float, float] = (0.0, 0.0)
    stage_start: StageStart | None = None

    @property
    def unaccounted_volume(self) -> float:
        """The volume that came into the network, less those that went out, are stored, or left by terms [length^3]."""
        volumes = self.volumes
        return volumes.into - volumes.out_of + volumes.by_fractures - volumes.stored - sum(self.left.values())

    def destroy(self) -> None:
        """Free the vectors; called once the next state is accepted."""
        destroy(self.motion, self.pressure, self.forces, self.previous_step, self.uptake)


def forgetful(state: State) -> State:
    """A copy with vectors of its own, without the previous step."""
    uptake = None if state.uptake is None else state.uptake.copy()
    motion, forces, pressure = state.motion.copy(), state.forces.copy(), state.pressure.copy()
    return replace(state, motion=motion, pressure=pressure, forces=forces, previous_step=PreviousStep(), uptake=uptake)


def _adds_up() -> Any:
    """A count of a step that adds up: over the solves of a step, and over the steps of a run."""
    return field(default=0, metadata={"adds up": True})


@dataclass(frozen=True)
class StepReport:
    """Cost and end of a step.

    solid_residual  beyond ``round_off``, the round-off bound of the balances; both relative
    digits          fewest digits that round-off leaves of the tractions of a fracture
    out_of_balance  (4.9a) at the start of the step and after each iteration [force per thickness]; of a monolithic solve
    predicted       factor of the error in a plain cycle of the fixed point, before the first; NaN elsewhere
    made            the same of cycles with added storage, where they ended; NaN elsewhere
    measured        that of the cycles as they were made, between the last two
    handed_over     why the fixed point left the step to the monolithic solver; empty if it did not
    located         sections whose friction changed its status at the end of the step, which was located there
    rejected        trials rejected on the way to this step: they did not converge, were unstable, or were not accurate
    wasted          Newton iterations spent on those, which ``newton`` does not count
    grown           largest factor by which an aperture grew in the step
    widening        the same where no pressure is prescribed, and ``widest``, its fracture and place
    solved          explicit steps that solved joints without a fluid; ``refused``, those whose guess their laws refused
    missed          work of friction that a step with inertia misses; see ``energy.work_missed`` [energy per thickness]
    """

    newton: int = _adds_up()
    krylov: int = _adds_up()
    cycles: int = 0
    factorisations: int = _adds_up()
    solid_residual: float = 0.0
    flow_residual: float = 0.0
    out_of_balance: tuple[float, ...] = ()
    digits: float = 15.65
    predicted: float = np.nan
    made: float = np.nan
    measured: float = np.nan
    handed_over: str = ""
    round_off: float = 0.0
    located: int = _adds_up()
    rejected: int = _adds_up()
    wasted: int = _adds_up()
    grown: float = 1.0
    widening: float = 1.0
    widest: str = ""
    missed: float = 0.0
    solved: int = _adds_up()
    refused: int = _adds_up()

    def with_rejected(self, newton: int) -> StepReport:
        """The same with one more rejected trial, and its Newton iterations."""
        return replace(self, rejected=self.rejected + 1, wasted=self.wasted + newton)

    def after_trials(self, trials: StepReport) -> StepReport:
        """The same with the trials rejected before it."""
        return replace(self, rejected=self.rejected + trials.rejected, wasted=self.wasted + trials.wasted)

    def after(self, earlier: StepReport) -> StepReport:
        """The report of this solve with the cost of one before it in the same step, and what happened there."""
        return replace(
            self,
            cycles=max(earlier.cycles, self.cycles),
            handed_over=self.handed_over or earlier.handed_over,
            round_off=max(earlier.round_off, self.round_off),
            **{name: getattr(earlier, name) + getattr(self, name) for name in COUNTS},
        )


COUNTS = tuple(each.name for each in fields(StepReport) if each.metadata.get("adds up"))
"""Names of what adds up in a report."""


@dataclass
class TrialProgress:
    """The trial under way, as a screen shows it.

    iteration   of Newton's method
    unbalanced  share of forces or flow that is out of balance, the larger one; infinite where no trial is under way
    """

    iteration: int = 0
    unbalanced: float = np.inf


@dataclass
class Work:
    """Evaluations of both balances and factorisations, whatever became of the trials that they were made for."""

    evaluations: int = 0
    factorisations: int = 0
    trial: TrialProgress = field(default_factory=TrialProgress)
