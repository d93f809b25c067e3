"""A wedge of rock between two open fractures that meet at a small angle: wedge.py [JOINTS...] [--angle DEGREES].

JOINTS are those at the tip of the shorter fracture, in the thickness of the wedge there. Prints for each how far volumes are
from those with twice the most joints, over their own size, and openings, over the largest. ``fracflow.mesh.plane.sizes`` has a
table of the latter: meshes get ``PER_ROOT`` joints, and under ``ROOT`` a run is told. Exit code 1 where openings err by more
than 1.5 times that. The defaults take 6 CPU s.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fracflow
from fracflow.mesh.plane import sizes
from fracflow.output import list_steps, read_mesh, read_step
from fracflow.scene.scene import Scene

SIZE = 0.1  # of cells beside the fractures but at that tip
MOST = 1.5  # times the error that is stated


def scene(angle: float, size: float) -> Scene:
    """Two fractures in a wide box, pressed open; the shorter one leaves the middle of the other at an angle [degrees]."""
    tip = [0.9, 0.9 * float(np.tan(np.radians(angle)))]
    traces = [{"name": "a", "points": [[-1, 0], [1, 0]]}, {"name": "b", "points": [[0, 0], tip]}]
    domain = [-10, -10, 10, 10]
    return Scene.from_data(
        {
            "output": {"pictures": False},
            "rock": {"rock": {"youngs_modulus": 50e9, "poissons_ratio": 0.25}},
            "initial_stress": {"xx": 0, "yy": 0, "zz": 0, "xy": 0},
            "fluid": {"viscosity": 1e-3, "initial_pressure": 0},
            "stage": [{"kind": "steady", "time_step": 0.5, "steps": 2}],
            "support": [{"on": ["south", "east", "west", "north"]}],
            "model": "full",
            "geometry": {
                "domain": domain, "size": 2, "growth": 0.2, "size_at_fractures": size, "snap": 1e-4, "fracture": traces,
            },
            "fracture": {
                "default": {
                    "normal_stiffness": 1e13, "shear_stiffness": 1e11, "aperture": 1e-3, "friction_coefficient": 0.5,
                    "pressure": [[0, 0], [1, 1e5]],
                }
            },
        }
    )  # fmt: skip


def openings(angle: float, joints: float, folder: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Volumes (2,) of both fractures, and their openings (2, 18) at places along them, with so many joints at the tip."""
    stated, sizes.PER_ROOT = sizes.PER_ROOT, joints
    try:
        out = folder / f"{joints:g}"
        fracflow.run(scene(angle, SIZE), out)
    finally:
        sizes.PER_ROOT = stated
    share, found = np.linspace(0.05, 0.95, 18), []
    points, pieces, _ = read_mesh(out, "fractures")
    ends, opening = points[pieces][..., :2], read_step(list_steps(out, "fractures")[-1][1])[1]["opening"][pieces]
    is_b = np.any(ends[..., 1] > 1e-9, axis=1)
    volumes = []
    for here in (~is_b, is_b):
        length = np.linalg.norm(ends[here, 1] - ends[here, 0], axis=1)
        volumes.append(float(opening[here].mean(axis=1) @ length))
        along = ends[here, :, 0].ravel()
        order = np.argsort(along, kind="stable")
        span = np.interp(share, [0.0, 1.0], [along.min(), along.max()])
        found.append(np.interp(span, along[order], opening[here].ravel()[order]))
    return np.array(volumes), np.array(found)


def errors(angle: float, joints: Sequence[float]) -> dict[float, tuple[float, float]]:
    """Largest errors of volumes, over their own size, and of openings, over the largest, by joints at the tip."""
    with tempfile.TemporaryDirectory() as name:
        volume, opening = openings(angle, 2.0 * max(joints), Path(name))
        found = {}
        for each in joints:
            its_volume, its_opening = openings(angle, each, Path(name))
            apart = (
                (np.abs(its_volume - volume) / volume).max(),
                np.abs(its_opening - opening).max() / opening.max(),
            )
            found[each] = float(apart[0]), float(apart[1])
    return found


def main() -> int:
    """1 where an error is more than stated."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("joints", type=float, nargs="*", default=[1.0, 4.0, sizes.ROOT, sizes.PER_ROOT])
    parser.add_argument("--angle", type=float, default=6.0)
    given = parser.parse_args()
    wrong = 0
    for joints, (volume, opening) in errors(given.angle, given.joints).items():
        stated = sizes.ERROR_OF_WEDGE.get(joints)
        wrong += stated is not None and opening > MOST * stated
        said = "" if stated is None else f", stated {stated:.1%}"
        print(f"{joints:g} joints: volumes {volume:.1%}, openings {opening:.1%}{said}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
