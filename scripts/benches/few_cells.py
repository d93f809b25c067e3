"""Slip that method.fault_damping takes off a fault with few cells along it: few_cells.py [CELLS...] [--ratio XI].

A fault of 100 m is loaded above its strength, slips at once and comes to rest. Prints its slip for each number of cells, and
its loss against the limit of the last three numbers, each twice the one before. Exit code 1 where a loss is above twice that
which the log foretells, or below half of it. It foretells none for ratios below 0.25, where slip has no order in the number
of cells. The defaults take 5 CPU s.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from fracflow.api import run
from fracflow.model.terms.fault_damping import LOST
from fracflow.scene.scene import Scene

FAULT = {
    "law": "slip-weakening", "normal_stiffness": 1e12, "shear_stiffness": 1e12, "aperture": 1e-3,
    "friction_coefficient": 0.6, "dynamic_friction_coefficient": 0.4, "slip_weakening_distance": 1e-3,
    "initial_shear_traction": 19e6,
}  # fmt: skip


def scene(cells: int, ratio: float) -> Scene:
    """The fault with so many cells along it."""
    size = 100.0 / cells
    trace = {"name": "f", "points": [[-50.0, 0.0], [50.0, 0.0]]}
    return Scene.from_data(
        {
            "geometry": {
                "domain": [-200.0, -150.0, 200.0, 150.0], "size": max(size, 10.0), "size_at_fractures": size,
                "fracture": [trace],
            },
            "rock": {"rock": {"youngs_modulus": 40e9, "poissons_ratio": 0.25, "density": 2700.0}},
            "initial_stress": {"xx": -30e6, "yy": -30e6, "xy": 17e6, "unbalanced": "carried"},
            "fracture": {"f": FAULT},
            "absorbing": [{"on": ["west", "east", "south", "north"]}],
            "method": {"stepper": "explicit", "fault_damping": ratio},
            "output": {"pictures": False},
            "probe": [{"name": "middle", "at": [0.0, 0.0], "on": "f", "quantities": ["slip"]}],
            "stage": [{"kind": "dynamic", "time_step": 2e-3, "end": 0.12}],
        }
    )  # fmt: skip


def main() -> int:
    """Run all sizes; 1 where a loss is not as foretold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cells", type=int, nargs="*", default=[5, 10, 20, 40, 80])
    parser.add_argument("--ratio", type=float, default=0.25)
    given = parser.parse_args()
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for cells in given.cells:
            history = run(scene(cells, given.ratio), Path(folder) / str(cells)).history
            found.append(
                max(float(np.abs(history[key]).max()) for key in history if key.startswith("probe/middle/slip"))
            )
    a, b, c = found[-3:]
    limit = c + (c - b) ** 2 / ((b - a) - (c - b))
    print(f"limit {limit:.5f} m")
    wrong = 0
    for cells, slip in zip(given.cells, found, strict=True):
        loss, foretold = 1.0 - slip / limit, min(1.0, LOST / cells)
        is_off = not 0.5 * foretold <= loss <= 2.0 * foretold
        wrong += is_off
        print(f"{cells:4d} cells: slip {slip:.5f} m, {loss:6.1%} lost, foretold {foretold:6.1%}{' OFF' * is_off}")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
