"""Conditions between the tables of a scene, and between a scene and its mesh."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Sequence
from itertools import chain

from fracflow.errors import InputError
from fracflow.integrators import keys_of, stepper_from, with_inertia
from fracflow.laws import JOINT_LAWS
from fracflow.scene.laws import check_flow
from fracflow.scene.messages import nearest, numbered
from fracflow.scene.method import LONGEST_NAME
from fracflow.scene.petsc import refusal
from fracflow.scene.tables import Tables
from fracflow.scene.time_table import JUST_AFTER
from fracflow.scene.units import COMPRESSIBILITY
from fracflow.scene.values import AlongFracture, FractureEnd, Position
from fracflow.storage.files import PLAIN_TEXT

MOST_STEPS = 1e9
MOST_COMPRESSIBLE = 1e-2  # 1/Pa, 1/p of an ideal gas at a thousandth of the atmosphere's pressure
Fault = tuple[tuple[int | str, ...], str]


def contradictions(scene: Tables) -> Iterator[Fault]:
    """List what contradicts, is missing or unknown between tables: (path of the key, what is wrong)."""
    if not scene.stage:
        yield ("stage",), "missing; a run needs at least one [[stage]]"
    yield from _method(scene)
    yield from _absorbing(scene)
    yield from _terms(scene)
    yield from _leak_off(scene)
    yield from _geometry(scene)
    yield from _unbounded(scene) if scene.is_unbounded else ()
    yield from _materials(scene)
    yield from _controls(scene)
    yield from _actions(scene)
    for key in ("well", "probe", "stage"):
        names = [entry.name for entry in getattr(scene, key)]
        for index in _repeated(names):
            yield (key, index, "name"), "stands twice; names must differ: rename one"
    for key in ("rock", "fracture", "control"):
        for name in getattr(scene, key):
            if not re.fullmatch(PLAIN_TEXT, name) or len(name) > LONGEST_NAME:
                yield (key, name), f"must be one line without control characters, of at most {LONGEST_NAME} letters"
    if scene.output.time_unit and scene.unit_system.time != "s":
        yield ("output", "time_unit"), f'needs units with seconds, not units = "{scene.units}"; leave it out'
    for option, value in scene.petsc.items():
        if why := refusal(option, value):
            yield ("petsc", option), why
    in_history = [
        ((key, i, "name"), entry.name) for key in ("probe", "well") for i, entry in enumerate(getattr(scene, key))
    ]
    for path, name in (*in_history, *((("control", name), name) for name in scene.control)):
        if not {"", ".", ".."}.isdisjoint(name.split("/")):
            yield path, "is no name for the history, where / divides; put more than dots before and after it"


def _repeated(names: Sequence[str | None]) -> Iterator[int]:
    """Places of the names that stand before them too."""
    seen = set[str]()
    for place, name in enumerate(names):
        if name is not None:
            if name in seen:
                yield place
            seen.add(name)


def _method(scene: Tables) -> Iterator[Fault]:
    method = scene.method
    needs = {"mass": "lumped", "quadrature": "nodal", "storage": "lumped"}
    if scene.has_dynamics:
        needs["contact"] = "lumped"
    for key, value in needs.items() if method.stepper == "explicit" else ():
        if getattr(method, key) != value:
            why = f'contradicts stepper = "explicit", which needs "{value}"; or use stepper = "newmark"'
            yield ("method", key), why
    yield from _shared_jumps(scene) if method.mass == "consistent" and scene.has_dynamics else ()
    if method.stepper == "explicit" and scene.accuracy.dynamic_slip_share is not None:
        why = 'contradicts method.stepper = "explicit", whose steps the rock bounds; leave it out, or use stepper = "newmark"'
        yield ("accuracy", "dynamic_slip_share"), why
    if scene.accuracy.dynamic_slip_share is not None and not (scene.creeps and scene.has_dynamics):
        why = (
            'bounds steps with inertia by the rate of slip of law = "rate-and-state": the scene has none; leave it out'
        )
        yield ("accuracy", "dynamic_slip_share"), why
    for key, allowed in against_condensing(scene) if method.coupling == "condensed" else ():
        names = " or ".join(f'"{value}"' for value in allowed)
        yield ("method", key), f'contradicts coupling = "condensed", which needs {names}; or use "monolithic"'
    if method.rock_solver == "multigrid" and method.coupling not in ("auto", "monolithic", "fixed-point"):
        yield (
            ("method", "rock_solver"),
            f'contradicts coupling = "{method.coupling}"; use coupling = "auto", or "auto" here',
        )
    if method.rock_solver == "multipoles" and not scene.is_unbounded:
        why = 'is "multipoles", which is rock that is not meshed: use "auto", or geometry.domain = "unbounded"'
        yield ("method", "rock_solver"), why
    if method.rock_solver == "multipoles" and method.coupling in ("fixed-point", "condensed"):
        why = 'needs all entries of the rock, and method.rock_solver = "multipoles" has none of far joints: use "auto"'
        yield ("method", "coupling"), f'is "{method.coupling}", which {why}'
    if method.contact == "redistributed" and scene.has_flow and scene.has_dynamics:
        yield (
            ("method", "contact"),
            'is "redistributed" in a scene with a fluid: walls without mass have no first velocity to squeeze it by, and the'
            ' fluid damps them as it is; use "lumped"',
        )
    keys = {name: keys_of({name: kind}) for name, kind in with_inertia().items()}
    for key, (default, _, _) in keys_of(with_inertia()).items():
        if key not in keys[method.stepper] and getattr(method, key) != default:  # a scene written back has all defaults
            users = ", ".join(name for name, own in keys.items() if key in own)
            why = f'is no key of stepper = "{method.stepper}", but of {users}; remove it, or set stepper'
            yield ("method", key), why


def _shared_jumps(scene: Tables) -> Iterator[Fault]:
    """Supports that jump while free nodes share their mass, by a rule whose velocities lead: its energies grow as 1/dt^2."""
    method = scene.method
    alphas = stepper_from(method.stepper, method).alphas(1.0)
    if alphas.gamma <= 0.5 or alphas.is_difference:
        return
    for number, support in enumerate(scene.support):
        tables = [*(support.displacement or {}).values(), *chain(*(support.displacement_gradient or ()))]
        begins = scene.stage[0].kind == "dynamic" and any(table(0.0, JUST_AFTER) for table in tables)
        if begins or any(len(table.jumps[0]) for table in tables):
            why = (
                f'is "consistent", by which nodes share the inertia of support.{number}, which jumps:'
                f' stepper = "{method.stepper}" makes energy of that; use "lumped", or stepper = "newmark", or let it rise'
                " over some steps"
            )
            yield ("method", "mass"), why
            return


def against_condensing(scene: Tables) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Keys of [method] with which the rock cannot be condensed, and the values that they would need."""
    needs = {"overshoot": ("hold",), "newton_test": ("residual", "out-of-balance")}
    if scene.has_flow:
        needs |= {"quadrature": ("nodal",), "storage": ("lumped",)}
    for key, allowed in needs.items():
        if getattr(scene.method, key) not in allowed:
            yield key, allowed


