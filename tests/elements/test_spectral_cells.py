"""Cells of a higher order come in from outside: rules by dimension and nodes, and an explicit kernel that takes any of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import MPI, PETSc
from fracflow.elements import shape, solid
from fracflow.integrators.explicit import critical_step
from fracflow.solve.leapfrog.rock import AssembledRock, rock_of

pytestmark = pytest.mark.serial
E, RHO = 2.0, 3.0  # of a bar with Poisson's ratio 0
MODULI = np.diag([E, E, 0.5 * E])


def lobatto():
    """Nine nodes at Gauss-Lobatto places, which are those of the quadrature too: masses are diagonal by themselves."""
    at, weight = np.array([-1.0, 0.0, 1.0]), np.array([1.0, 4.0, 1.0]) / 3.0
    slope = np.array([[-1.5, 2.0, -0.5], [-0.5, 0.0, 0.5], [0.5, -2.0, 1.5]])  # [place, function]
    along, across = np.meshgrid(range(3), range(3), indexing="xy")
    i, j = along.ravel(), across.ravel()
    unit = np.eye(3)
    values = unit[i[:, None], i] * unit[j[:, None], j]
    gradients = np.stack(
        [slope[i[:, None], i] * unit[j[:, None], j], unit[i[:, None], i] * slope[j[:, None], j]], axis=-1
    )
    return shape.Rule(weight[i] * weight[j], values, gradients), np.stack([at[i], at[j]], axis=1)


def bar(cells):
    """A row of such cells from 0 to 1: nodes, cells, their stiffness and lumped masses."""
    rule, _ = lobatto()
    h, columns = 1.0 / cells, 2 * cells + 1
    x, y = np.meshgrid(0.5 * h * np.arange(columns), 0.5 * h * np.arange(3), indexing="xy")
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    first = 2 * np.arange(cells)[:, None]
    nodes = np.concatenate([first + columns * row + np.arange(3) for row in range(3)], axis=1)
    count = 2 * len(points)
    matrix, mass = np.zeros((count, count)), np.zeros(len(points))
    numbers = (2 * nodes[:, :, None] + np.arange(2)).reshape(cells, -1)
    for number, block in zip(numbers, solid.stiffness(points[nodes], np.tile(MODULI, (cells, 1, 1))), strict=True):
        matrix[np.ix_(number, number)] += block
    np.add.at(mass, nodes, solid.mass_lumped(points[nodes], np.full(cells, RHO)))
    assert rule.weights.sum() == pytest.approx(4.0)
    return points, nodes, matrix, np.repeat(mass, 2)


def rock(points, nodes, matrix):
    made = PETSc.Mat().createDense(matrix.shape, array=matrix, comm=MPI.COMM_SELF).convert("aij")
    layout = SimpleNamespace(comm=MPI.COMM_SELF, solid_count=len(matrix), solid_vector=made.createVecRight)
    blocks = SimpleNamespace(solid=SimpleNamespace(cells=nodes, points=points))
    return rock_of(SimpleNamespace(layout=layout, blocks=blocks, stiffness=made), SimpleNamespace(), None, plain=True)


def error(cells):
    """Of the lowest P vibration of a free bar after a quarter of its period, where nothing is moved; steps are short."""
    points, nodes, matrix, mass = bar(cells)
    found = rock(points, nodes, matrix)
    assert isinstance(found, AssembledRock)
    speed, largest = np.sqrt(E / RHO), np.linalg.eigvalsh(matrix / np.sqrt(mass[:, None] * mass)).max()
    steps = int(np.ceil(40.0 * (0.5 / speed) / critical_step(largest)))
    dt = 0.5 / speed / steps
    found.hold(np.zeros(len(mass), dtype=bool), mass)
    found.u[0::2] = np.cos(np.pi * points[:, 0])
    start = found.u.copy()
    found.step(0.5 * dt, dt)
    assert found.f == pytest.approx(-matrix @ start, abs=1e-12 * np.abs(matrix).max())
    for _ in range(steps - 1):
        found.step(dt, dt)
    return np.abs(found.u).max()


def test_nine_nodes_by_rules_and_kernel(monkeypatch):
    """The order of quadratic functions, 3, of a vibration that two and four cells have to 4e-3 and 5e-4."""
    for rules in (shape.STIFFNESS_RULES, shape.MASS_RULES):
        monkeypatch.setitem(rules, (2, 9), lobatto()[0])
    coarse, fine = error(2), error(4)
    assert fine < 1e-3 and np.log2(coarse / fine) > 2.8
