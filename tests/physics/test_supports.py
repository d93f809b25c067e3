"""Affine supports and ties, against states that are known in closed form."""

import numpy as np
import pytest

from fracflow.errors import InputError

from .conftest import JOINT, ROCK

E, NU = 10e9, 0.25
G = E / (2 * (1 + NU))


def test_affine_displacement_of_all_sides_is_affine_inside(run_scene):
    """Patch test through the scene: u = (1e-4 x + 2e-4 y, -1e-4 x + 3e-4 y) t; sigma of plane strain."""
    found = run_scene(
        ROCK
        + """
[geometry]
domain = [[0, 0], [4, 0], [5, 3], [1, 2]]
size = 0.8
[[support]]
on = ["side1", "side2", "side3", "side4"]
displacement_gradient = [[[[0, 0], [2, 2e-4]], [[0, 0], [2, 4e-4]]], [-1e-4, 3e-4]]
displacement = {y = 1e-3}
[[probe]]
name = "inside"
at = [2.5, 1.2]
[[stage]]
kind = "steady"
time_step = 1
steps = 2
"""
    )
    lam = E * NU / ((1 + NU) * (1 - 2 * NU))
    for step, a, b in ((1, 1e-4, 2e-4), (2, 2e-4, 4e-4)):
        exx, eyy, gxy = a, 3e-4, b - 1e-4
        sxx, syy, sxy = lam * (exx + eyy) + 2 * G * exx, lam * (exx + eyy) + 2 * G * eyy, G * gxy
        if step == 2:
            stress = found.fields["rock"]["stress"].reshape(-1, 3, 3)
            assert stress[:, 0, 0] == pytest.approx(sxx, rel=1e-9)
            assert stress[:, 1, 1] == pytest.approx(syy, rel=1e-9)
            assert stress[:, 0, 1] == pytest.approx(sxy, rel=1e-9)
    assert found.closes()


PERIODIC = (
    ROCK
    + JOINT
    + """
[geometry]
domain = [0, 0, 3, 4]
size = 0.6
[[geometry.fracture]]
name = "joint"
points = [[0, 2.2], [3, 2.2]]
[initial_stress]
yy = -1e6
xx = -1e6
[[support]]
on = "south"
[[support]]
on = "north"
displacement = {x = 1e-4, y = 0}
[[tie]]
on = ["west", "east"]
[[probe]]
name = "middle"
at = [1.5, 2.2]
[[probe]]
name = "edge"
at = [0, 2.2]
[[stage]]
kind = "steady"
time_step = 1
steps = 1
"""
)


def test_periodic_row_in_simple_shear(run_scene):
    """Springs in series: tau = u / (h/G + 1/k_s), the same everywhere, though the mesh is irregular."""
    found = run_scene(PERIODIC)
    tau = 1e-4 / (4 / G + 1 / 20e9)
    for probe in ("middle", "edge"):
        assert found.probe(probe, "shear_traction")[-1] == pytest.approx(tau, rel=1e-9)
        assert found.probe(probe, "slip")[-1] == pytest.approx(tau / 20e9, rel=1e-9)
        assert abs(found.probe(probe, "opening")[-1]) < 1e-12
    stress = found.fields["rock"]["stress"].reshape(-1, 3, 3)
    assert stress[:, 0, 1] == pytest.approx(tau, rel=1e-8)


def test_periodic_row_slips_everywhere_alike(run_scene):
    """Past tan(30 deg) sigma_n the traction stays there, and the rest of the displacement is slip."""
    found = run_scene(PERIODIC, "support.1.displacement={x = 1e-3, y = 0}")
    tau = np.tan(np.radians(30)) * 1e6
    assert found.probe("middle", "shear_traction")[-1] == pytest.approx(tau, rel=1e-9)
    for probe in ("middle", "edge"):
        assert found.probe(probe, "slip")[-1] == pytest.approx(1e-3 - tau * 4 / G, rel=1e-8)


def test_platen_shares_a_load_between_two_columns(run_scene):
    """Two columns under one platen, free to slide past each other, nu = 0: equal shortening, stress as E."""
    found = run_scene(
        """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0
[geometry]
domain = [0, 0, 3, 4]
size = 0.7
[[geometry.fracture]]
name = "gap"
points = [[1, 0], [1, 4]]
[fracture.gap]
law = "linear"
normal_stiffness = 1e9
shear_stiffness = 1e-3
[[support]]
on = "south"
components = ["y"]
[[support]]
on = "west"
components = ["x"]
[[support]]
on = "east"
components = ["x"]
[[tie]]
on = "north"
components = ["y"]
[[load]]
on = "north"
pressure = [[0, 0], [1, 3e6]]
[[probe]]
name = "left"
at = [0.5, 4]
[[probe]]
name = "right"
at = [2.5, 4]
[[stage]]
kind = "steady"
time_step = 1
steps = 1
"""
    )
    for probe in ("left", "right"):
        assert found.probe(probe, "displacement")[-1][1] == pytest.approx(-3e6 / 10e9 * 4, rel=1e-9)


def test_sides_that_do_not_face_each_other_are_refused(run_scene):
    with pytest.raises(InputError, match='"west" and "north" do not face each other'):
        run_scene(PERIODIC, 'tie=[{on = ["west", "north"]}]')


def test_a_force_on_a_rock_is_shared_by_its_area(run_scene):
    """A free rock, cut over the ranks: every point accelerates by F / (rho A), without a wave."""
    scene = (
        ROCK
        + """
[geometry]
domain = [0, 0, 6, 4]
size = 0.8
[[load]]
on = "rock"
force = [3e4, -6e4]
[[probe]]
name = "corner"
at = [6, 4]
[[stage]]
kind = "dynamic"
time_step = 1e-3
steps = 3
"""
    )
    found = run_scene(scene)
    expected = np.array([3e4, -6e4]) / (2500 * 24)
    assert found.probe("corner", "acceleration")[1:] == pytest.approx(np.tile(expected, (3, 1)), rel=1e-9)
    assert found.closes()
