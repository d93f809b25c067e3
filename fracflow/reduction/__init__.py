"""The parts of a model that a scene needs: the others are left out, on record, and checked while the scene runs.

A part whose omission would save no work stays: the record says so. The decisions, each in a function of DECISIONS:

flow       the pressures; what walls that move do to them; storage of fractures; compressibility; inertia of the fluid
inertia    of the rock, in stages whose loads are slow; the run begins anew with it where one swings, slips or opens
tied       locked fractures, which can neither slip, open nor conduct; the run begins anew with them where one might
sides      of the rock where they are far, and with them its mesh; the run begins anew with them where they matter
parts      of the rock, which nothing loads; exact
solver     factors of matrices that joints have changed since; the unknowns of the rock, condensed to the joints; exact
outputs    fields of steps that are not requested; rock beyond absorbing sides
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace

from fracflow.elements import dashpot
from fracflow.reduction import flow, solver
from fracflow.reduction.decision import Decision, ReductionInput
from fracflow.reduction.event_mesh import mesh_of_events
from fracflow.reduction.far_sides import decide_sides
from fracflow.reduction.inertia import decide_inertia, spans
from fracflow.reduction.locked_fractures import decide_locked
from fracflow.reduction.solver import factorisations
from fracflow.reduction.unloaded_blocks import decide_parts
from fracflow.scene.units import LENGTH

__all__ = ["Decision", "ReductionInput", "as_lines", "as_records", "decide", "factorisations", "mesh_of_events"]


def fields(facts: ReductionInput) -> Iterator[Decision]:
    """Stresses and energy densities of the rock, and files of whole fields."""
    every = facts.scene.output.fields_every
    value = "the first and the last state" if every == 0 else f"every {every} steps"
    saves = "stresses, densities and files of the other steps" if every != 1 else "nothing: every step is asked for"
    yield Decision("fields", every != 1, "output.fields_every", value, "asked for", "none", saves)


def far_field(facts: ReductionInput) -> Iterator[Decision]:
    """Rock beyond absorbing sides, which changes waves that meet them at an angle."""
    scene = facts.scene
    sides = ", ".join(name for term in scene.terms if term.absorbs for name in term.on)
    ratios = {rock.poissons_ratio for rock in scene.rock.values() if rock.poissons_ratio is not None}
    known = [(stage, end - start) for _, stage, start, end in spans(scene)]
    is_known = len(known) == len(scene.stage) and not any(stage.kind == "auto" for stage, _ in known)  # events are not
    lasts = sum(length for stage, length in known if stage.kind == "dynamic") if is_known else 0.0
    fast = max((rock.p_speed for rock in scene.rock.values()), default=0.0)
    far = f"{dashpot.silent_distance(fast, lasts):.3g}{scene.unit_system.behind(LENGTH)}"
    remedy = (
        f"put it {far} from what slips and probes, so that nothing is back before the end,"
        if lasts
        else "move it away,"
    )
    for ratio in sorted(ratios) if sides and scene.has_dynamics else ():
        of_p, of_s = (dashpot.energy_over_directions(ratio, kind) for kind in ("p", "s"))
        yield Decision(
            "rock beyond absorbing sides", True,
            f"share of the energy of waves from all directions that {sides} send back; by angle in log.txt",
            f"{of_p:.1%} of P, {of_s:.1%} of S waves (Poisson's ratio {ratio:g})", "0 along the normal",
            f"waves that meet a side at a slant come back weaker: {remedy} or turn it towards them", "the rock there",
        )  # fmt: skip


DECISIONS = (
    flow.flow_block, flow.one_way, flow.fracture_storage, flow.compressibility, flow.fluid_inertia,
    decide_inertia, decide_sides, decide_locked, decide_parts, solver.new_factors, solver.condensed_rock, fields, far_field,
)  # fmt: skip


def decide(facts: ReductionInput) -> list[Decision]:
    """All decisions, before the first step; not left out is what was put back in an earlier try."""
    found = [decision for find in DECISIONS for decision in find(facts)]
    keys = ((each, f"{each.part}, {each.stage}" if each.stage else each.part) for each in found)
    return [
        replace(each, left_out=False, undone=facts.undone[key]) if key in facts.undone else each for each, key in keys
    ]


def as_records(decisions: Iterable[Decision]) -> list[dict[str, object]]:
    """For plan.json and ``check --json``."""
    return [asdict(decision) | {"verdict": decision.verdict} for decision in decisions]


def as_lines(decisions: Iterable[Decision]) -> list[str]:
    """For the terminal and the log."""
    return [_line(decision) for decision in decisions]


def _line(decision: Decision) -> str:
    where = f" in stage {decision.stage}" if decision.stage else ""
    value, limit = (f"{x:.3g}" if isinstance(x, float) else x for x in (decision.value, decision.limit))
    line = f"plan: {decision.part}{where}: {decision.verdict}; {decision.criterion}: {value}, limit {limit}"
    if decision.left_out or not decision.asked:
        line += f"; error: {decision.error}"
    return f"{line}; saves {decision.saves}" + (f"; undone at {decision.undone}" if decision.undone else "")
