"""Statements of a scene that will do nothing, or make its results worse than they need be."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain, pairwise

import numpy as np

from fracflow.integrators import EXPLICIT, stepper_from
from fracflow.laws import JOINT_LAWS
from fracflow.remarks import note
from fracflow.scene.petsc import SOLVERS, reaches_a_solver
from fracflow.scene.profiles import Profile
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import JUST_AFTER, JUST_BEFORE, TimeTable
from fracflow.scene.units import LENGTH, STRESS, TIME
from fracflow.scene.unusual import controls_at_zero, degrees, locking, unusual
from fracflow.scene.values import AlongFracture, FractureEnd

GENTLE = 0.1  # of sizes per length, beside ruptures: slip runs away 1 % late; with 0.15 2 %, with 0.3 5 %
LASTS = 0.5  # of a pressure that is given at the start: where the first step leaves less, a line says so
AT_ONCE = 1e-3  # of a pressure: less is no jump
GOES_ON = 1e-2  # of the spread of a table: less is no change
TRANSITS = 8  # of shear waves through cells: over so many, ringing of single cells averages out


def advice(scene: Scene) -> list[str]:
    """A line for each value far from what is usual, where the units are known, and for what will do nothing."""
    return [  # the more of a result is wrong, the earlier
        *degrees(scene),
        *unusual(scene),
        *locking(scene),
        *_idle(scene),
        *_timeless(scene),
        *_without_flow(scene),
        *_shut_wells(scene),
        *_fading(scene),
        *_beyond_end(scene),
        *_past_end(scene),
        *_too_long(scene),
        *_let_go(scene),
        *_bouncing(scene),
        *_displaced(scene),
        *_unseen(scene),
        *_reflecting(scene),
        *_ringing(scene),
        *_passing(scene),
        *_of_one_length(scene),
        *_costly(scene),
        *_growing(scene),
        *_jagged(scene),
    ]


def _idle(scene: Scene) -> Iterator[str]:
    geometry = scene.geometry
    if geometry is not None and geometry.is_unbounded and geometry.size and geometry.size_at_fractures:
        if not scene.has_dynamics:
            yield note(
                "geometry.size does nothing: rock that is not meshed has joints of size_at_fractures, and no cells"
            )
    yield from controls_at_zero(scene)
    for name, table in scene.fracture.items():
        least, aperture = table.minimum_hydraulic_aperture, table.aperture
        if least and isinstance(aperture, float) and isinstance(least, float) and least > aperture:
            yield f"fracture.{name}.minimum_hydraulic_aperture is above its aperture and conducts from the start: lower it"
    if scene.method.stepper != "newmark" and not scene.has_dynamics:
        yield note(
            f'method.stepper = "{scene.method.stepper}" does nothing: it is for stages with inertia, and the scene has none;'
            ' leave it out, or give a stage of kind = "dynamic" or "auto"'
        )
    for option in scene.petsc:
        if not reaches_a_solver(option):
            yield f"petsc.{option} reaches no solver: begin it with the name of one and _: {', '.join(SOLVERS)}"


def _timeless(scene: Scene) -> Iterator[str]:
    """Steady stages that take no time, or search a limit, in which friction of rate and state lets nothing slip."""
    creeping = [name for name, table in scene.fracture.items() if JOINT_LAWS[table.law].creeps]
    for stage in scene.stage if creeping else ():
        if stage.kind == "steady" and (stage.until is not None or not stage.time_step):
            remedy = "the limit found is that of the other fractures" if stage.until is not None else "give time_step"
            yield (
                f"stage {stage.title}: takes no time, in which fracture.{creeping[0]} does not slip, however large its shear"
                f' traction: law = "rate-and-state" slips at a rate; {remedy}'
            )


def _shut_wells(scene: Scene) -> Iterator[str]:
    """Wells whose limit lies beyond the pressure at the start, so that they are shut."""
    fluid = scene.fluid
    if fluid is None or fluid.pressure_gradient:
        return
    given_start = None if scene.initial is None else scene.initial.pressure
    start = fluid.initial_pressure if given_start is None else given_start
    unit = scene.unit_system.behind(STRESS)
    for well in scene.well:
        rates = well.flow_rate.values if well.flow_rate is not None else ()
        for sign, key, side, does, change in (
            (1.0, "maximum_pressure", "below", "falls", "raise"),
            (-1.0, "minimum_pressure", "above", "rises", "lower"),
        ):
            limit = getattr(well, key)
            if limit is not None and sign * (start - limit) > 0.0 and any(sign * rate > 0.0 for rate in rates):
                yield (
                    f"well.{well.name}.{key} = {limit:.6g}{unit} is {side} the pressure at the start, {start:.6g}{unit}: the"
                    f" well is shut until the pressure around it {does} to that: {change} it, if it is to pump from the start"
                )


def _of_one_length(scene: Scene) -> Iterator[str]:
    """Rates of wells where nothing says how deep the fractures are out of the plane."""
    stated = scene.fluid is None or "flow_depth" in scene.fluid.model_fields_set
    unit = scene.unit_system.behind(LENGTH)
    rates = [well.name for well in scene.well if well.flow_rate is not None and any(well.flow_rate.values)]
    if rates and unit and not stated:
        yield note(
            f"well.{rates[0]}.flow_rate enters 1{unit} of the fractures out of the plane: if it is that of a whole well, give"
            " fluid.flow_depth"
        )


def _without_flow(scene: Scene) -> Iterator[str]:
    """A pressure that initial tractions count on, where a zero leaves the flow out, and all pressures with it."""
    fluid = scene.fluid
    if fluid is None or scene.has_flow or not (fluid.initial_pressure or fluid.pressure_gradient):
        return
    zero = next(key for key in ("viscosity", "specific_weight", "density") if getattr(fluid, key) == 0.0)
    yield (
        f"fluid.{zero} = 0 leaves the flow out: nothing carries fluid.initial_pressure, which initial tractions of fractures"
        f" count on: give a fluid.{zero} above 0, or leave [fluid] out and give effective stresses"
    )


def _past_end(scene: Scene) -> Iterator[str]:
    """Tables of wells, supports and waves that go on changing after the last stage, by more than one row that gives a slope."""
    end = 0.0
    for stage in scene.stage:
        if stage.until is not None or not (stage.takes_no_time or stage.end or stage.step_count(end)):
            return  # nothing in the scene says when it ends
        end = end if stage.takes_no_time else stage.end or stage.finish(end)
    tables = {f"well.{well.name}.{key}": getattr(well, key) for well in scene.well for key in ("flow_rate", "pressure")}
    for number, support in enumerate(scene.support):
        tables |= {
            f"support.{number}.displacement.{part}": table for part, table in (support.displacement or {}).items()
        }
    waves = ((f"absorbing.{number}.wave.velocity", each.wave) for number, each in enumerate(scene.absorbing))
    tables |= {key: wave.velocity for key, wave in waves if wave is not None}
    for key, table in tables.items():
        if isinstance(table, TimeTable) and end > 0.0:
            left = [value for time, value in zip(table.times, table.values, strict=True) if time > end * (1.0 + 1e-9)]
            if len(left) > 1 and max(abs(value - table(end, JUST_BEFORE)) for value in left) > GOES_ON * table.spread:
                yield note(
                    f"{key}: its table goes on to {scene.time_text(table.times[-1])}, and the last stage ends at"
                    f" {scene.time_text(end)}: what comes later has no part in the run"
                )


def _unseen(scene: Scene) -> Iterator[str]:
    """Waves that are over before any stage has inertia; tables count time from the start of the run."""
    waves = [(", ".join(each.on), each.wave.velocity.times[-1]) for each in scene.absorbing if each.wave is not None]
    start = 0.0
    for stage in scene.stage:
        if stage.kind in ("dynamic", "auto"):
            break
        if not stage.takes_no_time:
            if stage.until is not None or not stage.step_count(start):  # nothing in the scene says when it ends
                return
            start = stage.finish(start)
    else:
        start = math.inf
    for name, end in waves:
        if end <= start and start > 0.0:
            begins = "no stage has inertia" if math.isinf(start) else f"inertia begins at {scene.time_text(start)}"
            yield (
                f"absorbing {name}: its wave is over at {scene.time_text(end)}, and {begins}: no wave comes in; give a stage of"
                ' kind = "dynamic" while it lasts: times of tables count from the start of the run'
            )


def _reflecting(scene: Scene) -> Iterator[str]:
    """Sides that absorb nothing since supports hold them, and events whose waves cannot leave."""
    if not scene.has_dynamics:
        return
    held = {side for support in scene.support if {"x", "y"} <= {*support.components} for side in support.on}
    absorbing = {side for each in scene.absorbing for side in each.on}
    for side in sorted(held & absorbing):
        yield f"{side} is held by a [[support]]: its [[absorbing]] dashpots never move, and waves come back: remove one"
    damps = bool(absorbing - held) or stepper_from(scene.method.stepper, scene.method).damps
    if damps or all(stage.kind != "auto" for stage in scene.stage):
        return
    stepper = 'method.stepper = "generalised-alpha" with a rho_infinity below 1'
    if scene.is_unbounded:  # its events get a mesh with absorbing sides
        if not is_for_explicit(scene):
            yield (
                "waves shorter than the cells that events get stay around the fractures, and an event may take several times"
                f" more steps: give {stepper}, which damps them"
            )
    else:
        other = "" if is_for_explicit(scene) else f", or {stepper}, for waves that the steps do not resolve"
        yield (
            "nothing lets the waves of events leave or damps them, so that none may come to rest: give [[absorbing]] sides"
            f"{other}"
        )


def _beyond_end(scene: Scene) -> Iterator[str]:
    """Stages whose steps are longer than they last."""
    start = 0.0
    for stage in scene.stage:
        if stage.takes_no_time:
            continue
        if stage.until is not None or not stage.step_count(start):  # nothing in the scene says when it ends
            return
        end = stage.finish(start)
        if stage.end is not None and stage.time_step is not None and stage.time_step > (end - start) * (1.0 + 1e-9):
            lasts = scene.time_text(end - start)
            yield (
                f"stage {stage.title}: time_step = {scene.time_text(stage.time_step)} is longer than the stage, which lasts"
                f" {lasts}: its first step ends it; take a shorter one, or a later end"
            )
        start = end


def _too_long(scene: Scene) -> Iterator[str]:
    """Steps of dynamic stages that lose a wave between two samples, or that the rule is not stable for whatever they are."""
    longest = max((stage.time_step or 0.0 for stage in scene.stage if stage.kind == "dynamic"), default=0.0)
    for absorbing in scene.absorbing:
        times = absorbing.wave.velocity.times if absorbing.wave is not None else ()
        shortest = min((after - time for time, after in pairwise(times) if after > time), default=math.inf)
        if longest > shortest * (1.0 + 1e-9):  # intervals are differences of times
            yield (
                f"absorbing {', '.join(absorbing.on)}: time_step = {longest:g} is longer than {shortest:g}, the shortest"
                " interval of the wave's table: what happens within a step is lost; take a shorter one"
            )
    method = scene.method
    if scene.has_dynamics and method.stepper == "newmark" and 2.0 * method.newmark_beta < method.newmark_gamma:
        factor = (0.5 * method.newmark_gamma - method.newmark_beta) ** -0.5
        yield (
            f"method.newmark_beta = {method.newmark_beta:g} is below newmark_gamma/2: stable only for time_step below"
            f" {factor:.3g}/omega of the fastest mode, which nothing keeps to; at {method.newmark_gamma / 2:g} any is stable"
        )


def is_for_explicit(scene: Scene) -> bool:
    """Whether ruptures, or pressures that jump, ask for explicit steps with damping at faults: no other rule is named then."""
    return bool(_ruptures(scene) or _sudden(scene))


def _is_damped(scene: Scene) -> bool:
    """Whether the rule damps cells at faults."""
    return scene.method.stepper == "explicit" and scene.method.fault_damping != 0.0


def _damping(scene: Scene) -> str:
    """The keys that damp cells at faults, with the rock that explicit steps need."""
    if scene.method.stepper == "explicit":
        return 'method.fault_damping = "auto"'
    box = ", with geometry.domain = [xmin, ymin, xmax, ymax] and [[absorbing]] sides" if scene.is_unbounded else ""
    return f'method.stepper = "explicit", which damps it{box}'


def _ruptures(scene: Scene) -> list[str]:
    """Fractures whose strength falls with slip, and whose walls [geometry] does not mesh as mirror images."""
    if scene.geometry is None or scene.model == "report" or not scene.has_dynamics:
        return []
    return [name for name, table in scene.fracture.items() if JOINT_LAWS[table.law].weakens_over]


def _ringing(scene: Scene) -> Iterator[str]:
    """Ruptures on such walls by a rule that damps no cells at faults."""
    ruptures = _ruptures(scene)
    if ruptures and not _is_damped(scene):
        yield (
            f"fracture.{ruptures[0]}: behind a rupture on walls that are not meshed as mirror images the normal traction rings"
            f" by some hundredths of its value, and slip comes out too large, more so on finer cells: use {_damping(scene)}, or"
            " a [mesh] that mirrors itself in the fault"
        )


def _passing(scene: Scene) -> Iterator[str]:
    """Waves that come in, and cross cells that are damped for the sake of ruptures."""
    names = [name for name, table in scene.fracture.items() if JOINT_LAWS[table.law].slides]
    if names and scene.has_dynamics and _is_damped(scene) and any(side.wave is not None for side in scene.absorbing):
        yield note(
            f"fracture.{names[0]}: from the first slip on, waves that come in lose energy in the damped cells beside it, a"
            " quarter and more where few cells span a wave: give method.fault_damping = 0 where little slides"
        )


def _costly(scene: Scene) -> Iterator[str]:
    """Ruptures in steps with inertia on walls of a mesh file, by a rule that solves for the rock in each of them."""
    if scene.geometry is not None or scene.model == "report" or scene.has_flow or scene.method.stepper in EXPLICIT:
        return
    ruptures = [name for name, table in scene.fracture.items() if JOINT_LAWS[table.law].weakens_over]
    if ruptures and any(stage.kind == "dynamic" for stage in scene.stage):
        yield note(
            f'fracture.{ruptures[0]}: a rupture by method.stepper = "{scene.method.stepper}": where steps are as short as'
            ' waves need for a cell, "explicit" has the same error in 0.4 of the time'
        )


def _sudden(scene: Scene) -> list[str]:
    """Fractures that slide, and whose prescribed pressure changes within a step."""
    if scene.model == "report" or not scene.has_dynamics or all(rock.rigid for rock in scene.rock.values()):
        return []
    steps = [(stage.time_step if stage.kind == "dynamic" else stage.dynamic_time_step) or 0.0 for stage in scene.stage]
    quick = [table.pressure is not None and table.pressure.is_quick(max(steps)) for table in scene.fracture.values()]
    slides = [scene.has_flow and JOINT_LAWS[table.law].slides for table in scene.fracture.values()]
    return [name for name, *both in zip(scene.fracture, quick, slides, strict=True) if all(both)]


def _let_go(scene: Scene) -> Iterator[str]:
    """Fractures that lose strength at once, by a rule that damps no cells at faults."""
    for name in [] if _is_damped(scene) else _sudden(scene):
        yield (
            f"fracture.{name}.pressure changes within a step: where it takes strength away at once, walls come too far and"
            f" stick there, and slip comes out too large, by 20 % and more, whatever the mesh: use {_damping(scene)}"
        )


def _bouncing(scene: Scene) -> Iterator[str]:
    """Pressures that jump in the first instant of a dynamic stage, by a rule that does not damp what this sets going."""
    fluid, steppers = scene.fluid, ("explicit", "newmark", "generalised-alpha")
    begins = bool(scene.stage) and scene.stage[0].kind == "dynamic" and scene.model != "report"
    if fluid is None or fluid.pressure_gradient or not begins or scene.method.stepper not in steppers:
        return
    if not scene.has_flow or not any(not rock.rigid for rock in scene.rock.values()):
        return
    given_start = None if scene.initial is None else scene.initial.pressure
    start = fluid.initial_pressure if given_start is None else given_start
    kept = {f"well.{well.name}": well.pressure for well in scene.well}
    given = {at: [table(0.0, JUST_AFTER)] for at, table in kept.items() if isinstance(table, TimeTable)}
    for name, fracture in scene.fracture.items():
        if fracture.pressure is not None:
            given[f"fracture.{name}"] = fracture.pressure(np.array(fracture.pressure.along), 0.0).tolist()
    unit = scene.unit_system.behind(STRESS)
    for at, values in given.items():
        jump = max(values, key=lambda value: abs(value - start)) - start
        if abs(jump) > AT_ONCE * max(abs(start), abs(start + jump)):
            yield (
                f"{at}.pressure jumps by {jump:.4g}{unit} in the first instant of a dynamic stage:"
                " walls bounce on their joints, whose normal traction swings by as much from step to step, long after: let it"
                " rise from the pressure at the start over some steps"
            )


def _displaced(scene: Scene) -> Iterator[str]:
    """Supports of a dynamic first stage that begin elsewhere than the rock."""
    given = scene.initial
    moves = () if given is None else (given, *given.rock.values())
    if scene.stage[0].kind != "dynamic" or any(each.displacement or each.displacement_gradient for each in moves):
        return
    for number, support in enumerate(scene.support):
        tables = [*(support.displacement or {}).values(), *chain(*(support.displacement_gradient or ()))]
        if any(table(0.0, JUST_AFTER) for table in tables):
            yield (
                f"support.{number} ({', '.join(support.on)}) is displaced from the start: a dynamic stage moves it there within"
                " the first step, which sends off a wave as short as its cells: let it rise from 0 over some steps, or begin"
                " with a quasi-static stage"
            )


def _fading(scene: Scene) -> Iterator[str]:
    """A pressure at the start that no stored volume carries: walls start undeformed, and few fluids are compressible enough.

    Walls on springs k_n move by p/k_n, and fluid between walls d apart gives c_f d p: without what blocks add, the share
    c_f d k_n/(1 + c_f d k_n) of the difference from p0 stays.
    """
    fluid, given = scene.fluid, scene.initial
    if fluid is None or given is None or given.pressure is None or not scene.has_flow:
        return
    if given.pressure == fluid.initial_pressure:
        return
    tables, moves = scene.fracture.values(), (given, *given.rock.values())
    if any(each.displacement or each.displacement_gradient for each in moves) or all(t.pressure for t in tables):
        return
    if fluid.compressibility and all(rock.rigid for rock in scene.rock.values()):
        return
    most = max(_most(t.aperture) * _most(t.normal_stiffness) for t in tables if t.pressure is None)
    share = fluid.compressibility * most / (1.0 + fluid.compressibility * most)
    if share < LASTS:
        kept = f", but for about {share:.1g} of the difference" if share else ""
        yield (
            f"initial.pressure = {given.pressure:.6g}{scene.unit_system.behind(STRESS)} does not last: pressure follows from"
            " the volume that fractures hold, whose walls start undeformed, and the first step returns it to"
            f" fluid.initial_pressure{kept}: give fluid.initial_pressure instead, or prescribe it as fracture.NAME.pressure"
        )


def _most(given: float | Profile | None) -> float:
    return max(given.values) if isinstance(given, Profile) else given or 0.0


def _growing(scene: Scene) -> Iterator[str]:
    """A growth that is stated, of cells beside a rupture that explicit steps damp."""
    geometry, method = scene.geometry, scene.method
    if geometry is None or method.stepper != "explicit" or method.fault_damping == 0.0 or not scene.has_dynamics:
        return
    ruptures = [name for name, table in scene.fracture.items() if table.law == "slip-weakening"]
    if geometry.growth is not None and ruptures and geometry.growth > GENTLE:
        yield note(
            f"geometry.growth = {geometry.growth:g}: beside fracture.{ruptures[0]}, cells that grow so send waves back to it:"
            f" the error of its slip falls with their size, and by about the power 1.4 of it at a growth of {GENTLE:g}"
        )


def _jagged(scene: Scene) -> Iterator[str]:
    """Slip rates that probes record where waves run: those of an instant are not to be read."""
    slides = any(JOINT_LAWS[table.law].slides for table in scene.fracture.values())
    names = [
        probe.name
        for probe in scene.probe
        if (
            probe.quantities is None
            and (isinstance(probe.at, FractureEnd | AlongFracture) or (probe.on or "") in scene.fracture)
        )
        or "slip_rate" in (probe.quantities or ())
    ]
    deforms = any(not rock.rigid for rock in scene.rock.values())
    if not (scene.has_dynamics and slides and names and deforms):
        return
    least, unit = _transit(scene), scene.unit_system.written(TIME)
    here = "" if least is None else f" = {TRANSITS * least:.3g} {unit} by the sizes of [geometry]"
    yield note(
        f"probe.{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: behind sharp fronts slip_rate rings with"
        " periods of a few cell transits h/c_s, and finer cells do not lessen it: read slip, or its increase over a time of at"
        f" least {TRANSITS} h/c_s{here}, kept as cells are refined"
    )


def _transit(scene: Scene) -> float | None:
    """Longest time in which a shear wave passes a cell at a fracture [time]; None where the scene states no mesh size."""
    geometry, slowness = scene.geometry, 0.0
    size = None if geometry is None else geometry.size_at_fractures or geometry.size
    if geometry is None or size is None:
        return None
    for rock in scene.rock.values():
        if rock.s_speed:
            slowness = max(slowness, 1.0 / rock.s_speed)
    return size / 2**geometry.refine * slowness
