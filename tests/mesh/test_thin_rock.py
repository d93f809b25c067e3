"""Thin rock at tips: lines where joints do not resolve it, and by how much too stiffly triangles bend."""

from pathlib import Path

import numpy as np
import pytest
from figures_verification.runs import solve
from scipy.spatial import cKDTree

from fracflow.diagnostics import nearest
from fracflow.diagnostics.nearest import nearest_within
from fracflow.diagnostics.thin_rock import FREE, LOCKS, thin_rock_lines
from fracflow.mesh.plane.sizes import ERROR_OF_WEDGE, ROOT
from fracflow.reduction.prepare import read_split
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial

SCENE = """
rock.rock = {youngs_modulus = 50e9, poissons_ratio = 0.25}
initial_stress = {xx = 0, yy = 0, zz = 0, xy = 0}
fluid = {viscosity = 1e-3, initial_pressure = 0}
stage = [{kind = "steady", time_step = 0.5, steps = 2}]
support = [{on = ["south", "east", "west"]}]
[fracture.default]
normal_stiffness = 1e13
shear_stiffness = 1e11
aperture = 1e-3
friction_coefficient = 0.5
pressure = [[0, 0], [1, 1e5]]
"""
LONG = "a", [[-1, -2], [1, -2]]
SIX, TWENTY = (np.tan(np.radians(angle)) for angle in (6, 20))
WEDGE = LONG, ("b", [[0, -2], [0.9, -2 + 0.9 * SIX]])
FLAP = (("a", [[0, 0], [1, -SIX]]),)


def traces(*given, size=0.1, **keys):
    """The table [geometry] of a box under a free side."""
    fractures = ", ".join(f'{{name = "{name}", points = {points}}}' for name, points in given)
    keys = {"size_at_fractures": size, "size_at_tips": size, "snap": 1e-4} | keys
    more = "\n".join(f"{key} = {value}" for key, value in keys.items())
    return f"[geometry]\ndomain = [-10, -10, 10, 0]\nsize = 2\ngrowth = 0.2\n{more}\nfracture = [{fractures}]\n"


def drawn(*given, size=0.1):
    """The same as a .geo of traces inside a box; those after the first begin in its middle."""
    corners = [(-10, -10), (10, -10), (10, 0), (-10, 0)]
    lines = [f"Point({1 + k}) = {{{x}, {y}, 0, 2}};" for k, (x, y) in enumerate(corners)]
    lines += [f"Line({1 + k}) = {{{1 + k}, {1 + (k + 1) % 4}}};" for k in range(4)]
    lines += ['Curve Loop(1) = {1:4}; Plane Surface(1) = {1}; Physical Surface("rock") = {1};']
    (_, (start, end)), (_, (middle, tip)) = given
    for k, (x, y) in enumerate((start, middle, end, tip)):
        lines += [f"Point({10 + k}) = {{{x}, {y}, 0, {size}}};"]
    lines += ["Line(10) = {10, 11}; Line(11) = {11, 12}; Line(12) = {11, 13}; Curve{10:12} In Surface{1};"]
    lines += ['Physical Curve("a") = {10, 11}; Physical Curve("b") = {12};']
    lines += [f'Physical Curve("{side}") = {{{1 + k}}};' for k, side in enumerate(("south", "east", "north", "west"))]
    return "\n".join(lines) + "\n"


def lines_of(folder, geometry, *settings):
    if geometry.startswith("Point"):
        (folder / "mesh.geo").write_text(geometry)
        geometry = '[mesh]\nfile = "mesh.geo"\n'
    (folder / "scene.toml").write_text(SCENE + geometry)
    scene = load(folder / "scene.toml", settings)
    return thin_rock_lines(scene, read_split(scene))


@pytest.mark.parametrize(
    ("geometry", "wanted"),
    [
        (drawn(*WEDGE), ["b and a meet at 6 degrees", "0.0946 m thick", "parted wrongly", "of 0.011 m", "a finer mesh"]),
        (drawn(*WEDGE, size=0.01), None),
        (traces(*WEDGE), None),  # its tip has fine cells
        (drawn(LONG, ("b", [[0, -2], [0.9, -2 + 0.9 * TWENTY]])), None),
        (traces(LONG, ("b", [[-0.4, -1.95], [0.4, -1.95]])), ["b and a run side by side over 0.8 m", "joints of 0.025 m"]),
        (traces(LONG, ("b", [[-0.4, -1.95], [1.4, -1.95]]), size=0.045), None),
        (traces(LONG, ("b", [[-0.4, -1.6], [0.4, -1.6]])), None),
        (traces(*FLAP), ["a and side north meet at 6 degrees", "bends at least 1.6 times too stiffly", "of 0.013 m"]),
        (traces(*FLAP, size=0.01), None),
        (traces(("a", [[-0.5, -0.05], [0.5, -0.05]])), ["side by side over 1 m", "at least 3.7 times", "of 0.006"]),
    ],
)  # fmt: skip
def test_a_line_where_joints_do_not_resolve_the_rock_at_a_tip(tmp_path, geometry, wanted):
    found = lines_of(tmp_path, geometry)
    assert len(found) == (wanted is not None)
    for part in wanted or ():
        assert part in found[0]


