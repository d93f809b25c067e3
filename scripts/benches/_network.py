"""A square kilometre of granite with fractures that cross and branch, meshed by Gmsh: CELLS FILE [FRACTURES SEED]."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

EXTENT = 1024.0  # [m]
SHAPE = 0.37  # area of a mean triangle over the square of the mesh size, as Gmsh makes large meshes

SCENE = """\
title = "Network of fractures, {cells} triangles asked for"
rock.rock = {{youngs_modulus = "50 GPa", poissons_ratio = 0.25, density = "2700 kg/m^3"}}
initial_stress = {{xx = "-20 MPa", yy = "-25 MPa", zz = "-18 MPa"}}
fluid = {{viscosity = "1e-3 Pa s", specific_weight = "9.81 kN/m^3", initial_pressure = "5 MPa", flow_depth = "100 m"}}
support = [{{on = ["west", "east", "south", "north"]}}]
well = [
  {{name = "in", at = {{fracture = "down0", end = "start"}}, flow_rate = "1 L/s"}},
  {{name = "out", at = {{fracture = "across3", end = "end"}}, pressure = "initial"}},
]
stage = [{{kind = "quasi-static", time_step = "60 s", steps = 1}}]
mesh.file = "{mesh}"

[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.5 mm"
friction_coefficient = 0.7
"""


def traces(fractures: int = 20, seed: int = 0) -> dict[str, np.ndarray]:
    """Ends (2, 2) of fractures down and across, which cross, and of branches, each from a point of one of them.

    Of 20 there are 5, 4 and 11. Seed 0 has them at equal distances, others move their ends by up to a seventh of these.
    """
    downs, acrosses = round((1.25 * fractures) ** 0.5), round((0.8 * fractures) ** 0.5)
    beside, above = 900.0 / downs, 840.0 / acrosses
    down = {f"down{i}": [[50 + beside * (i + 0.5), 100], [80 + beside * (i + 0.5), 930]] for i in range(downs)}
    across = {f"across{i}": [[70, 85 + above * (i + 0.5)], [950, 60 + above * (i + 0.5)]] for i in range(acrosses)}
    found = {name: np.array(ends, dtype=float) for name, ends in (down | across).items()}
    branches, random = fractures - len(found), np.random.default_rng(seed)
    half = (branches + 1) // 2
    places = [(f"down{i % downs}", 0.22 + 0.25 * (i % 3)) for i in range(half)]
    places += [(f"across{i % acrosses}", 0.2 + 0.2 * (i % 4)) for i in range(branches - half)]
    if seed:
        for name, ends in found.items():
            ends[:, 0 if name in down else 1] += random.uniform(-1.0, 1.0, 2) * (beside if name in down else above) / 7
        places = [(name, random.uniform(0.15, 0.85)) for name, _ in places]
    for i, (name, along) in enumerate(places):
        start = (1 - along) * found[name][0] + along * found[name][1]
        turn = 0.6 + 0.35 * i
        found[f"branch{i}"] = np.array([start, start + 65 / 180 * beside * np.array([np.cos(turn), np.sin(turn)])])
    return found


def make(cells: int, path: Path, fractures: int = 20, seed: int = 0) -> None:
    """Mesh the network with about so many triangles and write .msh 4.1, binary."""
    import gmsh

    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ, network = gmsh.model.occ, traces(fractures, seed)
    square = occ.addRectangle(0, 0, 0, EXTENT, EXTENT)
    lines = [occ.addLine(*(occ.addPoint(float(x), float(y), 0) for x, y in ends)) for ends in network.values()]
    _, became = occ.fragment([(2, square)], [(1, line) for line in lines])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [tag for dim, tag in became[0] if dim == 2], name="rock")
    for name, children in zip(network, became[1:], strict=True):
        gmsh.model.addPhysicalGroup(1, [tag for _, tag in children], name=name)
    for name, axis, place in (("west", 0, 0), ("east", 0, EXTENT), ("south", 1, 0), ("north", 1, EXTENT)):
        low, high = [-1.0] * 3, [EXTENT + 1.0] * 3
        low[axis], high[axis] = place - 1.0, place + 1.0
        gmsh.model.addPhysicalGroup(
            1, [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*low, *high, 1)], name=name
        )
    size = np.sqrt(EXTENT**2 / cells / SHAPE)
    for end in ("Min", "Max"):
        gmsh.option.setNumber(f"Mesh.MeshSize{end}", size)
    gmsh.option.setNumber("Mesh.Algorithm", 5)
    gmsh.model.mesh.generate(2)
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    part = path.with_name(f"part-{path.name}")
    gmsh.write(str(part))
    gmsh.finalize()
    part.replace(path)


if __name__ == "__main__":
    make(int(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:5]))
