"""Lines of the log on a step whose results may be wrong, or which another choice of the scene would make better."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.slip_rate import creeps
from fracflow.advance.step import Step
from fracflow.advance.wells import reached_before
from fracflow.integrators import EXPLICIT
from fracflow.mesh.data import Floats
from fracflow.mesh.places import extent_of, place_text
from fracflow.model.energy import share_of_balance
from fracflow.model.flow import is_transposed
from fracflow.model.properties import initial_pressure
from fracflow.model.setup import Model
from fracflow.model.small_strains import beyond_small_strains
from fracflow.model.state import State, StepReport
from fracflow.output.drawing.axes import shown
from fracflow.remarks import ACT, digits, marked, note
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH, STRESS
from fracflow.simulation.totals import Totals

LEAST_OVERLAP = 1e-6  # of the aperture at rest: less is round-off of one that is shut
LEAST_SUCTION = 1e-6  # of the initial pressure: less is round-off of a well that draws a fracture down to nothing
CHANGED = 0.5  # relative change of the predicted contraction from which on it is reported again
TURNING = 1e-4  # of the work of friction: 0.05 where slip is off by a quarter, none where steps resolve the motion
LEAST_FACTOR = 0.1  # smaller factors are all the same
FOLD = 1.5
"""Largest growth of an aperture by inflow through it, in a step of backward Euler, d - d0 = c d^3. For c d0^2 > 4/27 only the
stiffness of the walls stops them, at a distant solution; for less there are both solutions."""
WIDENS = 2.0  # and again where an aperture grew by as much more
REMEDY = '; kind = "auto" takes such slip with inertia'
MOST_SLIP = 1.0  # times D_c: what a step with inertia may slip, an error of 1 % of slip on its way (R19)
SPURIOUS = 1e-3  # share of the largest entry of the energy balance from which the log warns of the spurious one
DAMPED = 0.03  # of the energy of motion and friction: in resolved ruptures it is a hundredth
LEAST_DAMPED = 1e-6  # of the largest entry of the energy balance: less is round-off of rock at rest
MOTION = ("kinetic", "friction", "radiated", "viscous")  # entries that it is in, or has become


def watches_spurious(scene: Scene) -> bool:
    """Whether pressure force and storage are not transposed, so that the energy balance has a spurious entry."""
    return scene.has_flow and not is_transposed(scene.method.storage)


class Notices:
    """Reports each step once: the totals keep the reported lines, also across a restart."""

    def __init__(self, model: Model, totals: Totals, log: Callable[[str], None]) -> None:
        """Before the first step."""
        self._model, self._scene, self._totals, self._log = model, model.scene, totals, log

    def of(self, step: Step) -> None:
        """Examine a step that was put on record. Collective."""
        state, report, totals = step.state, step.report, self._totals
        self._spurious(state.time, share_of_balance(state.energy, "spurious"))
        self._damped(state)
        self._pressure(state.time, state.max_overpressure)
        self._widening(state.time, report)
        if self._scene.has_flow and not totals.open_tips and (line := open_tip_line(self._model, state)):
            totals.open_tips = 1
            self._doubt(line)
        if self._scene.has_flow and not totals.sucked and (line := suction_line(self._model, state)):
            totals.sucked = 1  # once: no fluid holds together below zero
            self._doubt(line)
        if self._scene.has_flow and not totals.overlapped and (line := overlap_line(self._model, state)):
            totals.overlapped = 1
            self._doubt(line)
        if self._scene.stage[step.stage].kind in ("steady", "quasi-static") and not totals.fast_slip:
            self._fast_slip(state)
        if step.dt > 0.0 and creeps(self._model) and "dynamic" in (self._scene.stage[step.stage].kind, step.regime):
            self._far_slip(step)
        if report.missed > 0.0:
            self._turning(step)
        if state.wells_at_limit or state.wells_shut:
            self._limits(state)
        self._coupling(f"stage {self._scene.stage[step.stage].title}", state.time, report)

    def _fast_slip(self, state: State) -> None:
        """A line, once, where slip that creeps comes to send off more than friction resists, without inertia. Collective."""
        blocks, joints = self._model.operators.blocks, self._model.operators.joints
        here = set()
        for group in joints.laws:
            if group.law.creeps:
                fast = group.sections[state.sections.is_sliding[group.sections]]
                here |= {blocks.joints.fractures[number] for number in blocks.joints.fracture[fast // joints.points]}
        names = sorted(set().union(*blocks.comm.allgather(here))) if creeps(self._model) else []
        if not names:
            return
        self._totals.fast_slip = 1
        self._doubt(
            f"time {self._scene.time_text(state.time)}: slip of {', '.join(names)} is so fast that waves limit it, and this"
            f" stage has no inertia: later results leave out what waves do{REMEDY}"
        )

    def _far_slip(self, step: Step) -> None:
        """A line where a step with inertia slips farther than the state of friction evolves over; again at twice so far.

        Collective. Such steps follow the rate of slip where the scene asks for it; the state is exact for a rate that lasts.
        """
        state, joints = step.state, self._model.operators.joints
        # the rate of an explicit step is that of its last part
        length = step.dt / max(step.report.cycles, 1) if self._scene.method.stepper in EXPLICIT else step.dt
        far = 0.0
        for group, history in zip(joints.laws, state.sections.history, strict=True):
            if group.law.creeps and len(group.sections):
                far = max(far, float((group.law.slip_rate(history) / group.law.state_length(history)).max()) * length)
        far = self._model.operators.layout.comm.allreduce(far, op=MPI.MAX)
        if far <= max(MOST_SLIP, WIDENS * self._totals.far_slip):
            return
        self._totals.far_slip = far
        key = "accuracy.dynamic_slip_share = 0.1, or " if self._scene.method.stepper not in EXPLICIT else ""
        key += "dynamic_time_step" if step.regime else "time_step"
        self._doubt(
            f"time {self._scene.time_text(state.time)}: a step with inertia slips {far:.3g} times the distance over which the"
            f" state of friction evolves: slip may be off by some per cent until it has ended, rates by more; {key} below"
            f" {self._scene.time_text(MOST_SLIP * step.dt / far, 2)}"
        )

    def _turning(self, step: Step) -> None:
        """A line, once, where slip turns from step to step, as a motion that steps do not resolve drives it.

        Nothing damps it where the rule of the step does not. Each turn gives energy back that friction would have taken, and
        walls that dilate ride up further. Slip goes on where it had stopped.
        """
        totals, friction = self._totals, step.state.energy["friction"]
        totals.missed += step.report.missed
        if totals.turning or totals.missed <= TURNING * friction:
            return
        totals.turning = 1
        key = "dynamic_time_step" if step.regime else "time_step"
        self._doubt(
            f"time {self._scene.time_text(step.state.time)}: slip reverses within single steps, and friction misses"
            f" {totals.missed / max(friction, totals.missed):.1g} of its work: later results may be wrong, as slip may go on by"
            f' itself; method.stepper = "generalised-alpha" with rho_infinity = 0.5, or {key} of about'
            f" {self._scene.time_text(0.25 * step.dt, 2)}"
        )

    def _limits(self, state: State) -> None:
        """A line on each well, once, when a limit of its pressure keeps it from its rate, and once when it is shut."""
        scene, known = self._scene, self._totals.at_limit
        for limit in sorted(reached_before(self._model.loads, state), key=lambda limit: limit.well):
            is_highest, well = limit.sign > 0.0, f"well.{limit.well}"
            key = "maximum_pressure" if is_highest else "minimum_pressure"
            pressure = shown(STRESS, limit.pressure, scene.unit_names, 6)
            at, what = f"time {scene.time_text(state.time)}", f"{limit.well}/{key}{'/shut' * limit.is_shut}"
            if what in known:
                continue
            known.append(what)
            verb, raised = ("takes", "higher") if is_highest else ("gives", "lower")
            side, back = ("above", "falls") if is_highest else ("below", "rises")
            does = (
                f"is shut, since the pressure around it is {side} its {key} = {pressure}, and {verb} nothing until that {back}"
                if limit.is_shut
                else f"is held at its {key} = {pressure}, and {verb} less than its flow_rate while it is"
            )
            self._doubt(f"{at}: {well} {does}: give a {raised} limit, or a smaller rate, if the rate is to be kept")

    def _coupling(self, stage: str, now: float, report: StepReport) -> None:
        """A line where the contraction of the fixed point has changed, and where it first failed."""
        totals, scene = self._totals, self._scene
        if report.handed_over and not totals.handed_over:
            after = "handed over to the monolithic solver, as are later steps like it"
            self._log(note(f"{stage}: {report.handed_over}; {after}"))
        totals.handed_over += bool(report.handed_over)
        last, factor = totals.reported_factor, report.predicted
        if np.isnan(factor):
            return
        if np.isnan(last) or (max(factor, last) >= LEAST_FACTOR and not abs(factor - last) <= CHANGED * last):
            totals.reported_factor = factor
            time = f"time {scene.time_text(now)}"
            made = f"cycles as they are made by {report.made:.3g} (predicted where they end); "
            made = made if np.isfinite(report.made) else ""
            measured = (
                f"{made}the last cycle, {scene.method.fixed_point}, by {report.measured:.3g} (measured)"
                if np.isfinite(report.measured)
                else "fewer than two cycles were made, so that none is measured"
            )
            plain = f"a plain cycle of the fixed point multiplies the error by {factor:.3g} (predicted)"
            self._log(note(f"{stage}, {time}: {plain}; {measured}"))

    def _spurious(self, time: float, share: float) -> None:
        totals = self._totals
        if share > totals.spurious:
            if totals.spurious <= SPURIOUS < share:
                self._log(
                    ACT + f'time {time:.6g}: spurious work of method.storage = "{self._scene.method.storage}" is'
                    f" {share:.1e} of the largest entry of the energy balance, above {SPURIOUS:g}: see energy/spurious;"
                    ' method.storage = "lumped" has none'
                )
            totals.spurious, totals.spurious_time = share, time

    def _damped(self, state: State) -> None:
        """A line where damping at faults takes more than what the mesh cannot carry, and again where twice as much."""
        energy = state.energy
        moving = energy["damping"] + sum(energy[name] for name in MOTION)
        if share_of_balance(energy, "damping") < LEAST_DAMPED:
            return
        share = energy["damping"] / moving
        if share <= max(DAMPED, 2.0 * self._totals.damped):
            return
        self._totals.damped = share
        self._doubt(
            f"time {self._scene.time_text(state.time)}: method.fault_damping has taken {digits(100.0 * share)} % of the energy"
            " of motion and friction: slip of patches of few cells, and waves that pass fractures, come out too weak. Take"
            " smaller cells there, or fault_damping = 0 if little slides"
        )

    def _pressure(self, time: float, drive: float) -> None:
        """A line, once, where a pressure would strain the rock beyond the model."""
        if not self._totals.strained and (line := beyond_small_strains(self._scene, drive)):
            self._totals.strained = 1
            self._doubt(f"time {time:.6g}: {line}")

    def _widening(self, time: float, report: StepReport) -> None:
        """A line where an aperture grew in a step by more than can be predicted, and again where by far more."""
        grown = report.widening
        if grown <= WIDENS * self._totals.widening:
            return
        self._totals.widening = grown
        self._doubt(
            f"time {time:.6g}: an aperture of {report.widest} grew {grown:.3g} times as wide in one step."
            f" Above {FOLD:g} such a step has two solutions and may be at the wrong one: take smaller time_steps until nothing"
            " changes, or give accuracy.tolerance"
        )

    def _doubt(self, line: str) -> None:
        """A line of the log that the end of the run repeats."""
        self._log(marked(line))
        self._totals.doubts.append(line)


def suction_line(model: Model, state: State) -> str:
    """A line on the lowest pressure where it is below zero; empty where none is, or pressures are above an unknown datum.

    A scene with an initial pressure means pressures of its fluid; one without (zero) means changes, which may have any sign.
    So, with a gradient, do its fractures above the level at which the initial pressure is zero. Collective.
    """
    scene, flow, blocks = model.scene, model.operators.flow, model.operators.blocks
    if flow is None or scene.fluid is None or scene.fluid.initial_pressure <= 0.0:
        return ""
    limit = -LEAST_SUCTION * scene.fluid.initial_pressure
    if state.pressure.min()[1] >= limit:
        return ""
    pressure, ends = flow.at_ends(state.pressure), blocks.solid.points[blocks.joints.bottom]
    counts = (pressure < limit) & (initial_pressure(scene, ends) > 0.0)
    found = _lowest(model, np.where(counts, pressure, np.inf))
    if found is None:
        return ""
    lowest, where = found
    return (
        f"time {scene.time_text(state.time)}: the pressure in {where} falls to"
        f" {lowest:.3g}{scene.unit_system.behind(STRESS)}, below zero: a fluid boils or lets air in there,"
        " which the model leaves out, and pulls the walls together in it: give a"
        " minimum_pressure to the wells that draw, or a higher fluid.initial_pressure if pressures are above another datum"
    )


def overlap_line(model: Model, state: State) -> str:
    """A line on the place where walls have closed the farthest beyond their aperture; empty where none have. Collective.

    Springs let them: a law that closes along a hyperbola does not.
    """
    scene, network = model.scene, model.operators.flow
    if network is None:
        return ""
    opening = model.operators.joints.openings(state.sections.strain)
    wide = network.apertures(state.motion.displacement, opening)
    overlaps = (wide < -LEAST_OVERLAP * network.aperture) & np.isnan(network.given)[:, None]
    found = _lowest(model, np.where(overlaps, wide, np.inf))
    if found is None:
        return ""
    least, where = found
    return (
        f"time {scene.time_text(state.time)}: walls of {where} close by {-least:.3g}{scene.unit_system.behind(LENGTH)} more"
        " than their aperture, as springs let them: later openings and flows are wrong there, and pressures of all that is"
        " joined to it. Take a law that closes along a hyperbola, a wider aperture, or a larger normal_stiffness"
    )


def _lowest(model: Model, values: Floats) -> tuple[float, str] | None:
    """The lowest value (j, 2) at an end of a joint, and the fracture and place; None where all are infinite. Collective."""
    blocks, here = model.operators.blocks, (np.inf, "", 0.0, 0.0)
    joints, points = blocks.joints, blocks.solid.points
    if values.min(initial=np.inf) < np.inf:
        joint, end = np.unravel_index(int(values.argmin()), values.shape)
        x, y = points[joints.bottom[joint, end]][:2]
        here = (float(values[joint, end]), joints.fractures[joints.fracture[joint]], float(x), float(y))
    lowest, name, x, y = min(blocks.comm.allgather(here))
    at = place_text((x, y), extent_of(points))
    return (lowest, f"{name} at {at}{model.scene.unit_system.behind(LENGTH)}") if name else None


def open_tip_line(model: Model, state: State) -> str:
    """A line on a fracture that fluid has lifted open up to its end, where rock would crack; empty where there is none.

    Walls meet in one node at an end within rock. A fracture without compression at the start was open then. Collective.
    """
    scene, blocks, joints = model.scene, model.operators.blocks, model.operators.joints
    block = blocks.joints
    ends = block.bottom == block.top
    was_closed = joints.initial[:, -1] < 0.0
    lifted = (state.sections.is_open & was_closed).reshape(-1, joints.points).any(axis=1) & ends.any(axis=1)
    here = ("", 0.0, 0.0)
    if len(found := np.flatnonzero(lifted)):
        joint = int(found[0])
        x, y = blocks.solid.points[block.bottom[joint][ends[joint]][0]][:2]
        here = (block.fractures[block.fracture[joint]], float(x), float(y))
    name, x, y = max(blocks.comm.allgather(here))
    if not name:
        return ""
    at, unit = place_text((x, y), extent_of(blocks.solid.points)), scene.unit_system.behind(LENGTH)
    return (
        f"time {scene.time_text(state.time)}: {name} is open up to its end at {at}{unit}, since the pressure exceeds the"
        " compression across it: rock would crack there, and fractures do not grow here: later openings and pressures are those"
        " of a fracture that cannot; give the well a maximum_pressure, or draw the trace longer"
    )
