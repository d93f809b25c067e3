"""R06: Wijesinghe (1986), a fracture in compressed rock injected at constant pressure; hyperbolic law and cubic law.

Fracture, fluid and stress of the public benchmark "single_fracture" of OpenGeoSys (LIE, hydro-mechanics); its rock of
60 GPa bends and adds some 8 % to k_n, so here the rock is of 1 Pa: each node of the film opens by itself.
"""

import numpy as np
import pytest
import winkler

APERTURE, STIFFNESS, VISCOSITY, AT_REST, PUMPED = 1e-5, 1e11, 1e-3, 11e6, 11.9e6
DIFFUSIVITY = APERTURE**3 * STIFFNESS / (12 * VISCOSITY)
END = 100.0
FRACTURE = f"""
[fracture.film]
normal_stiffness = {STIFFNESS}
shear_stiffness = {STIFFNESS}
aperture = {APERTURE}
friction_angle_deg = 30
"""
SCENE = (
    winkler.SCENE.replace('units = "none"', "")
    .replace("youngs_modulus = 1e-15", "youngs_modulus = 1")
    .replace("viscosity = 1", f"viscosity = {VISCOSITY}")
    .replace("yy = -{pressure}", "yy = -50e6")
    .format(pressure=AT_REST)
)
SCENE = SCENE[: SCENE.index("[fracture.film]")] + FRACTURE + SCENE[SCENE.index("[[support]]") :]
PUMP = f"""
[[well]]
name = "in"
at = {{fracture = "film", end = "start"}}
pressure = {PUMPED}
"""


@pytest.mark.serial
@pytest.mark.parametrize(
    ("rule", "order", "meshes", "bar"), [("backward-euler", 1, (24, 48), 4.2e-3), ("bdf2", 2, (24, 48, 96), 3.6e-4)]
)
def test_profile_of_pressure_and_aperture(film, similarity, rule, order, meshes, bar):
    """p and d after 100 s, error over what is imposed at the well; h and dt halved together."""
    w, flux = similarity(1 + (PUMPED - AT_REST) / (STIFFNESS * APERTURE))
    assert w(0.0) == pytest.approx(1.9)
    errors = []
    for n in meshes:
        x = np.linspace(0, 9 * np.sqrt(DIFFUSIVITY * END), n + 1)
        stage = f'[[stage]]\nkind = "quasi-static"\ntime_step = {END / n!r}\nsteps = {n}\n'
        history, found = film(x, SCENE + PUMP + stage, f"method.film={rule}", "method.coupling=whole-lu")
        exact = w(x / np.sqrt(4 * DIFFUSIVITY * END)) - 1
        pressure = (found["pressure"] - AT_REST) / (STIFFNESS * APERTURE)
        opening = found["opening"] / APERTURE
        errors.append([np.abs(field - exact).max() / 0.9 for field in (pressure, opening)])
        largest = max(np.abs(v).max() for k, v in history.items() if k.startswith("energy/"))
        assert np.abs(history["energy/residual"]).max() <= 1e-10 * largest
    assert max(errors[-1]) <= bar
    assert np.log2(np.divide(errors[:-1], errors[1:])).ravel() == pytest.approx(order, abs=0.25)
    volume = np.sum((found["opening"][1:] + found["opening"][:-1]) / 2 * np.diff(x))
    assert volume == pytest.approx(flux * APERTURE * np.sqrt(DIFFUSIVITY * END), rel=bar)  # of F0 d0 sqrt(D0/t)/2
