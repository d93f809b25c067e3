"""A film whose nodes move alone: rock so soft that only joint and fluid act; meshes with exact coordinates."""

from pathlib import Path

import numpy as np
from grids import edges_of, msh, quads_of

from fracflow._petsc import MPI
from fracflow.output import list_steps, read_history, read_step
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = """
units = "none"
[output]
pictures = false
[mesh]
file = "film.msh"
[rock.wall]
rigid = true
density = 1
[rock.springs]
youngs_modulus = 1e-15
poissons_ratio = 0
density = 1
[fluid]
viscosity = 1
initial_pressure = {pressure}
[initial_stress]
yy = -{pressure}
[fracture.film]
law = "linear"
normal_stiffness = 1
shear_stiffness = 1
aperture = 10
conductance = 1
[[support]]
on = "wall"
components = ["x", "y", "rotation"]
[[support]]
on = "top"
"""
"""k_n = 1, conductance 1, and a load that the fluid carries at first; wells and stages are to be added."""


def mesh(x):
    """Gmsh's format 2.2: cells on either side of the film y = 0 between the given x, its nodes; top and film are named."""
    node = np.arange(3 * len(x)).reshape(3, -1)
    below, above = (quads_of(node[row : row + 2]) for row in (0, 1))
    film, top = (edges_of(nodes) for nodes in node[1:])
    points = np.array([[a, y] for y in (-1.0, 0.0, 1.0) for a in x])
    return msh(points, [("wall", below), ("film", film), ("springs", above), ("top", top)])


def write(folder, comm, x, text):
    """The mesh and the scene of that text in a folder; the scene's path. Collective."""
    if comm.rank == 0:
        (folder / "film.msh").write_text(mesh(x), encoding="utf-8")
        (folder / "scene.toml").write_text(text, encoding="utf-8")
    comm.barrier()
    return folder / "scene.toml"


def ran(folder, x, text, *options):
    """Run a film in a folder of its own: its history, and the fields of its nodes at the end. Collective."""
    comm = MPI.COMM_WORLD
    folder = folder / f"run{len(list(folder.iterdir())) if comm.rank == 0 else 0}"
    folder = Path(comm.bcast(str(folder)))
    if comm.rank == 0:
        folder.mkdir()
    run(load(write(folder, comm, x, text), options), folder / "run", comm)
    found = None
    if comm.rank == 0:
        _, fields, _ = read_step(list_steps(folder / "run", "fractures")[-1][1])
        found = read_history(folder / "run" / "history.h5"), fields
    return comm.bcast(found)
