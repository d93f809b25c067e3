"""A probe in the rock measures at the place asked for, wherever the nodes are."""

import numpy as np
import pytest

from .conftest import ROCK

PLACES = {"a": (1.13, 0.37), "b": (2.71, 0.52), "c": (3.9, 0.98), "side": (2.2, 0.0)}
SCENE = (
    ROCK
    + """
[geometry]
domain = [0, 0, 4, 1]
size = 0.5
"""
    + "".join(f'[[probe]]\nname = "{name}"\nat = [{x}, {y}]\n' for name, (x, y) in PLACES.items())
    + """
[[probe]]
name = "corner"
at = [4, 1]
[[stage]]
kind = "dynamic"
time_step = 1e-4
steps = 10
"""
)
GRADIENT = np.array([[1e-4, 3e-5], [-2e-5, 5e-5]])


@pytest.mark.parametrize("cells", ["triangles", "quads"])
def test_a_straining_is_exact_at_any_place(run_scene, cells):
    """Of what is linear in x and y nothing is lost."""
    given = (
        f"{{displacement_gradient = {GRADIENT.tolist()}, velocity = [1, 2], velocity_gradient = {GRADIENT.tolist()}}}"
    )
    found = run_scene(SCENE, f"geometry.cells={cells}", f"initial={given}")
    strain = 0.5 * (GRADIENT + GRADIENT.T)
    for name, place in PLACES.items():
        moved = GRADIENT @ np.array(place)
        assert found.probe(name, "displacement")[0] == pytest.approx(moved, rel=1e-12)
        assert found.probe(name, "velocity")[0] == pytest.approx(np.array([1, 2]) + moved, rel=1e-12)
        assert found.probe(name, "strain")[0][[0, 1, 3]] == pytest.approx(strain[[0, 1, 0], [0, 1, 1]], rel=1e-9)


def test_a_probe_lies_between_the_corners_of_its_cell(run_scene):
    """After some steps: the interpolation of the fields, at a corner the node's own value."""
    found = run_scene(SCENE, "initial={displacement_gradient = [[1e-4, 0], [0, 0]]}")
    moved = found.fields["rock"]["displacement"][:, :2]
    last = found.probe("corner", "displacement")[-1]
    assert np.abs(moved - last).max(axis=1).min() == 0.0  # one of the nodes has just this
    assert np.ptp(moved[:, 0]) > 1e-5
    for name in PLACES:
        at = found.probe(name, "displacement")[-1]
        assert (moved.min(axis=0) < at).all() and (at < moved.max(axis=0)).all()
        assert np.abs(moved - at).max(axis=1).min() > 1e-9  # none of the nodes has
