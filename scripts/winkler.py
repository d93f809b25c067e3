"""A film whose nodes move alone: rock so soft that only joint and fluid act; meshes with exact coordinates."""

from pathlib import Path

import numpy as np

from fracflow._petsc import MPI
from fracflow.output import list_steps, read_history, read_step
from fracflow.run import run
from fracflow.scene import load

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
    points = np.array([[a, y] for y in (-1.0, 0.0, 1.0) for a in x])
    n, rows = len(x), ("wall", "film", "springs", "top")
    low = np.arange(1, n)
    quads = [
        np.stack([low + row * n, low + 1 + row * n, low + 1 + (row + 1) * n, low + (row + 1) * n], 1) for row in (0, 1)
    ]
    lines = [np.stack([low + row * n, low + 1 + row * n], 1) for row in (1, 2)]
    groups = ((3, 1, quads[0]), (1, 2, lines[0]), (3, 3, quads[1]), (1, 4, lines[1]))
    elements = [(kind, name, nodes) for kind, name, block in groups for nodes in block]
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "4"]
    text += [f'{dim} {number + 1} "{rows[number]}"' for number, dim in enumerate((2, 1, 2, 1))]
    text += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    text += [f"{i + 1} {p[0]!r} {p[1]!r} 0" for i, p in enumerate(points.tolist())]
    text += ["$EndNodes", "$Elements", str(len(elements))]
    text += [
        f"{i + 1} {kind} 2 {name} {name} {' '.join(map(str, nodes))}" for i, (kind, name, nodes) in enumerate(elements)
    ]
    return "\n".join([*text, "$EndElements", ""])


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
