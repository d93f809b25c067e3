"""Random scenes, small and by seed: a square of rock with fractures that cross or not, or a rigid block between two joints.

The seed's remainders go through kinds of stages, laws, dry and wet, shapes of cells; its generator draws the rest: stiffness,
apertures and durations over decades, so that what may be left out of one scene may not of the next.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from sheets import ROOT

KINDS = ("steady", "quasi-static", "dynamic", "slow", "auto", "search")
LAWS = ("hyperbolic-coulomb", "slip-weakening", "linear")
SIDES = ["west", "east", "south", "north"]
SIDE, STEPS, START = 10.0, 20, 1e6
YOUNG, POISSON, DENSITY = 30e9, 0.2, 2600.0
PERIOD = 4.0 * SIDE / np.sqrt(YOUNG / DENSITY)
EVERY_BLOCK, EVERY_TOLERANCE = 7, 5  # seeds that take a rigid block, or state a tolerance
PERIODS, PARTS = 55.0, 10  # that a slow dynamic stage lasts, and its steps in each: more than it needs
Data = dict[str, Any]


def scene(seed: int) -> Data:
    """The tables of a scene that takes a second or two."""
    draw = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    law = LAWS[seed // 2 % (2 if kind in ("search", "auto") else len(LAWS))]
    if seed % EVERY_BLOCK == 2:
        kind = "quasi-static" if kind in ("auto", "search") else kind
        return block(draw, "dynamic" if kind == "slow" else kind, law)
    return rock(draw, kind, law, wet=kind == "search" or seed % 3 > 0, exact=seed % EVERY_TOLERANCE == 1)


def network(rows: int = 5, columns: int = 6, size: float = 1.0, steps: int = 40) -> Data:
    """A fault that slips slowly between rows of stiff fractures far below their strength."""
    heights = np.concatenate([np.linspace(6.0, 26.0, rows), np.linspace(74.0, 94.0, rows)])
    middles = np.linspace(10.0, 90.0, 2 * columns + 1)[1::2]
    seams = [
        {"name": f"seam{row}-{column}", "points": [[x - 8.0, y], [x + 8.0, y + 1.0]]}
        for row, y in enumerate(heights) for column, x in enumerate(middles)
    ]  # fmt: skip
    fault = {"name": "fault", "points": [[40, 50], [60, 50]]}
    return {
        "output": {"pictures": False},
        "geometry": {"domain": [0, 0, 100, 100], "size": size, "size_at_fractures": size / 2, "fracture": [fault, *seams]},
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500}},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -5e6},
        "fracture": {
            "default": {"normal_stiffness": 2e12, "shear_stiffness": 2e12, "aperture": 1e-3, "friction_angle_deg": 30},
            "fault": {"normal_stiffness": 5e10, "shear_stiffness": 2e10, "aperture": 1e-3, "friction_angle_deg": 2},
        },
        "support": [{"on": ["south"]}],
        "load": [
            {"on": ["north", "east", "west"], "traction": "initial-stress"},
            {"on": "north", "traction": [[[0, 0], [10, 4e5]], 0]},
        ],
        "probe": [{"name": "fault", "at": [50, 50], "on": "fault"}, {"name": "rock", "at": [50, 70]}],
        "stage": [{"kind": "quasi-static", "time_step": 10 / steps, "steps": steps}],
    }  # fmt: skip


def rock(draw: np.random.Generator, kind: str, law: str, wet: bool, exact: bool) -> Data:
    """Elastic rock that is sheared, or whose fractures are pumped into; ``exact`` states a tolerance."""
    count, press = int(draw.integers(1, 4)), float(draw.uniform(8e6, 20e6))
    middle, angle, half = draw.uniform(4, 6, (count, 2)), draw.uniform(0, np.pi, count), draw.uniform(2.0, 3.5, count)
    along = half[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    traces = [
        {"name": f"fault{i}", "points": np.stack([middle[i] - along[i], middle[i] + along[i]]).round(2).tolist()}
        for i in range(count)
    ]
    lasts, quads = duration(draw, kind), bool(draw.integers(2))
    sheared = float(draw.uniform(0.0, 0.25)) * press if wet else 0.0
    data: Data = {
        "output": {"pictures": False},
        "accuracy": {"max_halvings": 4, "max_iterations": 25} | ({"tolerance": 5e-3} if exact else {}),
        "rock": {"rock": {"youngs_modulus": YOUNG, "poissons_ratio": POISSON, "density": DENSITY}},
        "initial_stress": {"xx": -press * float(draw.uniform(0.6, 1.0)), "yy": -press, "zz": -0.8 * press, "xy": sheared},
        "geometry": {
            "domain": [0, 0, SIDE, SIDE], "size": 2.5, "size_at_fractures": 1.2 if quads else 0.8, "fracture": traces,
            "cells": "quads" if quads else "triangles",
        },
        "fracture": {"default": joint(draw, law, press, wet)},
        "probe": [
            {"name": "middle", "at": middle[0].round(2).tolist(), "on": "fault0"},
            {"name": "rock", "at": [2.0, 8.0]},
        ],
        "stage": stages(draw, kind, lasts),
    }  # fmt: skip
    absorbs = kind in ("dynamic", "auto") and bool(draw.integers(2))
    if kind == "search":
        data["control"] = {"raise": {"increment": 0.1}}
    if kind == "slow":
        data["probe"][0]["quantities"] = [
            "displacement",
            "slip",
            "opening",
            "shear_traction",
            "normal_traction",
            *(["pressure"] if wet else []),
        ]
        data["probe"][1]["quantities"] = ["displacement", "strain", "stress"]
    if not wet:
        shift = float(draw.uniform(1.0, 2.5)) * press * SIDE / YOUNG
        data["support"] = [
            {"on": ["south"]},
            {"on": ["north"], "displacement": {"x": [[0, 0], [lasts, shift]], "y": 0}},
        ]
        side = {"on": ["west", "east"]}
        return data | ({"absorbing": [side]} if absorbs else {"load": [{**side, "traction": "initial-stress"}]})
    data |= {"absorbing": [{"on": SIDES}]} if absorbs else {"support": [{"on": SIDES}]}
    data["fluid"] = {
        "viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": START,
        "compressibility": float(draw.choice([0.0, 4.5e-10])),
    }  # fmt: skip
    return data | {"well": wells(draw, kind, press, lasts, data["fracture"]["default"], half[0], count)}


def block(draw: np.random.Generator, kind: str, law: str) -> Data:
    """A rigid block between two joints, pushed and let go, of mass, size and stiffness 1."""
    joint = {"law": law, "normal_stiffness": 1.0, "shear_stiffness": float(draw.uniform(0.5, 2.0)), "aperture": 2.0}
    joint |= {"initial_normal_traction": -1.0, "initial_shear_traction": 0.0} | friction(
        draw, law, 1.0 / joint["shear_stiffness"]
    )
    lasts, held = 20.0 * float(10.0 ** draw.uniform(0, 2)), ["x", "y", "rotation"]
    push = float(draw.uniform(0.5, 1.3))
    return {
        "units": "none", "output": {"pictures": False},
        "mesh": {"file": str(ROOT / "meshes" / "report_5_2" / "block.geo")},
        "rock": {"block": {"rigid": True, "density": 1.0}, "wall": {"rigid": True, "density": 1.0}},
        "fracture": {"upper": joint | {"law": "linear"} if law == "linear" else linear(joint), "lower": joint},
        "support": [{"on": "wall", "components": held}, {"on": "block", "components": held[1:]}],
        "load": [{"on": "left", "traction": [[[0, 0], [0.4 * lasts, push], [0.8 * lasts, -push], [lasts, 0]], 0]}],
        "probe": [{"name": "block", "at": [0, 0], "on": "block"}, {"name": "joint", "at": [0, 0], "on": "lower"}],
        "stage": stages(draw, kind, lasts),
    }  # fmt: skip


def linear(joint: Data) -> Data:
    """The same joint without friction."""
    kept = (
        "normal_stiffness", "shear_stiffness", "aperture", "initial_normal_traction", "initial_shear_traction"
    )  # fmt: skip
    return {"law": "linear"} | {key: joint[key] for key in kept}


def friction(draw: np.random.Generator, law: str, steepest: float) -> Data:
    """Keys that a law has of its own; a strength drops over twice the least distance, stress over stiffness ``steepest``."""
    if law == "linear":
        return {}
    first = float(draw.uniform(0.3, 0.6))
    if law == "hyperbolic-coulomb":
        return {"friction_coefficient": first, "stick_slip_ratio": float(draw.choice([1.0, 0.9]))}
    last = first * float(draw.uniform(0.7, 0.95))
    return {
        "friction_coefficient": first,
        "dynamic_friction_coefficient": last,
        "slip_weakening_distance": 2.0 * (first - last) * steepest,
    }


def joint(draw: np.random.Generator, law: str, press: float, wet: bool) -> Data:
    """Stiffness and aperture over decades: a wide stiff fracture hardly answers to pumping, a narrow soft one does."""
    stiffness = float(10.0 ** draw.uniform(9.5, 11.5))
    found = {"law": law, "normal_stiffness": stiffness, "shear_stiffness": stiffness * float(draw.uniform(0.3, 1.0))}
    found["aperture"] = float(10.0 ** draw.uniform(-3.7, -2.0)) if wet else 1e-2
    return found | friction(draw, law, press / found["shear_stiffness"])


def duration(draw: np.random.Generator, kind: str) -> float:
    """Of the loads: some periods of the rock with inertia, few or many; seconds to days without."""
    if kind == "slow":
        return float(PERIODS * PERIOD)
    if kind in ("dynamic", "search"):
        return float(PERIOD * 10.0 ** draw.uniform(0.0, 2.5))
    return float(10.0 ** draw.uniform(0.0, 5.0))


def stages(draw: np.random.Generator, kind: str, lasts: float) -> list[Data]:
    """Of that kind, for so long; loads are searched for the first failure and raised beyond it, or followed."""
    step = lasts / STEPS
    if kind == "search":
        raised = {"control": "raise", "increment_per_step": 0.02, "then": "hold"}
        search = {"kind": "steady", "until": "incipient", "control": "raise"}
        return [search, {"kind": "dynamic", "time_step": step, "steps": STEPS, **raised}]
    if kind == "auto":
        return [{"kind": "auto", "time_step": step, "dynamic_time_step": PERIOD / 40, "end": lasts, "at_rest": 0.01}]
    if kind == "slow":
        return [{"kind": "dynamic", "time_step": PERIOD / PARTS, "end": lasts}]
    return [{"kind": kind, "time_step": step, "steps": STEPS}]


def wells(
    draw: np.random.Generator, kind: str, press: float, lasts: float, joint: Data, half: float, count: int
) -> list[Data]:
    """Fluid into the first fracture, by rate or by pressure, and mostly out of the last."""
    rise = float(draw.uniform(0.1, 0.6)) * press
    compliance = 1.0 / joint["normal_stiffness"] + half / YOUNG
    well: Data = {"name": "in", "at": {"fracture": "fault0", "end": "start"}}
    if kind == "search":
        well |= {"flow_rate": rise * joint["aperture"] ** 3 / (12e-3 * half), "control": "raise"}
    elif draw.integers(2):
        well["pressure"] = [[0, START], [0.6 * lasts, START + rise], [lasts, START]]
    else:
        well["flow_rate"] = [[0, 0], [0.2 * lasts, 2.0 * half * rise * compliance / lasts]]
    out = {"name": "out", "at": {"fracture": f"fault{count - 1}", "end": "end"}, "pressure": "initial"}
    return [well, out] if kind not in ("quasi-static", "auto") or draw.integers(4) else [well]
