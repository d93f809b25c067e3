"""Rock that is not meshed, at any place: what the jumps of all fractures make there, in closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracflow.elements import dislocation, facet
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model.stress import initial_components
from fracflow.scene.scene import Scene

BESIDE = 1e-6  # of a joint: how far from a fracture its walls are looked at


def far_stress(scene: Scene, time: float, controls: Mapping[str, float]) -> Floats:
    """Stress (3,), xx, yy, xy, that loads add far away [stress]."""
    total = np.zeros(3)
    for load in scene.load:
        factor = 1.0 if load.control is None else controls[load.control]
        for name, table in (load.stress or {}).items():
            total[("xx", "yy", "xy").index(name)] += factor * table(time)
    return total


def with_far(scene: Scene, far: Floats, points: Floats, moved: Floats) -> Floats:
    """Displacement (n, 2) of points (n, 2) of meshed rock, with that of intact rock under a stress (3,) far away [length]."""
    if not far.any():
        return moved
    (rock,) = scene.rock.values()
    assert rock.poissons_ratio is not None
    xx, yy, xy = far / (2.0 * rock.shear_modulus)
    mean = rock.poissons_ratio * (xx + yy)
    return np.asarray(moved + points @ np.array([[xx - mean, xy], [xy, yy - mean]]))


def walls(mesh: SplitMesh, place: FracturePlace) -> Floats:
    """Points (2, 2) beside a place on a fracture: on its right, and on its left."""
    joint, end = int(place.joints[0]), int(place.ends[0])
    ends = mesh.points[mesh.joint_bottom[joint]]
    inward, normal = (ends[1 - end] - ends[end]), facet.frame(ends[None])[0][0, -1]
    start = place.point + (BESIDE * inward if not place.within else 0.0)
    beside = 0.1 * BESIDE * float(np.linalg.norm(inward)) * normal
    return np.stack([start - beside, start + beside])


@dataclass(frozen=True)
class UnmeshedRock:
    """Values at points (m, 2) of the motion (n, 3, 2) of all walls, as formulas of the home "cell" and "node" take them.

    far     (3,) stress that loads add far away; the displacements that it makes in intact rock are not counted
    """

    scene: Scene
    mesh: SplitMesh
    points: Floats
    motion: Floats
    far: Floats

    @cached_property
    def _ends(self) -> Floats:
        return self.mesh.points[self.mesh.joint_bottom]

    def _jumps(self, part: int) -> Floats:
        moved = self.motion[:, part]
        return np.asarray(moved[self.mesh.joint_top] - moved[self.mesh.joint_bottom])

    @cached_property
    def _moduli(self) -> tuple[float, float]:
        (rock,) = self.scene.rock.values()
        assert rock.youngs_modulus is not None and rock.poissons_ratio is not None
        return rock.youngs_modulus, rock.poissons_ratio

    def moved(self, part: int) -> Floats:
        """Displacement (m, 2), or velocity or acceleration by their number."""
        return dislocation.displacements(self.points, self._ends, self._jumps(part), self._moduli[1])

    @property
    def displacement(self) -> Floats:
        """(m, 2) [length]."""
        return self.moved(0)

    @property
    def velocity(self) -> Floats:
        """(m, 2) [length/time]."""
        return self.moved(1)

    @property
    def acceleration(self) -> Floats:
        """(m, 2) [length/time^2]."""
        return self.moved(2)

    @cached_property
    def _stress_change(self) -> Floats:
        _, nu = self._moduli
        (rock,) = self.scene.rock.values()
        change = dislocation.stresses(self.points, self._ends, self._jumps(0), rock.plane_strain_modulus)
        xx, yy, xy = (change + self.far).T
        return np.stack([xx, yy, nu * (xx + yy), xy], axis=1)

    @property
    def strain(self) -> Floats:
        """Strain (m, 4)."""
        young, nu = self._moduli
        xx, yy, zz, xy = self._stress_change.T
        return np.stack([xx - nu * (yy + zz), yy - nu * (xx + zz), 0.0 * zz, (1.0 + nu) * xy], axis=1) / young

    @property
    def stress(self) -> Floats:
        """Total stress (m, 4)."""
        return np.asarray(self._stress_change + initial_components(self.scene, self.points))

    @property
    def strain_energy(self) -> Floats:
        """Energy (m,) stored since the start per volume."""
        mean = 0.5 * self._stress_change + initial_components(self.scene, self.points)
        return np.asarray((mean * self.strain * np.array([1.0, 1.0, 1.0, 2.0])).sum(axis=1))

    @property
    def kinetic_energy(self) -> Floats:
        """There is no inertia (m,)."""
        return np.zeros(len(self.points))


@dataclass(frozen=True)
class AtPoint:
    """The same at a probe, in the rock or on a fracture: on its top wall, and ``bottom`` on the other."""

    place: FracturePlace | RockPlace
    scene: Scene
    mesh: SplitMesh
    motion: Floats
    far: Floats

    @cached_property
    def _rock(self) -> UnmeshedRock:
        place = self.place
        points = walls(self.mesh, place) if isinstance(place, FracturePlace) else place.point[None]
        return UnmeshedRock(self.scene, self.mesh, points, self.motion, self.far)

    @property
    def bottom(self) -> Floats:
        """(dim,) displacement of the bottom wall [length]."""
        return np.asarray(self._rock.displacement[0])

    def __getattr__(self, name: str) -> Floats:
        """A value of ``UnmeshedRock`` there."""
        return np.asarray(getattr(self._rock, name)[-1])
