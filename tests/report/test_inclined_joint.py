"""R01: an inclined joint through a compressed specimen. The stress is uniform, so any mesh is exact.

Source: the plane of weakness (Jaeger, Cook & Zimmerman, Fundamentals of Rock Mechanics), with the
closure of Fig. 3 and the strength (2.12) of the report. W = 1 m, H = 2 m, joint at 60 degrees,
sigma_3 = 2 MPa kept on the sides; the top goes down by delta.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

SIN, COS = np.sqrt(3.0) / 2.0, 0.5
TAN = np.tan(np.radians(30.0))
HEIGHT, MODULUS, CONFINEMENT = 2.0, 10e9 / (1.0 - 0.25**2), 2e6
STIFFNESS_N, STIFFNESS_S, APERTURE, COHESION = 20e9, 10e9, 5e-4, 0.1e6
PATH = [[0, 40, 56, 92], [0, 0.0020048897812841465, 0.0012029338687704878, 0.00300733467192622]]


def _strength(alpha):
    """sigma_1 at which the joint slips with alpha times its strength: |f_s| = alpha (C - f_n tan phi)."""
    held = alpha * COHESION + CONFINEMENT * (SIN * COS + alpha * SIN**2 * TAN)
    return held / (SIN * COS - alpha * COS**2 * TAN)


def _joint(sigma):
    """f_n, f_s and the opening under sigma_1."""
    normal = -(CONFINEMENT * SIN**2 + sigma * COS**2)
    closing = (normal + CONFINEMENT) / STIFFNESS_N  # <= 0 here
    return normal, SIN * COS * (CONFINEMENT - sigma), closing / (1.0 - closing / APERTURE)


def _shortening(sigma, plastic):
    """Of the specimen: its rock, and the joint's slip and opening."""
    _, shear, opening = _joint(sigma)
    return HEIGHT * (sigma - CONFINEMENT) / MODULUS - (shear / STIFFNESS_S + plastic) * SIN - opening * COS


def _exact(deltas, alpha):
    """Columns sigma_1, f_n, f_s, opening, slip, plastic slip for each shortening of the path."""
    plastic, sliding, before, rows = 0.0, False, 0.0, []
    for delta in deltas:
        sigma = brentq(lambda s, d=delta, p=plastic: _shortening(s, p) - d, 1e5, 1e8, xtol=1e-9, rtol=8.9e-16)
        sliding = sliding and delta > before
        if sigma > _strength(alpha if sliding else 1.0) * (1.0 + 1e-13):
            sliding, sigma = True, _strength(alpha)
            plastic -= (delta - _shortening(sigma, plastic)) / SIN
        normal, shear, opening = _joint(sigma)
        rows.append([sigma, normal, shear, opening, shear / STIFFNESS_S + plastic, plastic])
        before = delta
    return np.array(rows).T


@pytest.mark.parametrize("mesh", ["quads", "triangles"])
@pytest.mark.parametrize("alpha", [1, 0.9])
def test_closed_form_on_any_mesh(ran, mesh, alpha):
    chosen = f"mesh.file={mesh}.geo", f"fracture.joint.stick_slip_ratio={alpha}"
    history = ran("r01_inclined_joint", *chosen).history
    time = history["time"]
    exact = _exact(np.interp(time, *PATH), alpha)
    settled = np.ones(len(time), dtype=bool)
    # Step 20 is at first slip to the last digit: with a drop, either side of it is right.
    settled[np.isclose(time, 20.0)] = alpha == 1
    normal, shear = history["probe/joint/normal_traction"], history["probe/joint/shear_traction"]
    found = {
        "sigma_1 of f_n": (-(normal + CONFINEMENT * SIN**2) / COS**2, exact[0]),
        "sigma_1 of f_s": (CONFINEMENT - shear / (SIN * COS), exact[0]),
        "normal traction": (normal, exact[1]),
        "shear traction": (shear, exact[2]),
        "opening": (history["probe/joint/opening"], exact[3]),
        "slip": (history["probe/joint/slip"], exact[4]),
        "plastic slip": (history["probe/joint/plastic_slip"], exact[5]),
    }
    for name, (got, right) in found.items():
        assert np.abs(got - right)[settled].max() <= 1e-9 * np.abs(right).max(), name
    assert exact[0].max() == pytest.approx(6.346410161513775e6 if alpha == 1 else exact[0].max(), rel=1e-12)
    assert abs(exact[5][-1]) > 1e-3


def test_strength_is_jaegers():
    """sigma_1 - sigma_3 = 2 (C + sigma_3 tan phi) / ((1 - tan phi cot theta) sin 2 theta)."""
    jaeger = 2.0 * (COHESION + CONFINEMENT * TAN) / ((1.0 - TAN * COS / SIN) * 2.0 * SIN * COS)
    assert _strength(1.0) == pytest.approx(CONFINEMENT + jaeger, rel=1e-14)