def _absorbing(scene: Tables) -> Iterator[Fault]:
    held = {name for support in scene.support for name in support.on}
    for index, absorbing in enumerate(scene.absorbing):
        for name in absorbing.on if absorbing.wave is not None else ():
            if name in held:
                why = f'"{name}" is held by a [[support]] too, so that its wave cannot come in; remove one'
                yield ("absorbing", index, "on"), why


def _terms(scene: Tables) -> Iterator[Fault]:
    for key, tables in scene.term_tables.items():
        if any(table.drains for table in tables) and not scene.has_flow:
            yield (key,), "needs [fluid] with a viscosity: without it no fluid is modelled; give it, or remove this"


def _leak_off(scene: Tables) -> Iterator[Fault]:
    for name, table in scene.fracture.items():
        if table.leak_off is not None and not scene.has_flow:
            yield (
                ("fracture", name, "leak_off"),
                "needs [fluid] with a viscosity: without it no fluid is modelled; give it, or remove this",
            )


def _geometry(scene: Tables) -> Iterator[Fault]:
    geometry = scene.geometry
    if (geometry is None) == (scene.mesh is None):
        both = geometry is not None
        yield ("geometry",), "contradicts [mesh]; give one of them" if both else "missing; give [geometry] or [mesh]"
    if geometry is None:
        return
    traces = [trace.name for trace in geometry.fracture]
    for index in _repeated(traces):
        yield ("geometry", "fracture", index, "name"), "stands twice; names must differ: rename one"
    for index, name in enumerate(traces):
        if name == "default":
            yield ("geometry", "fracture", index, "name"), "is kept for [fracture.default]; choose another name"
        if name not in scene.fracture and "default" not in scene.fracture:
            yield ("fracture", name), f'missing; the fracture "{name}" needs a table, or [fracture.default]'
    fine = geometry.size_at_fractures or geometry.size or math.inf  # what is not given follows later, from what is
    if geometry.size is not None and fine > geometry.size:
        yield ("geometry", "size_at_fractures"), f"must be at most size = {geometry.size:g}"
    if geometry.event_margin is not None and not (geometry.is_unbounded and scene.has_dynamics):
        why = 'is of an "unbounded" domain with a stage "auto", whose events are meshed: remove it'
        yield ("geometry", "event_margin"), why
    if geometry.size_at_tips is not None and geometry.size_at_tips > fine:
        yield ("geometry", "size_at_tips"), f"must be at most the size at fractures, {fine:g}"
    known = {*traces, "default"}
    for name in scene.fracture:
        if name not in known:
            yield ("fracture", name), f"no fracture of that name in [geometry]; {nearest(name, traces)}"
    for name in list(scene.rock)[1:]:
        yield ("rock", name), f"is one too many; [geometry] has one rock, here {next(iter(scene.rock))}: remove this"


