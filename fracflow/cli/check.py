"""All that can go wrong before the first step, and how large the problem is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from fracflow._petsc import MPI
from fracflow.advance.cost import cost_of_events
from fracflow.advance.explicit import explicit_cost, seconds_of_product
from fracflow.advance.initial_state import refuse_imbalance
from fracflow.diagnostics import Number, pre_run_checks
from fracflow.diagnostics.well_parts import parts_with_wells
from fracflow.mesh.cut_mesh import whole_mesh
from fracflow.mesh.read import network_of
from fracflow.mesh.slices.gathering import with_all_cells
from fracflow.mesh.split import summary
from fracflow.model.setup import Model, geometry_of
from fracflow.model.unbounded import held_walls
from fracflow.reduction import Decision, decide
from fracflow.reduction.apply import planned, seconds_of_factors
from fracflow.reduction.event_mesh import cells_of_event, event_scene, period_of_event
from fracflow.reduction.far_sides import one_obstacle
from fracflow.reduction.prepare import prepare
from fracflow.remarks import digits
from fracflow.scene.scene import Scene
from fracflow.solve.condensed_cost import (
    ITERATIONS,
    OWN,
    break_even,
    condensing,
    fits,
    is_chosen,
    seconds_by_factors,
    seconds_condensed,
)
from fracflow.solve.condensed_cost import planned as solved
from fracflow.solve.rock_cost import NUMBER, RockChoice, direct, rock_choice, without_solves

DENSE = 19.0  # numbers for an entry of the stiffness of rock that is not meshed, as measured with 1000 joints
SERIES = 4000.0  # the same for an unknown of rock by multipoles, by scripts/bench multipoles
PRODUCTS = 10  # in a linear solve there
MESHES = 5e-5  # seconds a cell takes to be made and set up, by scripts/figures plan --only wide


@dataclass(frozen=True)
class NetworkCheck:
    """Traces that meet and traces that do not, for JSON.

    snap         what is nearer is one [length]; None of a mesh file
    near_misses  records of what all but meets
    well_parts   records of the parts of the network that have wells
    """

    snap: float | None
    near_misses: list[dict[str, object]]
    well_parts: list[dict[str, object]]


def set_up(scene: Scene) -> tuple[dict[str, Any], list[str], list[Number], list[Decision], NetworkCheck]:
    """Set a scene up as a run does, on one rank: sizes and cost, what was moved to fit, card, plan and network.

    InputError where it cannot be run.
    """
    model = prepare(scene, MPI.COMM_SELF)
    refuse_imbalance(model)
    mesh = with_all_cells(model.mesh, model.operators.blocks)
    assert model.mesh is not None and mesh is not None
    layout, start, steps = model.operators.layout, 0.0, 0
    for stage in scene.stage:
        count = stage.step_count(start) or 0
        steps, start = steps + count, stage.finish(start)
    blocks = model.operators.blocks
    held = held_walls(blocks) if model.scene.is_unbounded else blocks.solid.unused
    found = {
        **summary(whole_mesh(mesh)),
        "displacement unknowns": int(layout.solid_starts[-1]) - len(held),
        "pressure unknowns": int(layout.flow_starts[-1]),
        "steps": steps,
    }
    sections = len(model.operators.joints.weights) * model.operators.joints.dim
    unknowns = int(layout.solid_starts[-1])
    pays = break_even(unknowns, sections)
    if sections and fits(unknowns, sections) and pays < math.inf and next(solved(model.scene), None) is not None:
        found["steps from which a condensed rock pays"] = pays
    card, notes = pre_run_checks(model.stated, model.mesh, model.placed.wells), [*model.mesh.notes, *model.placed.notes]
    notes += one_obstacle(scene)
    network = _network(model)
    model, facts = planned(model)
    found |= _cost(model, steps)
    return found, notes, card, decide(facts.with_card(card)), network


def _network(model: Model) -> NetworkCheck:
    assert model.mesh is not None
    parts = [part.as_record() for part in parts_with_wells(model.mesh, model.placed.wells)]
    if model.scene.geometry is None or not model.scene.geometry.fracture:
        return NetworkCheck(None, [], parts)
    _, snap, misses = network_of(geometry_of(model.scene))
    return NetworkCheck(snap, [miss.as_record() for miss in misses], parts)


def price_of_events(model: Model) -> dict[str, str]:
    """Cost of events of rock without a mesh, by the seconds of an iteration on the mesh that they get."""
    cells = int(cells_of_event(model.scene, model.bounded))
    period = period_of_event(model.scene, model.bounded)
    mesh = {"mesh of the first event, about": f"{digits(cells)} cells, made in {digits(MESHES * cells)} CPU s"}
    return mesh | cost_of_events(model, _in_event(model, cells), ITERATIONS, period)


def _in_event(model: Model, cells: int) -> float:
    """CPU s of an iteration on the mesh of an event, with its rock condensed to the joints where the run has it so."""
    scene, unknowns = event_scene(model.scene, model.bounded), cells  # two displacements a node, which two cells have
    jumps = len(model.operators.joints.weights) * model.operators.joints.dim
    plan = condensing(scene, unknowns, jumps, ranks=1, damps=True)
    if is_chosen(scene, plan, RockChoice(unknowns=unknowns)):
        return seconds_condensed(unknowns, jumps)
    return seconds_by_factors(direct(unknowns).seconds)


def _cost(model: Model, steps: int) -> dict[str, str]:
    """Memory and time of so many steps, by what factors of so many unknowns take; one factorisation is made and timed.

    Explicit steps have none: they take products with the rock's stiffness, which are timed likewise. Events and searches make
    steps besides.
    """
    has_events = any(stage.kind == "auto" for stage in model.scene.stage)
    searches = any(stage.until for stage in model.scene.stage)
    unknowns = sum(
        int(starts[-1]) for starts in (model.operators.layout.solid_starts, model.operators.layout.flow_starts)
    )
    explicit = explicit_cost(model)
    steps -= explicit.steps if explicit is not None else 0
    solves = steps > 0 or has_events or searches
    rock = rock_choice(model.scene, MPI.COMM_SELF, int(model.operators.layout.solid_starts[-1]))
    memory = rock.cost.bytes if solves else without_solves(unknowns)
    by_multipoles = model.operators.far is not None
    if model.scene.is_unbounded:
        layout = model.operators.layout
        moving = float(int(layout.solid_starts[-1]) - len(held_walls(model.operators.blocks)))
        numbers = SERIES if by_multipoles else DENSE * moving
        memory = without_solves(0) + NUMBER * numbers * moving
    found, parts, seconds = {"memory, about": f"{memory / 1e9:.2g} GB"}, [], 0.0
    of_events: dict[str, str] = {}
    if explicit is not None:
        found["explicit steps"] = explicit.line
        part = explicit.seconds + OWN
        seconds += explicit.parts * part
        many = f"{explicit.parts}" if explicit.parts else "events, in"
        parts.append(f"{many} explicit parts of about {part:.2g} s")
    if solves:
        lasted = seconds_of_factors(model.operators)
        each, made = seconds_by_factors(lasted), f"a factorisation, and one took {lasted:.2g} s here"
        if by_multipoles:
            product = seconds_of_product(model.operators)
            each += PRODUCTS * product
            made = f"{PRODUCTS} products of {product:.2g} s and {made}"
        seconds += steps * ITERATIONS * each
        is_meshed_later = model.scene.is_unbounded and model.scene.has_dynamics
        of_events = price_of_events(model) if is_meshed_later else cost_of_events(model, each, ITERATIONS)
        found |= of_events
        parts.append(f"{ITERATIONS} iterations a step, each with {made}")
    besides = [f"events{', which are as above' if of_events else ''}"] if has_events else []
    besides += ["searches"] if searches else []
    besides += ["fast slip by rate and state, which may be thousands"] if model.scene.creeps else []
    without = f", without those of {'; of '.join(besides)}" if besides else ""
    found[f"time of the steps planned, at most about{without}"] = f"{digits(seconds)} CPU s: {'; '.join(parts)}"
    return found
