"""R01: an inclined joint through a compressed specimen. The stress is uniform, so any mesh is exact.

Source: the plane of weakness (Jaeger, Cook & Zimmerman, Fundamentals of Rock Mechanics), with the
closure of Fig. 3 and the strength (2.12) of the report. W = 1 m, H = 2 m, joint at 60 degrees,
sigma_3 = 2 MPa kept on the sides; the top goes down by delta.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq
from sheets import ROOT

from figures_verification.case import Bar, Case
from figures_verification.runs import Floats, solve

SIN, COS = np.sqrt(3.0) / 2.0, 0.5
TAN = np.tan(np.radians(30.0))
HEIGHT, MODULUS, CONFINEMENT = 2.0, 10e9 / (1.0 - 0.25**2), 2e6
STIFFNESS_N, STIFFNESS_S, APERTURE, COHESION = 20e9, 10e9, 5e-4, 0.1e6
PATH = [[0, 40, 56, 92], [0, 0.0020048897812841465, 0.0012029338687704878, 0.00300733467192622]]
FOLDER = ROOT / "meshes" / "r01_inclined_joint"


def strength(alpha: float) -> float:
    """sigma_1 at which the joint slips with alpha times its strength: |f_s| = alpha (C - f_n tan phi)."""
    held = alpha * COHESION + CONFINEMENT * (SIN * COS + alpha * SIN**2 * TAN)
    return float(held / (SIN * COS - alpha * COS**2 * TAN))


def joint(sigma: float) -> tuple[float, float, float]:
    """f_n, f_s and the opening under sigma_1."""
    normal = -(CONFINEMENT * SIN**2 + sigma * COS**2)
    closing = (normal + CONFINEMENT) / STIFFNESS_N  # <= 0 here
    return normal, SIN * COS * (CONFINEMENT - sigma), closing / (1.0 - closing / APERTURE)


def shortening(sigma: float, plastic: float) -> float:
    """Of the specimen: its rock, and the joint's slip and opening."""
    _, shear, opening = joint(sigma)
    return HEIGHT * (sigma - CONFINEMENT) / MODULUS - (shear / STIFFNESS_S + plastic) * SIN - opening * COS


def exact(deltas: Floats, alpha: float) -> Floats:
    """Rows sigma_1, f_n, f_s, opening, slip, plastic slip for each shortening of the path."""
    plastic, sliding, before, rows = 0.0, False, 0.0, []
    for delta in deltas:
        sigma = brentq(lambda s, d=delta, p=plastic: shortening(s, p) - d, 1e5, 1e8, xtol=1e-9, rtol=8.9e-16)
        sliding = sliding and delta > before
        if sigma > strength(alpha if sliding else 1.0) * (1.0 + 1e-13):
            sliding, sigma = True, strength(alpha)
            plastic -= (delta - shortening(sigma, plastic)) / SIN
        normal, shear, opening = joint(sigma)
        rows.append([sigma, normal, shear, opening, shear / STIFFNESS_S + plastic, plastic])
        before = delta
    return np.array(rows).T


def mesh(cells: str, size: float, structured: bool) -> str:
    """The geometry of the scene with cells of about ``size``; structured: rows and columns that the joint distorts."""
    text = (FOLDER / f"{cells}.geo").read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith("size =")]
    half = 2 if cells == "quads" else 1  # Gmsh's subdivision halves them
    kept.insert(3, f"size = {half * size};")
    if structured:
        kept = [line for line in kept if not line.startswith("Mesh.")]
        kept += [f"Transfinite Curve {{1:7}} = {round(1 / size) + 1};", 'Transfinite Surface "*";']
        kept += ['Recombine Surface "*";'] if cells == "quads" else []
    return "\n".join([*kept, ""])


def errors(alpha: float, cells: str, structured: bool) -> Callable[[float], tuple[float, ...]]:
    """Of what the joint shows along the path, each over its largest value: the largest."""
    given = (FOLDER / "scene.toml").read_text(encoding="utf-8")
    head, _, tail = given.partition("[mesh]\n")
    scene = head + tail.partition("\n")[2]

    def at(size: float) -> tuple[float, ...]:
        found = solve(scene, f"fracture.joint.stick_slip_ratio={alpha}", mesh=mesh(cells, size, structured))
        time = found.history["time"]
        sigma, *right = exact(np.interp(time, *PATH), alpha)
        # Step 20 is at first slip to the last digit: with a drop, either side of it is right.
        settled = ~np.isclose(time, 20.0) | (alpha == 1)
        names = ("normal_traction", "shear_traction", "opening", "slip", "plastic_slip")
        pairs = [(found.probe("joint", name), values) for name, values in zip(names, right, strict=True)]
        pairs += [
            (-(pairs[0][0] + CONFINEMENT * SIN**2) / COS**2, sigma),
            (CONFINEMENT - pairs[1][0] / SIN / COS, sigma),
        ]
        return (max(float(np.abs(got - wanted)[settled].max() / np.abs(wanted).max()) for got, wanted in pairs),)

    return at


BARS = (Bar("tractions, slip, opening", 1e-9),)
CASES = tuple(
    Case(f"R01 inclined joint, {alpha:g}, {'' if structured else 'un'}structured {cells}", BARS,
         errors(alpha, cells, structured), (0.25, 0.125), (0.25,) if (alpha == 1) == ((cells == "quads") != structured) else ())
    for alpha in (1, 0.9) for cells in ("quads", "triangles") for structured in (True, False)
)  # fmt: skip