def test_joints_as_long_as_the_line_says_serve(tmp_path):
    """Rock 0.0546 m thick needs joints of half of it, 0.0273 m, which are rounded down."""
    beside = LONG, ("b", [[-0.4, -1.9454], [0.4, -1.9454]])
    (told,) = lines_of(tmp_path, traces(*beside))
    size = float(told.split("it needs joints of ")[1].split()[0])
    assert size == 0.027 and not lines_of(tmp_path, traces(*beside, size=size))


def test_rock_beside_a_side_that_is_held_does_not_bend(tmp_path):
    assert not lines_of(tmp_path, traces(*FLAP), "support.0.on=['south','east','west','north']")


def test_fractures_side_by_side_need_joints_as_long_as_their_gap(tmp_path):
    """The volume of one that another covers to five sixths, and of one that it covers all along, which needs two."""
    gap, errors = 0.05, []
    for long, short in (([-1, 0.6], [0.1, 0.7]), ([-1, 1], [-0.4, 0.4])):
        places = ("a", [[long[0], -2], [long[1], -2]]), ("b", [[short[0], gap - 2], [short[1], gap - 2]])
        found = []
        for share in (1 / 8, 1 / 2, 1.0, 1 / 0.6):
            state = solve(SCENE + traces(*places, size=share * gap)).fractures[-1]
            ends = state.points[state.pieces]
            is_short = np.abs(ends[:, 0, 1] + 2 - gap) < 1e-9
            lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            found.append((state.point["opening"][state.pieces].mean(axis=1) * lengths)[is_short].sum())
        errors.append(1 - np.array(found[1:]) / found[0])
    assert 0.03 < errors[0][1] < 0.08 < errors[0][2] < 0.16 and errors[1][0] < 0.2 and errors[1][1:].min() > 0.5
    (line,) = lines_of(tmp_path, traces(*places, size=gap / 1.5))
    assert "a covers all of b" in line and "some tens of" in line and "needs joints of 0.025 m" in line
    assert not lines_of(tmp_path, traces(*places, size=0.025))


@pytest.mark.parametrize("stretch", [1.0, 20.0])
def test_the_nearest_point_within_a_distance_is_that_of_a_tree(monkeypatch, stretch):
    monkeypatch.setattr(nearest, "PAIRS", 1000)
    random = np.random.default_rng(3)
    places, points = (random.random((count, 2)) * (1.0, stretch) for count in (500, 300))
    away, wanted = cKDTree(points).query(places)
    for within in (0.0, 0.05, 30.0):
        assert np.array_equal(nearest_within(places, points, within), np.where(away <= within, wanted, -1))
    assert (nearest_within(places, points[:0], 1.0) == -1).all()
    twice = np.concatenate([points, points])
    assert np.array_equal(nearest_within(places, twice, 30.0), wanted)


def test_triangles_bend_too_stiffly_by_the_square_of_their_size():
    """A sheet of rock over an open fracture, bent by its fluid: volumes with joints of 2, 1/8 and 1/16 of its thickness."""
    thick, volumes = 0.05, []
    for share in (2.0, 1.0 / FREE, 0.5 / FREE):
        sheet = traces(("a", [[-0.5, -thick], [0.5, -thick]]), size=share * thick)
        state = solve(SCENE + sheet).fractures[-1]
        ends = state.points[state.pieces]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        volumes.append(state.point["opening"][state.pieces].mean(axis=1) @ lengths)
    coarse, wanted, fine = volumes
    assert 1.0 < fine / coarse / (1.0 + LOCKS * 2.0**2) < 1.1
    assert fine / wanted < 1.05


def test_openings_beside_a_wedge_err_by_the_joints_at_its_end(monkeypatch):
    """One home for the error by which meshes are made finer there, and others told."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "scripts" / "benches")
    from wedge import errors

    found = errors(6.0, (1.0, ROOT))
    for joints in found:
        assert 0.5 < found[joints][1] / ERROR_OF_WEDGE[joints] < 1.5