def _unbounded(scene: Tables) -> Iterator[Fault]:
    """Tables and keys of sides, cells and inertia, which rock that is not meshed does not have."""
    assert scene.geometry is not None
    bounded, free = "give geometry.domain = [xmin, ymin, xmax, ymax]", 'an "unbounded" geometry.domain has no'
    if not scene.geometry.fracture:
        yield ("geometry", "domain"), 'is "unbounded", and nothing in it moves without a fracture: give one'
    for key in ("support", "tie", "absorbing"):
        if getattr(scene, key):
            yield (key,), f"{free} sides: remove it, or {bounded}"
    for index, load in enumerate(scene.load):
        if load.on:
            yield ("load", index, "on"), f"{free} sides: give the load as stress, without on, or {bounded}"
    for index, well in enumerate(scene.well):
        if well.on is not None:
            yield ("well", index, "on"), f"{free} sides: give at = a place on a fracture, or {bounded}"
    for index, stage in enumerate(scene.stage):
        if stage.kind == "dynamic":
            why = f'is "dynamic", and {free} cells that have inertia until an event of a stage auto needs them'
            yield ("stage", index, "kind"), f'{why}: use "auto", "quasi-static" or "steady", or {bounded}'
    for name, rock in scene.rock.items():
        if rock.rigid:
            yield ("rock", name, "rigid"), f"{free} blocks of their own: remove it, or {bounded}"
    if scene.body_force is not None:
        yield ("body_force",), f"{free} cells to carry it: give the initial_stress that it makes, or {bounded}"
    for key, given in () if scene.initial is None else scene.initial:
        if given and key != "pressure":
            yield ("initial", key), f"{free} cells that move: remove it, or {bounded}"
    for key, tables in scene.term_tables.items():
        if key != "absorbing" and (tables[0].places == "sides" or not tables[0].drains):
            yield (key,), f"{free} sides and cells for it: remove it, or {bounded}"
    if scene.method.stepper == "explicit" and scene.has_dynamics:
        why = f'is "explicit", which divides by mass, and {free} cells that have any until an event needs them'
        yield ("method", "stepper"), f'{why}: use "generalised-alpha", or {bounded}'
    if scene.method.rock_solver == "multigrid":
        yield ("method", "rock_solver"), f'{free} cells to coarsen: use "auto", or {bounded}'
    if scene.geometry.cells != "triangles":
        yield ("geometry", "cells"), f"{free} cells: remove it, or {bounded}"


