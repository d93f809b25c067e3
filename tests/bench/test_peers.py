"""`scripts/bench peers` without OpenGeoSys: its problems by fracflow, the other program's files, ratios at equal error."""

import sys
import xml.etree.ElementTree as ElementTree

import meshio
import numpy as np
import peers
import pytest
from _peers_cases import h1, h2, h3, similarity
from _peers_run import Failed, measured, prepare_fracflow, prepare_ogs, read_fracflow, read_ogs

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("problem", "options", "bars"),
    [
        (h1(20, "graded"), {}, {"slip": 0.03}),
        (h2(50, 16, "graded"), peers.FILM | {"coupling": "whole-lu"}, {"pressure": 5e-3, "aperture": 5e-3}),
        (h3(8), {}, {"slip": 1e-8}),
    ],
    ids=["h1", "h2", "h3"],
)
def test_fracflow_against_the_exact_solutions(tmp_path, problem, options, bars):
    cost = measured(prepare_fracflow(problem, options, tmp_path), tmp_path)
    assert cost.seconds > 0.0 and cost.memory > 10.0
    errors = problem.errors(read_fracflow(tmp_path))
    assert all(1e-12 < errors[name] <= bar for name, bar in bars.items()), errors


def test_similarity_solution_holds_its_equation():
    w, xi, step = similarity(1.9), np.linspace(0.1, 3.0, 30), 1e-3
    cubed = (w(xi + step) ** 4 - 2 * w(xi) ** 4 + w(xi - step) ** 4) / (4 * step**2)  # (w^3 w')'
    slope = (w(xi + step) - w(xi - step)) / (2 * step)
    assert w(0.0) == pytest.approx(1.9) and w(7.0) == pytest.approx(1.0, abs=1e-9)
    assert cubed == pytest.approx(-2 * xi * slope, abs=1e-4)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("problem", [h1(8, "graded"), h2(10, 4, "graded"), h3(4)], ids=["h1", "h2", "h3"])
def test_files_for_the_other_program_and_what_is_read_of_it(tmp_path, problem, order):
    command = prepare_ogs(problem, {"order": order}, tmp_path, tmp_path / "ogs")
    project = ElementTree.parse(tmp_path / command[-1]).getroot()
    named = {mesh.text for mesh in project.find("meshes")}
    used = {mesh.text for mesh in project.iter("mesh")} - named
    assert used == {name.removesuffix(".vtu") for name in named} - {"domain"}
    domain = meshio.read(tmp_path / "domain.vtu")
    for name in named:
        part = meshio.read(tmp_path / name)
        if "bulk_node_ids" in part.point_data:
            assert np.array_equal(domain.points[part.point_data["bulk_node_ids"]], part.points)
    solid, crack = domain.cells
    assert solid.data.shape[1] == {1: 4, 2: 8}[order] and crack.data.shape == (len(problem.made.fracture), order + 1)
    # an answer whose jump is linear along the fracture, written as the program would
    start, end = domain.points[crack.data[0, 0]], domain.points[crack.data[-1, 1]]
    tangent = (end - start) / np.linalg.norm(end - start)
    domain.point_data = {"displacement_jump1": ((domain.points - start) @ tangent)[:, None] * -tangent}
    meshio.write(tmp_path / "run" / "end_1.vtu", domain)
    found = read_ogs(tmp_path, 1)
    assert found.slip == pytest.approx(found.along) and np.abs(found.opening).max() < 1e-12
    assert found.along.max() == pytest.approx(np.linalg.norm(end - start))


def test_ratios_are_taken_at_equal_errors():
    points = [(0.1, 1.0), (0.001, 100.0)]
    assert peers.at_error(points, 0.01) == pytest.approx(10.0)
    beaten = [(0.04, 0.9), (0.012, 1.0), (0.03, 3.0)]  # the last is worse and dearer, and says nothing
    assert 0.9 < peers.at_error(beaten, 0.016) <= 1.0
    assert peers.at_error(points, 0.2) is None and peers.at_error(points[:1], 0.1) is None

    def rows(times):
        return [
            dict(case="h1", program=program, choice="a", nodes=9, slip=error, cpu_s=factor * seconds, failure="")
            for program, factor in (("fracflow", 1.0), ("OpenGeoSys", times))
            for error, seconds in points
        ]  # fmt: skip

    assert [check.ok for check in peers.checks_of(rows(6.0))] == [True, True]  # at 6 and at 600 s
    assert [check.ok for check in peers.checks_of(rows(1.5))] == [True, False]  # at 1.5 and at 150 s
    assert [check.ok for check in peers.checks_of(rows(0.5))] == [False]  # 50 s; half a second is not asked about
    assert [check.ok for check in peers.checks_of(rows(6.0)[1:])] == [False, False]  # errors that are not reached
    assert [check.ok for check in peers.checks_of(rows(6.0)[:2])] == [False]  # a peer that is not there is not shown


def test_a_program_that_fails_says_what_it_printed(tmp_path):
    with pytest.raises(Failed, match=r"exit code 3: .*out of luck"):
        measured([sys.executable, "-c", "print('out of luck'); raise SystemExit(3)"], tmp_path)
