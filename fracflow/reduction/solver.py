"""How little the solvers need: factors that serve on, and rock that is condensed to its joints. Neither changes results."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite

from fracflow.reduction.decision import Decision, ReductionInput
from fracflow.reduction.inertia import reduced
from fracflow.scene.scene import Scene
from fracflow.solve.condensed_cost import AT_LEAST, USUAL, condensing, is_chosen, planned, solves_per_factor
from fracflow.solve.linear import LEAST_WORTH, are_kept
from fracflow.solve.options import is_swift


def condensed_rock(facts: ReductionInput) -> Iterator[Decision]:
    """The unknowns of the rock, which is linear: the choice is the coupling's, for the stages that the plan leaves.

    Rock that is not meshed has no others than those of its joints.
    """
    scene = reduced(facts)
    if not facts.jumps or scene.is_unbounded or not _solves(scene):
        return
    plan = condensing(scene, facts.unknowns, facts.jumps, facts.ranks, facts.damps)
    chosen = scene.method.coupling == "condensed" or is_chosen(scene, plan, facts.rock)
    steps = inf if plan.has_events else max(plan.steps.values(), default=0.0)
    length = f"{steps:.0f} steps of one length" if isfinite(steps) else "as many steps as events take"
    saves = "a factorisation in every step"
    if not chosen:
        saves = "nothing: kept, condensing would not pay, or was not asked for"
    limit = f"{AT_LEAST * plan.pays:.0f}" if isfinite(plan.pays) else "never pays"
    criterion = "steps of one length, to pay twice over"
    yield Decision("rock, condensed to its joints", chosen, criterion, length, limit, "none: exact", saves)


def new_factors(facts: ReductionInput) -> Iterator[Decision]:
    """Factors of a matrix that joints have changed since."""
    if not _solves(reduced(facts)):
        return
    total = facts.unknowns + facts.pressures
    swift = is_swift(facts.unknowns, facts.ranks) and not facts.rock.is_dense
    kept, worth = are_kept(facts.scene, total, swift), solves_per_factor(total, swift)
    criterion = "solves in the time of a factorisation"
    saves = f"a factorisation where {USUAL} solves serve"
    if not kept:
        saves = "nothing: kept, new factors cost no more than they save"
    error = "none: Newton's method ends at the same residual, with new factors where old ones do not serve"
    yield Decision("new factors in every iteration", kept, criterion, worth, f"> {LEAST_WORTH:g}", error, saves)


def _solves(scene: Scene) -> bool:
    """Whether any stage solves for all unknowns at once: explicit steps do not."""
    return next(planned(scene), None) is not None


def factorisations(solves: int, made: int) -> Decision:
    """The record of a run that has ended."""
    return Decision(
        "factorisations", made < solves, "matrix the same, or old factors serve",
        f"{made} factorisations in {solves} Newton iterations", "1 while nothing changes state", "none",
        f"{max(solves - made, 0)} factorisations",
    )  # fmt: skip