def _materials(scene: Tables) -> Iterator[Fault]:
    if not scene.rock:
        yield ("rock",), "missing; a scene needs [rock.NAME]"
    for name, rock in scene.rock.items():
        if rock.density is None and scene.has_dynamics:
            yield ("rock", name, "density"), "missing; dynamic stages need it: give it"
        elif rock.density is None and not rock.rigid and scene.radiates:
            why = 'missing; radiation damping needs it: give it, or set method.radiation_damping = "none"'
            yield ("rock", name, "density"), why
        if rock.density is None and scene.body_force is not None and scene.body_force.gravity:
            yield ("rock", name, "density"), "missing; body_force.gravity needs it: give it"
    for name, fracture in scene.fracture.items():
        if scene.has_flow and fracture.aperture is None and fracture.conductance is None:
            yield ("fracture", name, "aperture"), "missing; the fluid needs it, or conductance: give one"
        elif scene.has_flow and scene.fluid is not None and scene.fluid.compressibility and fracture.aperture is None:
            yield (
                ("fracture", name, "aperture"),
                "missing; a fluid with compressibility needs the volume it fills: give it",
            )
        if fracture.dilates and scene.method.tangent == "decoupled":
            why = 'contradicts method.tangent = "decoupled", which has no change of normal traction by slip; use "consistent"'
            yield ("fracture", name, "dilation_angle_deg"), why
        for key, fault in check_flow(scene.method.conductance, vars(fracture)) if scene.has_flow else ():
            yield ("fracture", name, key), fault
        if fracture.pressure is not None and not scene.has_flow:
            yield (
                ("fracture", name, "pressure"),
                "needs [fluid] with a viscosity: without it no fluid is modelled; give it, or remove this",
            )
    if scene.fluid is not None and scene.fluid.compressibility and scene.units != "none":
        in_si = scene.fluid.compressibility * scene.unit_system.to_si(COMPRESSIBILITY)
        if in_si > MOST_COMPRESSIBLE:
            why = f"is {in_si:.3g} 1/Pa, which no fluid has; give 1/K_f of the bulk modulus K_f, 4.5e-10 1/Pa for water"
            yield ("fluid", "compressibility"), why
    if scene.fluid is not None and scene.fluid.pressure_gradient:
        for index, well in enumerate(scene.well):
            if well.on is not None and well.flow_rate is not None:
                yield (
                    ("well", index, "flow_rate"),
                    "contradicts fluid.pressure_gradient: the ends on a side would share one pressure at all depths; give"
                    ' pressure = "initial", or a well at each end',
                )
    if scene.fluid is None and scene.well:
        yield ("fluid",), "missing; a scene with wells needs [fluid] with viscosity"


def _controls(scene: Tables) -> Iterator[Fault]:
    followers = {well.control for well in scene.well} | {load.control for load in scene.load}
    for key in ("well", "load", "stage"):
        for index, entry in enumerate(getattr(scene, key)):
            if entry.control is not None and entry.control not in scene.control:
                yield (key, index, "control"), f"no [control] of that name; {nearest(entry.control, scene.control)}"
            elif entry.control is not None and entry.control not in followers:
                yield (key, index, "control"), "no well or load has this control: give one control = ..."


