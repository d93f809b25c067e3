"""How a step samples tables in time, so that their whole integral enters the solution.

With inertia, forces and flow rates are sampled so that the trapezoid's sum over the steps is the table's integral, and jumps
of pressures likewise. Without it what is prescribed holds as just before the end of the step: what jumps there comes in the
step after it. Flow rates are then sampled as the rule takes the derivative of what is stored.
"""

from __future__ import annotations

from fracflow.integrators import Alphas, Stepper
from fracflow.model.state import State
from fracflow.scene.time_table import JUST_AFTER, JUST_BEFORE, Around, Rates, TimeTable
from fracflow.solve.request import StepRequest, StepRule

MOST_GROWTH = 1e3  # of steps, beyond which the last one has no influence


def sides_of(rule: Stepper, dt: float, ahead: float | None) -> Around:
    """Lengths of the steps around the end of one of length ``dt`` that one of length ``ahead`` follows; None: one as long."""
    if rule.inertia:
        return dt, dt if ahead is None else ahead
    return JUST_BEFORE if dt > 0.0 else JUST_AFTER


def rule_of(stepper: Stepper, state: State, request: StepRequest, follows: Stepper) -> StepRule:
    """How a step by a rule, which another ``follows``, takes rates and samples what is tabled."""
    dt, ahead, last = request.length, request.next_length, state.previous_step.time_step
    alphas = stepper.alphas(dt, last) if last > 0.0 else stepper.alphas(dt)
    rates = rates_of(stepper, alphas, state, dt, ahead, follows)
    return StepRule(alphas, sides_of(stepper, dt, ahead), rates, stepper.inertia)


def begins_anew(rule: Stepper, state: State, request: StepRequest) -> bool:
    """Whether a step of a multistep rule is taken by backward Euler, without the previous step.

    There is no previous step, or one so short that it is round-off. Or the next length is not known, by which a rule that
    weighs both ends divides the integral of a table. Or a rate jumps as the step begins, of which such a rule would take half.
    """
    dt, ahead = request.length, request.next_length
    if not rule.memory or state.previous_step.time_step == 0.0 or dt > MOST_GROWTH * state.previous_step.time_step:
        return True
    if rule.alphas(dt).a4 == 0.0:
        return False
    tables = [well.value for well in request.loads.wells if isinstance(well.value, TimeTable)]
    if any(state.time < time < state.time + 0.5 * dt for table in tables for time in table.jumps[0]):
        return True
    return ahead is None and any(state.time < time < state.time + dt for table in tables for time in table.times)


def rates_of(
    rule: Stepper, alphas: Alphas, state: State, dt: float, ahead: float | None, follows: Stepper
) -> Rates | None:
    """How a step of length ``dt`` from a state samples flow rates; None with inertia, where a rule weighs both its ends.

    Backward Euler takes their mean over the step; BDF2 combines it with that over the last step as it does those of the
    walls' velocities. Of a well that has a limit the last mean is of the rate that went through it, whatever its table says.
    The trapezoid takes the value at the end, with the difference of its sum from the integral of the step. Where it begins by
    backward Euler, that step corrects for the half by which the next one counts its end.

    follows  the rule of the steps after it
    """
    if rule.inertia:
        return Rates(now=1.0, share=0.0, begin=state.time, of_forces=True) if rule.balance == "end" else None
    if not rule.storage or dt == 0.0:
        return Rates(around=sides_of(rule, dt, ahead))
    if alphas.a4 > 0.0:
        return Rates(around=(dt, ahead or 0.0))
    if follows.alphas(dt).a4 > 0.0 and ahead:
        share = 0.5 * ahead / (dt + 0.5 * ahead)
        return Rates(now=1.0 - share, share=share, around=(0.0, ahead), begin=state.time)
    last = state.previous_step.time_step
    if alphas.a6 > 0.0 and last > 0.0:
        before, factors, through = state.time - last, (alphas.a1 * dt, alphas.a6), state.previous_step.through
        return Rates(*factors, 0.0, begin=state.time, before=before, controls=state.controls, through=through)
    return Rates(now=1.0, share=0.0, begin=state.time)
