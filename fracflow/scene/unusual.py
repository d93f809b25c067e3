"""Values that are allowed but far from what is usual: a unit may have been forgotten, or a control left at 0."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from fracflow.scene.profiles import Profile
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import (
    ANGLE,
    AREA,
    COMPRESSIBILITY,
    DENSITY,
    FLOW_RATE,
    LENGTH,
    STIFFNESS,
    STRESS,
    VELOCITY,
    VISCOSITY,
)

FAR_OFF = 10.0  # extents of a map in degrees that lie between it and (0, 0)
SLIGHT = 1e3  # Pa: an initial stress of less is that of a hand's breadth of rock, a pressure that of one of water
BESIDE = 2e-3  # of the largest initial stress: an initial pressure of less may be kPa for MPa
SHALLOW = 1e4  # Pa: that of a metre of water, from which on none is unusual
STREAM = 0.2  # m^3/s: few wells bring more
THIN = 0.2  # m: a depth of the flow below it, and below a hundredth of a trace, is no depth of a model of that trace
THIN_OF_TRACE = 0.01
WIDE = 0.04  # m: few fractures are wider whose conductance is that of their aperture
LIQUID = 1e-4  # Pa s: no gas is as viscous
YIELDING = 2e-8  # 1/Pa: no liquid is as compressible
LIGHT = 50.0  # kg/m^3: no liquid is as light
BREAKS = 1e-3  # a strain, from which on rock is not elastic
LOCKS = 0.4  # up to which a crack opens by no more than 2 % less than at 0.25, see tests/mesh/test_stiff_cells.py
DECIMALS = 3  # that coordinates on a plane may have
STIFFNESS_RATIOS = (2e-3, 30.0)  # of shear over normal stiffness: joints have 0.01 to 1; one unit of two may be wrong
CLOSED, CLOSED_APERTURES = 0.01, 5.0  # m, and apertures, by which few joints close under the stress of their depth

# key -> dimension, smallest and largest value in SI that rock, joints and fluids usually have
USUAL = {
    "rock": {"youngs_modulus": (STRESS, 1e8, 1e12), "density": (DENSITY, 500.0, 1e4)},
    "fracture": {
        "normal_stiffness": (STIFFNESS, 1e6, 1e16),
        "shear_stiffness": (STIFFNESS, 1e5, 1e16),
        "aperture": (LENGTH, 1e-6, 0.1),
        "hydraulic_aperture": (LENGTH, 1e-8, 0.02),
        "hydraulic_opening_ratio": ("", 0.01, 2.0),
        "friction_coefficient": ("", 0.01, 2.0),
        "friction_angle_deg": (ANGLE, 0.035, 1.31),  # radians
        "direct_effect": ("", 1e-4, 0.1),
        "evolution_effect": ("", 1e-4, 0.1),
        "characteristic_slip": (LENGTH, 1e-7, 1.0),
        "reference_slip_rate": (VELOCITY, 1e-14, 0.1),
    },
    "leak_off": {"permeability": (AREA, 1e-24, 1e-10), "storage": (COMPRESSIBILITY, 1e-13, 1e-7)},
    "fluid": {
        "viscosity": (VISCOSITY, 1e-5, 0.5),
        "density": (DENSITY, 0.1, 3e3),
        "compressibility": (COMPRESSIBILITY, 1e-11, 1e-4),
    },
}


def degrees(scene: Scene) -> Iterator[str]:
    """A line on traces that are longitudes and latitudes: all in their range, far from (0, 0) for their size, of many digits.

    A plane has its origin in a corner or the middle of a sample, or far away, beyond the range of degrees.
    """
    traces = scene.geometry.fracture if scene.geometry is not None else ()
    if not traces:
        return
    points = np.concatenate([np.asarray(trace.points, dtype=float) for trace in traces])
    extent, middle = float(np.ptp(points, axis=0).max()), points.mean(axis=0)
    is_fine = np.abs(points - np.round(points, DECIMALS)) > 1e-9
    if np.all(np.abs(points) <= (180.0, 90.0)) and FAR_OFF * extent < np.linalg.norm(middle) and is_fine.mean() > 0.5:
        unit = scene.unit_system.behind(LENGTH)
        yield (
            f"geometry: all traces lie within {extent:.3g}{unit} around ({middle[0]:.6g}, {middle[1]:.6g}), as longitudes and"
            f" latitudes would; degrees are taken as{unit or ' lengths'}: project the map to a plane first, such as UTM"
        )


def slight(scene: Scene) -> Iterator[str]:
    """An initial stress that is next to nothing beside rock and joints: MPa may have been written as Pa."""
    stress = scene.initial_stress
    if not _is_of_rock(scene) or stress is None or any(stress.gradient.model_dump().values()):
        return
    given = {axis: getattr(stress, axis) for axis in ("xx", "yy", "zz", "xy")}
    axis = max(given, key=lambda each: abs(given[each]))
    if 0.0 < abs(given[axis]) * scene.unit_system.to_si(STRESS) < SLIGHT:
        yield _mistaken(
            scene, f"initial_stress.{axis}", given[axis], STRESS, "the largest of it, next to nothing in rock", "MPa"
        )


def _is_of_rock(scene: Scene) -> bool:
    """Whether its units are known, and one of its rocks is as stiff as rock."""
    if scene.units == "none":
        return False
    stiff = max((rock.youngs_modulus or 0.0 for rock in scene.rock.values()), default=0.0)
    return stiff * scene.unit_system.to_si(STRESS) >= USUAL["rock"]["youngs_modulus"][1]


def _mistaken(scene: Scene, key: str, value: float, dimension: str, is_so: str, usual: str) -> str:
    """A line on a value that may be one in a ``usual`` unit whose name was forgotten, or that has the wrong unit."""
    unit, factor = scene.unit_system.written(dimension), scene.unit_system.convert(f"1 {usual}", dimension)
    in_usual = "" if unit == usual else f" ({value / factor:.4g} {usual})"
    return (
        f"{key} = {value:g} {unit}{in_usual} is {is_so}: is its unit right? Numbers without a unit are in {unit}; where"
        f' {value:g} stands alone and means {usual}, give "{value:g} {usual}"'
    )


def _of_wells(scene: Scene) -> Iterator[str]:
    """Pressures that are next to nothing in rock, and flow rates of a stream: units may have been forgotten."""
    fluid = scene.fluid if _is_of_rock(scene) else None
    if fluid is None:
        return
    pressures = {} if fluid.pressure_gradient else {"fluid.initial_pressure": [fluid.initial_pressure]}
    for well in scene.well:
        limits = {"maximum_pressure": well.maximum_pressure, "minimum_pressure": well.minimum_pressure}
        pressures |= {f"well.{well.name}.{key}": [limit] for key, limit in limits.items() if limit is not None}
        if isinstance(well.pressure, TimeTable):
            pressures[f"well.{well.name}.pressure"] = [*well.pressure.values]
        if well.flow_rate is not None:
            rate = max(well.flow_rate.values, key=abs)
            if abs(rate) * scene.unit_system.to_si(FLOW_RATE) > STREAM:
                depth = f"{scene.flow_depth:g}{scene.unit_system.behind(LENGTH)}"
                yield (
                    _mistaken(scene, f"well.{well.name}.flow_rate", rate, FLOW_RATE, "more than wells bring", "L/s")
                    + f"; it enters fluid.flow_depth = {depth} of the fractures"
                )
    for key, values in pressures.items():
        most = max(values, key=abs)
        least = _least_initial(scene) if key == "fluid.initial_pressure" else SLIGHT
        if 0.0 < abs(most) * scene.unit_system.to_si(STRESS) < least:
            yield _mistaken(scene, key, most, STRESS, "next to nothing in rock", "MPa")


def _least_initial(scene: Scene) -> float:
    """Below it an initial pressure is next to nothing, also beside the initial stress [Pa]."""
    stress = scene.initial_stress
    largest = 0.0 if stress is None else max(abs(stress.xx), abs(stress.yy), abs(stress.zz or 0.0))
    return max(SLIGHT, min(BESIDE * largest * scene.unit_system.to_si(STRESS), SHALLOW))


def _thin(scene: Scene) -> Iterator[str]:
    """A depth of the flow out of the plane that may be an aperture."""
    fluid = scene.fluid
    if fluid is None or "flow_depth" not in fluid.model_fields_set:
        return
    traces = scene.geometry.fracture if scene.geometry is not None else ()
    longest = max((float(np.linalg.norm(np.ptp(np.asarray(trace.points), axis=0))) for trace in traces), default=0.0)
    metres, unit = scene.unit_system.to_si(LENGTH), scene.unit_system.behind(LENGTH)
    if fluid.flow_depth * metres < min(THIN, THIN_OF_TRACE * longest * metres):
        yield (
            f"fluid.flow_depth = {fluid.flow_depth:g}{unit} is unusually small beside fractures of {longest:.3g}{unit}: it is"
            " the depth out of the plane that flow_rate of wells enters, no aperture: is its unit right?"
        )


def _light(scene: Scene) -> Iterator[str]:
    """A liquid, by its viscosity, that is as light or as compressible as a gas: a unit may be that of another factor."""
    fluid, least = scene.fluid, USUAL["fluid"]["density"][1]
    if fluid is None or fluid.viscosity * scene.unit_system.to_si(VISCOSITY) < LIQUID:
        return
    yielding = fluid.compressibility * scene.unit_system.to_si(COMPRESSIBILITY)
    if YIELDING < yielding <= USUAL["fluid"]["compressibility"][2]:
        yield (
            f"fluid.compressibility = {fluid.compressibility:g} {scene.unit_system.written(COMPRESSIBILITY)} is that of a gas,"
            " of a liquid's viscosity: is its unit right? Water has 0.45 1/GPa"
        )
    if fluid.density and least <= fluid.density * scene.unit_system.to_si(DENSITY) < LIGHT:
        yield _mistaken(
            scene, "fluid.density", fluid.density, DENSITY, "that of a gas, of a liquid's viscosity", "g/cm^3"
        )


def _violent(scene: Scene) -> Iterator[str]:
    """Waves, and supports in stages with inertia, that move rock at a speed which no rock stands: a strain of v/c_p."""
    limit = BREAKS * max((rock.p_speed for rock in scene.rock.values()), default=0.0)
    if not limit or not scene.has_dynamics:
        return
    speeds = {
        f"absorbing.{number}.wave.velocity": max(map(abs, each.wave.velocity.values))
        for number, each in enumerate(scene.absorbing)
        if each.wave is not None
    }
    for number, support in enumerate(scene.support):
        for part, table in (support.displacement or {}).items():
            if part != "rotation":
                speeds[f"support.{number}.displacement.{part}, whose table rises by"] = table.steepest
    for key, speed in speeds.items():
        if speed > limit:
            unit = scene.unit_system.written(VELOCITY)
            yield (
                f"{key} = {speed:.4g} {unit} is {BREAKS * speed / limit:.2g} of the speed of P waves, a strain as large, at"
                " which rock breaks: is its unit right?"
            )


def _tensile(scene: Scene) -> Iterator[str]:
    """Initial stresses in the plane that are tension: compression may have been written as positive."""
    stress = scene.initial_stress
    if not _is_of_rock(scene) or stress is None or any(stress.gradient.model_dump().values()):
        return
    for axis in ("xx", "yy"):
        value = getattr(stress, axis)
        if value * scene.unit_system.to_si(STRESS) > SLIGHT:
            yield (
                f"initial_stress.{axis} = {value:g} {scene.unit_system.written(STRESS)} is tension, as compression is negative:"
                " is its sign right?"
            )


def _stiffnesses(scene: Scene) -> Iterator[str]:
    """Joints that the initial stress has closed by far too much, or whose two stiffnesses are too far from each other."""
    unit, metres = scene.unit_system.written(STIFFNESS), scene.unit_system.to_si(LENGTH)
    for name, table in scene.fracture.items():
        normal, shear, aperture = table.normal_stiffness, table.shear_stiffness, table.aperture
        if isinstance(normal, Profile) or isinstance(shear, Profile):
            continue
        closed = _compression(scene, name) / normal
        if isinstance(aperture, float) and closed * metres > CLOSED and closed > CLOSED_APERTURES * aperture > 0.0:
            yield (
                f"fracture.{name}.normal_stiffness = {normal:g} {unit} is soft beside the initial stress: that has closed the"
                f" joint by {closed:.2g}{scene.unit_system.behind(LENGTH)}, {closed / aperture:.2g} times the"
                " aperture: is its unit right?"
            )
        elif not STIFFNESS_RATIOS[0] <= shear / normal <= STIFFNESS_RATIOS[1]:
            yield (
                f"fracture.{name}.shear_stiffness = {shear:g} {unit} is {shear / normal:.2g} of normal_stiffness, {normal:g}"
                f" {unit}; joints have 0.01 to 1: are both units right?"
            )


def _compression(scene: Scene, name: str) -> float:
    """The least effective compression across a fracture at the start, whatever its direction [stress]; 0 if not known."""
    given, stress = scene.fracture[name].initial_normal_traction, scene.initial_stress
    if isinstance(given, float):
        return max(-given, 0.0)
    if given is not None or stress is None or any(stress.gradient.model_dump().values()):
        return 0.0
    fluid = scene.fluid
    if fluid is not None and fluid.pressure_gradient:
        return 0.0
    most = 0.5 * (stress.xx + stress.yy) + float(np.hypot(0.5 * (stress.xx - stress.yy), stress.xy))
    return max(-most - (fluid.initial_pressure if fluid is not None else 0.0), 0.0)


def locking(scene: Scene) -> Iterator[str]:
    """Rock on a mesh whose volume hardly changes: its cells have not the freedom for that."""
    for name, rock in scene.rock.items() if not scene.is_unbounded else ():
        if not rock.rigid and (rock.poissons_ratio or 0.0) > LOCKS:
            yield (
                f"rock.{name}.poissons_ratio = {rock.poissons_ratio:g}: cells of rock that keeps its volume are too stiff: slip"
                f" and opening come out too small, most near 0.5: take at most {LOCKS:g}, or ever finer cells"
            )


def unusual(scene: Scene) -> Iterator[str]:
    """A line for each value far from what is usual, where the units are known."""
    if scene.units == "none":
        return
    yield from slight(scene)
    yield from _tensile(scene)
    yield from _stiffnesses(scene)
    yield from _of_wells(scene)
    yield from _thin(scene)
    yield from _light(scene)
    yield from _violent(scene)
    tables: list[tuple[str, Any, str]] = [(f"rock.{name}", rock, "rock") for name, rock in scene.rock.items()]
    tables += [(f"fracture.{name}", table, "fracture") for name, table in scene.fracture.items()]
    leaky = [(name, table.leak_off) for name, table in scene.fracture.items() if table.leak_off is not None]
    tables += [(f"fracture.{name}.leak_off", rock, "leak_off") for name, rock in leaky]
    tables += [("fluid", scene.fluid, "fluid")] if scene.fluid is not None else []
    for path, table, kind in tables:
        for key, (dimension, least, most) in USUAL[kind].items():
            value = getattr(table, key)
            if value is None or isinstance(value, Profile) or value == 0.0:
                continue
            in_si = value * scene.unit_system.to_si(dimension)
            if key == "aperture" and scene.has_flow and table.hydraulic_aperture is None and table.conductance is None:
                most = WIDE
            if not least <= in_si <= most:
                stated = f"{value:g} {scene.unit_system.written(dimension)}".rstrip()
                few = "small" if in_si < least else "large"
                remedy = "is its unit right?"
                if key == "friction_coefficient" and in_si > most:
                    remedy = "give an angle as friction_angle_deg"
                elif key == "friction_angle_deg" and value < most:
                    remedy = f'give "{value:g} rad", if that is meant'
                yield f"{path}.{key} = {stated} is unusually {few}: {remedy}"


def controls_at_zero(scene: Scene) -> Iterator[str]:
    """Lines on controls that stay at 0: a search raises them from there, and a share of their value does not."""
    searches = [stage.control if stage.until is not None else None for stage in scene.stage]
    for kind in ("well", "load"):
        for entry in getattr(scene, kind):
            name = getattr(entry, "control", None)
            if name is None or scene.control[name].initial or name in searches:
                continue
            label = getattr(entry, "name", None)
            where = f"{kind}.{label}" if label else kind
            yield (
                f'{where}: control "{name}" stays at 0 in every stage: give control.{name}.initial = 1,'
                ' or a stage until = "incipient" with this control'
            )
    for number, stage in enumerate(scene.stage):
        name = stage.control
        if stage.increment_per_step and name and not scene.control[name].initial and name not in searches[:number]:
            yield (
                f'stage.{number}.increment_per_step raises control "{name}" over its value at the start of the stage, which is'
                f" 0: it stays at 0; give control.{name}.initial"
            )
