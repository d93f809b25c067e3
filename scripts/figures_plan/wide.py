"""Random scenes in wide rock, by seed: one to four fractures that are pumped into, in boxes whose sides hold the rock.

A box is from 4 to 100 times as wide as its fractures are long: most sides hardly matter, and some do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from figures_plan.scenes import DENSITY, POISSON, SIDES, START, YOUNG, Data, friction

JOINTS, STEPS = 128, 16  # joints along the longest fracture there may be; steps of the stage
MEASURED = ["slip", "opening", "shear_traction", "normal_traction", "pressure"]


def wide(seed: int, joints: int = JOINTS) -> Data:
    """The tables of a scene whose sizes, stiffness and rates go over decades; it takes some seconds."""
    draw = np.random.default_rng((seed, 22))
    count, press, half = int(draw.integers(1, 5)), float(draw.uniform(8e6, 20e6)), float(10.0 ** draw.uniform(0.5, 1.7))
    width = half * float(10.0 ** draw.uniform(0.9, 2.3))
    spread, angle = 1.5 * half * np.sqrt(count - 1.0), draw.uniform(0.0, np.pi, count)
    middle = draw.uniform(-spread, spread, (count, 2))
    along = half * draw.uniform(0.5, 1.0, (count, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    size = 2.0 * half / joints
    digits = 3 - int(np.floor(np.log10(half)))
    box = 0.5 * max(width, 3.0 * (spread + half))
    lasts = float(10.0 ** draw.uniform(2.0, 5.0))
    joint = beside_rock(draw, press, half)
    rise = float(draw.uniform(0.1, 0.5)) * press
    compliance = 1.0 / joint["normal_stiffness"] + half / YOUNG
    return {
        "output": {"pictures": False},
        "rock": {"rock": {"youngs_modulus": YOUNG, "poissons_ratio": POISSON, "density": DENSITY}},
        "initial_stress": {"xx": -press * float(draw.uniform(0.7, 1.0)), "yy": -press, "zz": -0.8 * press,
                           "xy": float(draw.uniform(0.0, 0.2)) * press},
        "geometry": {
            "domain": [-box, -box, box, box], "size": box / 6.0, "size_at_fractures": size,
            "fracture": [
                {"name": f"fault{i}", "points": np.stack([middle[i] - along[i], middle[i] + along[i]]).round(digits).tolist()}
                for i in range(count)
            ],
        },
        "fracture": {"default": joint},
        "support": [{"on": SIDES}],
        "fluid": {"viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": START, "compressibility": 4.5e-10},
        "well": [{"name": "in", "at": {"fracture": "fault0", "end": "start"},
                  "flow_rate": [[0, 0], [0.2 * lasts, 2.0 * half * rise * compliance / lasts]]}],
        "probe": [{"name": "middle", "at": middle[0].round(digits).tolist(), "on": "fault0", "quantities": MEASURED}],
        "stage": [{"kind": "quasi-static", "time_step": lasts / STEPS, "steps": STEPS}],
    }  # fmt: skip


def beside_rock(draw: np.random.Generator, press: float, half: float) -> dict[str, Any]:
    """A joint between a tenth and ten times as stiff as the rock around its fracture."""
    stiffness = YOUNG / half * float(10.0 ** draw.uniform(-1.0, 1.0))
    law = str(draw.choice(["hyperbolic-coulomb", "slip-weakening"]))
    found = {"law": law, "normal_stiffness": stiffness, "shear_stiffness": stiffness * float(draw.uniform(0.3, 1.0))}
    found["aperture"] = max(float(10.0 ** draw.uniform(-3.7, -3.0)), 0.5 * press / stiffness)
    return found | friction(draw, law, press / found["shear_stiffness"] + press * half / YOUNG)
