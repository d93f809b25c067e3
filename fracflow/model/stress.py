"""Strain, stress and energy of the rock, cell by cell; plain NumPy on the cells that a rank has.

Four components are xx, yy, zz, xy; xy of a strain is half the engineering shear, so that both turn alike.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fracflow.elements import solid
from fracflow.laws.elastic import out_of_plane_stress, plane_strain_stiffness
from fracflow.mesh.blocks import SolidBlock
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.model.properties import initial_stress
from fracflow.model.solid import by_shape
from fracflow.scene.scene import Scene


def deforms(mesh: SplitMesh | SolidBlock, scene: Scene) -> NDArray[np.bool_]:
    """Which cells (m,) are of rock that is not rigid."""
    return ~np.array([scene.rock[name].rigid for name in mesh.rocks], dtype=bool)[mesh.cell_rock]


def per_cell(cells: Ints, kernel: Callable[[Ints, Ints], Floats], *shape: int) -> Floats:
    """Values (m, *shape) of cells (m, k); ``kernel`` gives them for numbers (n,) and nodes (n, w) of one shape."""
    result = np.zeros((len(cells), *shape))
    for chosen, nodes in by_shape(cells):
        result[chosen] = kernel(chosen, nodes)
    return result


def strain(points: Floats, cells: Ints, displacement: Floats) -> Floats:
    """Strains (m, 4) at the centres of cells (m, k), -1 pads, from displacements (n, 2) of the points (n, 2)."""
    engineering = per_cell(cells, lambda _, nodes: solid.strain_at_centroid(points[nodes], displacement[nodes]), 3)
    return np.stack([engineering[:, 0], engineering[:, 1], np.zeros(len(cells)), 0.5 * engineering[:, 2]], axis=1)


def stress_change(strains: Floats, youngs_modulus: Floats, poissons_ratio: Floats) -> Floats:
    """(2.13) Stress (m, 4) that strains (m, 4) add to the initial stress [stress]; zz keeps the strain plane."""
    voigt = strains[:, [0, 1, 3]] * np.array([1.0, 1.0, 2.0])
    plane = solid.stress(voigt, plane_strain_stiffness(youngs_modulus, poissons_ratio))
    return np.stack([plane[:, 0], plane[:, 1], out_of_plane_stress(plane, poissons_ratio), plane[:, 2]], axis=1)


def initial_components(scene: Scene, points: Floats) -> Floats:
    """sigma_0 (..., 4) at points (..., 2) [stress]."""
    sigma = initial_stress(scene, points)
    return np.stack([sigma[..., 0, 0], sigma[..., 1, 1], sigma[..., 2, 2], sigma[..., 0, 1]], axis=-1)


def tensors(values: Floats) -> Floats:
    """Four components (m, 4) as tensors (m, 3, 3)."""
    result = np.zeros((len(values), 3, 3))
    for part, (row, column) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1))):
        result[:, row, column] = result[:, column, row] = values[:, part]
    return result


def properties(mesh: SplitMesh | SolidBlock, scene: Scene, key: str, cells: Ints | slice = slice(None)) -> Floats:
    """A property (n,) of the rock in cells; 0 where the scene leaves it out."""
    return np.array([getattr(scene.rock[name], key) or 0.0 for name in mesh.rocks])[mesh.cell_rock[cells]]


def elastic_moduli(mesh: SplitMesh | SolidBlock, scene: Scene, cells: Ints) -> tuple[Floats, Floats]:
    """Young's modulus [stress] and Poisson's ratio of the rock in cells (m,)."""
    return properties(mesh, scene, "youngs_modulus", cells), properties(mesh, scene, "poissons_ratio", cells)


def centres(points: Floats, cells: Ints) -> Floats:
    """Centres (m, 2) of cells (m, k), -1 pads, of points (n, 2)."""
    return per_cell(cells, lambda _, nodes: points[nodes].mean(axis=1), 2)


def strain_energy_density(
    scene: Scene, points: Floats, cells: Ints, displacement: Floats, moduli: tuple[Floats, Floats]
) -> Floats:
    """Energy (m,) that each cell stored since the initial state, the work against the initial stress with it [energy/volume].

    Its integral is the entry ``rock_strain``. Under a stress that changes with depth the imbalance taken up at the start, in
    the rock beside fractures, is excepted. Arguments as of ``strain``, with Young's moduli and Poisson's ratios (m,).
    """
    young, poisson = moduli

    def kernel(chosen: Ints, nodes: Ints) -> Floats:
        initial = initial_components(scene, solid.stiffness_points(points[nodes]))[..., [0, 1, 3]]
        stiffness = plane_strain_stiffness(young[chosen], poisson[chosen])
        return solid.strain_energy(points[nodes], displacement[nodes], stiffness, initial) / solid.area(points[nodes])

    return per_cell(cells, kernel)


def kinetic_energy_density(scene: Scene, points: Floats, cells: Ints, velocity: Floats, density: Floats) -> Floats:
    """Kinetic energy (m,) of the mass that the run has, spread over the cells it comes from [energy/volume].

    Arguments as of ``strain``, with densities (m,).
    """
    lumped = scene.method.mass == "lumped"

    def kernel(chosen: Ints, nodes: Ints) -> Floats:
        return solid.kinetic_energy(points[nodes], velocity[nodes], density[chosen], lumped) / solid.area(points[nodes])

    return per_cell(cells, kernel)