def _actions(scene: Tables) -> Iterator[Fault]:
    for index, load in enumerate(scene.load):
        if load.stress is not None and not scene.is_unbounded:
            why = 'needs geometry.domain = "unbounded": give the traction on each side in its place'
            yield ("load", index, "stress"), why
        if load.traction == "initial-stress" and scene.initial_stress is None:
            yield ("load", index, "traction"), "needs the table [initial_stress]; give it, or traction = [x, y]"
    rigid = {name for name, rock in scene.rock.items() if rock.rigid}
    for index, support in enumerate(scene.support):
        if "rotation" in support.components and rigid.isdisjoint(support.on):
            yield ("support", index, "components"), "only a rigid rock has a rotation; leave it out"
    seen = set[str]()
    for index, entry in enumerate(scene.absorbing):
        for name in entry.on:
            if name in seen:
                yield ("absorbing", index, "on"), f'names "{name}" again; a side absorbs once: remove it here'
            seen.add(name)
    clock: float | None = 0.0
    for index, stage in enumerate(scene.stage):
        if index and stage.kind == "equilibrate":
            yield (
                ("stage", index, "kind"),
                "only the first stage can equilibrate: later states are in balance; remove it",
            )
        if (
            stage.until is not None
            and scene.fracture
            and all(JOINT_LAWS[table.law].creeps for table in scene.fracture.values())
        ):
            slow = "which slip at any stress, so that the search has no end"
            why = f'= "incipient" looks for the first fracture at its strength; all are of law = "rate-and-state", {slow}:'
            why += f' leave until and control.{stage.control} out, with kind = "quasi-static", time_step and end'
            yield ("stage", index, "until"), why
        if stage.takes_no_time:
            continue
        if clock is not None and stage.end is not None and stage.end <= clock:
            yield ("stage", index, "end"), f"must be later than the start of the stage, {clock:g}"
        bounded = clock is not None and stage.until is None
        steps = stage.step_count(clock) if bounded and clock is not None else None
        if steps is not None and steps > MOST_STEPS:
            yield ("stage", index, "time_step"), f"would take {steps:.2g} steps; raise it, or end the stage earlier"
        clock = stage.finish(clock) if clock is not None and steps else None


def check_mesh_names(
    scene: Tables, rocks: Collection[str], fractures: Collection[str], sides: Collection[str], points: Collection[str]
) -> None:
    """Compare the names a scene uses with those its mesh has; raises InputError for the first stranger."""
    unnamed = {"support": scene.support, "load": scene.load, "tie": scene.tie, **scene.term_tables}
    for place, name, allowed in _used_names(scene, rocks, fractures, sides, points):
        if name not in allowed:
            key, _, rest = place.partition(".")
            which = numbered(key, rest.partition(".")[0], len(unnamed[key])) if key in unnamed else ""
            raise InputError(f'{scene.source}: {place} = "{name}": not in the mesh{which}; {nearest(name, allowed)}')
    for kind, names, known in (("rock", rocks, scene.rock), ("fracture", fractures, scene.fracture)):
        for name in names:
            if name not in known and not (kind == "fracture" and "default" in known):
                raise InputError(
                    f'{scene.source}: {kind}.{name}: missing; the mesh has a {kind} "{name}": give its table'
                )


def _used_names(
    scene: Tables, rocks: Collection[str], fractures: Collection[str], sides: Collection[str], points: Collection[str]
) -> Iterator[tuple[str, str, Collection[str]]]:
    """List (key, name, allowed names) of all names that the mesh must have."""
    for name in scene.rock:
        yield "rock", name, rocks
    for name in scene.fracture:
        yield "fracture", name, (*fractures, "default")
    for index, support in enumerate(scene.support):
        for name in support.on:
            yield f"support.{index}.on", name, (*sides, *points, *rocks)
    for key, tables in scene.term_tables.items():
        for index, table in enumerate(tables):
            for name in table.on:
                yield f"{key}.{index}.on", name, sides if table.places == "sides" else fractures
    for key in ("load", "tie"):
        for index, entry in enumerate(getattr(scene, key)):
            for name in entry.on:
                yield f"{key}.{index}.on", name, rocks if getattr(entry, "force", None) is not None else sides
    for name in scene.initial.rock if scene.initial is not None else ():
        yield "initial.rock", name, rocks
    for well in scene.well:
        if well.on is not None:
            yield f"well.{well.name}.on", well.on, sides
        else:
            yield from _place(f"well.{well.name}.at", well.at, fractures, points)
    for probe in scene.probe:
        yield from _place(f"probe.{probe.name}.at", probe.at, fractures, points)
        if probe.on is not None:
            yield f"probe.{probe.name}.on", probe.on, (*fractures, *rocks)


def _place(
    key: str, at: Position | None, fractures: Collection[str], points: Collection[str]
) -> Iterator[tuple[str, str, Collection[str]]]:
    if isinstance(at, FractureEnd | AlongFracture):
        yield f"{key}.fracture", at.fracture, fractures
    elif isinstance(at, str):
        yield key, at, points
