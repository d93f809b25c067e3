"""SEAS BP6-QD-A: a fault with rate-and-state friction that slips slowly as fluid spreads in it for 100 days and drains for 630.

The fault is the one of ``bp6``, whose friction is constant. Its pressure is given, by a formula, or a well brings the fluid.
Beyond 8 km the rock is whole: within 730 days it would creep by a thousandth of the slip at the well. Fluid from a well needs
12 km, since no fluid leaves at the ends.

The benchmark's fluid is compressible by 1e-8/Pa in pores of a tenth, and linearly so. Here density goes as exp(c_f p): at
6.5 MPa that is 3 % more storage than linear, 1.5 % less pressure, and 4 % less slip. So the well's fault has a hundredth of the
compressibility and a hundred times the aperture: the same diffusivity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from figures_verification.case import Bar
from figures_verification.cases.r18 import unbounded

from figures_benchmarks.benchmark import Benchmark, Floats, Line, Ran, clocked, table_of
from figures_benchmarks.cases.bp6 import (
    COMPRESSIBILITY,
    DIFFUSIVITY,
    END,
    FAR,
    GROWTH,
    HALF,
    OFF,
    POROSITY,
    RATE,
    SHEAR,
    STRESS,
    TRACTION,
    pressure,
)  # fmt: skip

SHARE = 0.2  # of D_c in a step
FRONT_COLUMN = "front_m(rate>1e-9)"
FRONT = 1e-9  # rate of slip above which the fault counts as slipping [m/s]
WATCHED = range(0, 1500, 100)  # places where the rate is looked at: it is largest near 600 m
FLUID = 1e-10  # compressibility of the well's fluid [1/Pa]
HALF_OF_WELL = 12000.0  # of the fault that a well brings fluid to [m]
STORAGE = COMPRESSIBILITY * POROSITY  # of the benchmark's fault, per its thickness [1/Pa]
SCENE = """
rock.rock = {{youngs_modulus = {young}, poissons_ratio = 0, density = 2670}}
initial_stress = {{xx = -{stress}, yy = -{stress}, zz = -{stress}, xy = {traction}}}
fluid = {{viscosity = 1e-3, initial_pressure = 0, compressibility = {compressibility}}}
accuracy = {{slip_share = {share}}}
support = [{{on = ["south", "north", "east", "west"]}}]
stage = [
  {{kind = "{kind}", time_step = {first}, end = {off}}},
  {{kind = "{kind}", time_step = {then}, end = {end}}},
]
well = [{well}]
probe = [{probes}]
[geometry]
domain = [-{far}, -{far}, {far}, {far}]
size = 8000
size_at_fractures = {size}
growth = {growth}
fracture = [{{name = "fault", points = [[-{half}, 0], [{half}, 0]]}}]
[fracture.fault]
law = "rate-and-state"
normal_stiffness = 1e13
shear_stiffness = 1e13
aperture = {aperture}
friction_coefficient = 0.6
reference_slip_rate = 1e-6
direct_effect = 0.007
evolution_effect = 0.005
characteristic_slip = 0.004
initial_slip_rate = 1e-12
state_law = "{law}"
{flow}
"""


class Ended(NamedTuple):
    """Slip at the well [m] and potency [m2] at the end, the largest rate of all [m/s], and where it is FRONT at the end [m]."""

    slip: float
    potency: float
    fastest: float
    front: float
    profile: tuple[Floats, Floats]
    seconds: float
    steps: int


def ended(
    size: float, share: float = SHARE, meshed: bool = True, law: str = "ageing", half: float = HALF, well: bool = False
) -> Ended:
    """A run on joints of ``size`` metres, in steps of slip ``share`` D_c, by a law of the state; with cells or without.

    half  of the fault, beyond which the rock is whole [m]
    well  brings the fluid; pressures are given otherwise
    """
    watched = [f'{{name = "z{z}", at = [{z}, 0], on = "fault", quantities = ["sliding_rate"]}}' for z in WATCHED]
    scene = SCENE.format(
        young=2 * SHEAR, stress=STRESS, traction=TRACTION, off=OFF, then=(END - OFF) / 64, end=END,
        share=share, far=FAR, size=size, half=half, growth=GROWTH * size, probes=", ".join(watched), law=law,
        **(_from_a_well() if well else _given(size, half)),
    )  # fmt: skip
    found, seconds = clocked(scene if meshed else unbounded(scene))
    state = found.fractures[-1]
    order = np.argsort(state.points[:, 0], kind="stable")
    z, slip = state.points[order, 0], np.abs(state.point["plastic_slip"][order])
    rates = np.log(state.point["sliding_rate"][order][z >= 0.0] / FRONT)
    return Ended(
        float(np.interp(0.0, z, slip)),
        float(np.sum((slip[1:] + slip[:-1]) / 2 * np.diff(z))),
        max(float(found.probe(f"z{at}", "sliding_rate").max()) for at in WATCHED),
        _front(z[z >= 0.0], rates),
        (z, slip),
        seconds,
        len(found.history["time"]),
    )


def _given(size: float, half: float) -> dict[str, object]:
    """Entries of the scene for pressures by the formula, at the nodes of joints of ``size``."""
    nodes = np.linspace(-half, half, round(2 * half / size) + 1)
    rise = np.linspace(0.0, 1.0, 61) ** 2
    times = np.concatenate([rise * OFF, OFF + rise[1:] * (END - OFF)])
    values = [[float(f"{p:.8g}") for p in pressure(nodes, at)] for at in times]
    flow = f"pressure = {{along = {(nodes + half).tolist()}, time = {times.tolist()}, value = {values}}}"
    return {"kind": "steady", "first": OFF / 16, "well": "", "compressibility": 0.0, "aperture": 1e-3, "flow": flow}


def _from_a_well() -> dict[str, object]:
    """The same for fluid that a well brings until OFF."""
    rate = f'{{time = [0, {OFF}], value = [{RATE}, 0], interpolation = "step"}}'
    return {
        "kind": "quasi-static", "first": OFF / 64, "well": f'{{name = "well", at = [0, 0], flow_rate = {rate}}}',
        "compressibility": FLUID, "aperture": STORAGE / FLUID, "flow": f"conductance = {DIFFUSIVITY * STORAGE}",
    }  # fmt: skip


def _front(z: Floats, rates: Floats) -> float:
    """The last place where the logarithm of the rate passes 0, between places z (n,); the end where it is above there."""
    last = int(np.flatnonzero(rates > 0.0).max(initial=0))
    if last == len(z) - 1:
        return float(z[last])
    return float(z[last] + rates[last] / (rates[last] - rates[last + 1]) * (z[last + 1] - z[last]))


def run(size: float) -> Ran:
    """On joints of ``size`` metres, by pressures that are given."""
    return _held_against(ended(size), size)


def run_with_well(size: float) -> Ran:
    """On joints of ``size`` metres, of a fault in unmeshed rock that a well brings fluid to."""
    return _held_against(ended(size, meshed=False, half=HALF_OF_WELL, well=True), size)


def _held_against(found: Ended, size: float) -> Ran:
    table = table_of("bp6_rate_and_state.csv")
    right = table["slip_0_m"][-1], table["potency_m2"][-1], table["max_rate_m_per_s"].max()
    front = abs(found.front - table[FRONT_COLUMN][-1]) / size
    places = np.array([float(key.split("_")[1]) for key in table if key.startswith("slip_")])
    profile = np.array([table[f"slip_{place:g}_m"][-1] for place in places])
    line = Line("slip after 730 days", "along the fault [m]", "slip [m]", found.profile, (places, profile))
    off = (abs(one / other - 1) for one, other in zip(found[:3], right, strict=True))
    return Ran((*off, front), found.seconds, (line,))


SOURCE = "SEAS BP6-QD-A (Lambert et al. 2025), quasi-dynamic, ageing law, {}; boundary elements of 12.5 m"
OPEN = "the boundary elements are our own; they agree with five public decks in their parameters"
BARS = (
    Bar("slip at z = 0", 0.006, None, 0.01), Bar("potency", 0.01, None, 0.01), Bar("largest rate", 0.02, None, 0.02),
    Bar("front, in joints", 1.0, None, 1.0),
)  # fmt: skip
BENCHMARKS = (
    Benchmark(
        "BP6, rate and state", "BP6, rate and state", SOURCE.format("pressure given"), OPEN, BARS, run, (200.0, 100.0), (),
        "joints [m]",
    ),
    Benchmark(
        "BP6, rate and state, a well", "BP6, a well", SOURCE.format("its diffusivity, the fluid from a well"), OPEN, BARS,
        run_with_well, (100.0, 50.0), (), "joints [m]",
    ),
)  # fmt: skip
