"""The fluid: what of it a scene would hardly notice. One factorisation serves rock and fluid: leaving it out saves little.

Of injection into two crossing fractures in rock of 20 000 displacements, 30 steps took 4.0 CPU seconds. With steady
flow in place of fracture storage they took 3.8, with a compressible fluid 3.0. Runs differ by as much on a machine that
others use.
"""

from __future__ import annotations

from collections.abc import Iterator

from fracflow.reduction.decision import Decision, ReductionInput
from fracflow.scene.time_table import TimeTable


def _nothing(facts: ReductionInput) -> str:
    share = facts.pressures / max(facts.unknowns + facts.pressures, 1)
    return f"nothing: kept, one factorisation serves rock and fluid, and pressures are {share:.2g} of its unknowns"


def flow_block(facts: ReductionInput) -> Iterator[Decision]:
    """The pressures: left out where there is no fluid; where all of them stay as they are they are none the less solved for."""
    scene, fluid = facts.scene, facts.scene.fluid
    value = "no [fluid]" if fluid is None else f"viscosity {fluid.viscosity:g}, specific weight {fluid.specific_weight}"
    error = "none: without a fluid there is no pressure"
    if not scene.has_flow:
        saves = "the pressures, and their coupling with the rock"
        criterion = "fluid table with viscosity and specific weight above zero"
        yield Decision("flow", True, criterion, value, "> 0", error, saves)
        return
    at_rest = is_at_rest(facts)
    criterion = "every pressure constant in time and space: only steady stages, wells that keep it, no flow rate"
    saves = _nothing(facts) if at_rest else "nothing: pressures change"
    yield Decision("flow", False, criterion, "met" if at_rest else "not met", "met", "none", saves)


def is_at_rest(facts: ReductionInput) -> bool:
    """Whether no pressure ever changes: no walls squeeze the fluid, and nothing drives it."""
    scene = facts.scene
    still = all(stage.kind in ("steady", "equilibrate") for stage in scene.stage)
    kept = [isinstance(well.pressure, TimeTable) and len(well.pressure.times) == 1 for well in scene.well]
    return still and any(kept) and all(kept) and not scene.is_drained


def one_way(facts: ReductionInput) -> Iterator[Decision]:
    """The effect of moving walls on the flow."""
    numbers = [facts.card.get(f"coupling, {name}") for name in ("transient", "steady")]
    known = [number.value for number in numbers if number is not None and number.value is not None]
    if not facts.scene.has_flow or not known:
        return
    error = "of pressures, relative: about 3 p/(k d)"
    yield Decision("wall-to-flow coupling", False, "rho_t + rho_s", sum(known), facts.tolerance, error, _nothing(facts))


def fracture_storage(facts: ReductionInput) -> Iterator[Decision]:
    """Storage of fractures while they fill, in stages without inertia: steady flow for dt > 50 tau_d."""
    ringing = facts.card.get("pressure ringing")
    slow = any(stage.kind in ("quasi-static", "auto") for stage in facts.scene.stage)
    if not facts.scene.has_flow or not slow or ringing is None or ringing.value is None:
        return
    value, error = 2.0 * ringing.value, "of pressures, relative: exp(-dt/tau_d) a step"
    found, criterion = 1.0 / value if value else "unknown", "tau_d/dt, of the fracture that drains first"
    yield Decision("fracture storage", False, criterion, found, 1.0 / 50.0, error, _nothing(facts))


def compressibility(facts: ReductionInput) -> Iterator[Decision]:
    """Storage of a fluid by its pressure, beside the storage of the walls."""
    number, fluid = facts.card.get("fluid compressibility"), facts.scene.fluid
    if not facts.scene.has_flow or number is None or number.value is None or fluid is None:
        return
    stated, error = bool(fluid.compressibility), "about k_n d/K_f of pressures"
    saves = _nothing(facts) if stated else "nothing: above the limit set fluid.compressibility"
    limit = 0.05 * facts.tolerance
    yield Decision("compressibility", False, "k_n d/K_f", number.value, limit, error, saves, asked=stated)


def fluid_inertia(facts: ReductionInput) -> Iterator[Decision]:
    """Never modelled; the pre-run checks warn of it."""
    number = facts.card.get("fluid inertia")
    if not facts.scene.has_flow or not facts.scene.has_dynamics or number is None or number.value is None:
        return
    limit = "not bounded" if number.limit is None else number.limit
    error, saves = "Womersley's number squared", "nothing: it is never modelled"
    yield Decision("fluid inertia", False, number.formula, number.value, limit, error, saves, asked=False)
