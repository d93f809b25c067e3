"""The mesh that rock without one gets once an event needs inertia: its sides, its sizes, and the model of it.

An unbounded domain has a box around its fractures with absorbing sides. Stresses of an event that are a distance r from a
fracture of half length a are (a/r)^2 of their change there: with the usual margin 4 % at the nearest side, if it is one
fracture. A domain whose sides the plan has left out has these sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.around import mesh_around
from fracflow.mesh.data import Ints, SplitMesh
from fracflow.mesh.read import side_names
from fracflow.model.setup import Model, geometry_of, naming, on_root, place, set_up
from fracflow.scene.method import Points
from fracflow.scene.scene import Scene
from fracflow.scene.terms import Absorbing

MARGIN = 2.0  # of the larger extent of all fractures: rock between them and the sides
PER_EXTENT = 8.0  # cells far away, over that extent: ten in a wave of the corner frequency of slip along all of it
FINE = 1e-9  # of a size: round-off


def event_scene(scene: Scene) -> Scene:
    """The unbounded scene with the box, the sides and the sizes of the mesh of its events."""
    assert scene.geometry is not None
    geometry = scene.geometry
    points = np.array([point for trace in geometry.fracture for point in trace.points])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    margin = MARGIN * extent if geometry.event_margin is None else geometry.event_margin
    (left, bottom), (right, top) = (low - margin).tolist(), (high + margin).tolist()
    corners: Points = ((left, bottom), (right, bottom), (right, top), (left, top))
    fine = geometry.size_at_fractures or geometry.size or extent
    size = geometry.size or max(extent / PER_EXTENT, fine)
    keys = {"domain": corners, "size": size / 2**geometry.refine, "refine": 0}
    sides = Absorbing(on=tuple(side_names(np.array(corners))))
    return scene.model_copy(update={"geometry": geometry.model_copy(update=keys), "absorbing": (sides,)})


def with_event_mesh(
    model: Model, comm: MPI.Comm, saved: SplitMesh | None = None, cell_rank: Ints | None = None
) -> Model:
    """The model of the same scene on the mesh of its events. Raises InputError, on every rank. Collective.

    saved, cell_rank  mesh and partition (cells,) of an earlier run, on rank 0
    """
    scene = event_scene(model.scene)

    def work() -> SplitMesh:
        assert model.mesh is not None
        return saved or mesh_around(geometry_of(scene), model.mesh)

    with naming(scene):
        mesh = on_root(comm, work)
        placed = comm.bcast(on_root(comm, lambda: place(scene, mesh) if mesh is not None else None), root=0)
        assert placed is not None
        found = set_up(scene, comm, mesh, replace(placed, notes=()), cell_rank)
    return replace(found, stated=model.stated, sides=model.sides, bounded=model.bounded, unmeshed=model)
