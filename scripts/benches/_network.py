"""A square kilometre of granite with a network of 20 fractures that cross and branch, meshed by Gmsh: CELLS FILE."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

EXTENT = 1024.0  # [m]
SHAPE = 0.37  # area of a mean triangle over the square of the mesh size, as Gmsh makes large meshes

SCENE = """\
title = "Network of 20 fractures, {cells} triangles asked for"
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


def traces() -> dict[str, np.ndarray]:
    """Ends (2, 2) of 5 fractures down and 4 across, which cross, and of 11 branches, each from a point of one of them."""
    down = {f"down{i}": [[140 + 180 * i, 100], [170 + 180 * i, 930]] for i in range(5)}
    across = {f"across{i}": [[70, 190 + 210 * i], [950, 165 + 210 * i]] for i in range(4)}
    found = {name: np.array(ends, dtype=float) for name, ends in (down | across).items()}
    places = [(f"down{i % 5}", 0.22 + 0.25 * (i % 3)) for i in range(6)]
    places += [(f"across{i % 4}", 0.2 + 0.2 * (i % 4)) for i in range(5)]
    for i, (name, along) in enumerate(places):
        start = (1 - along) * found[name][0] + along * found[name][1]
        turn = 0.6 + 0.35 * i
        found[f"branch{i}"] = np.array([start, start + 65 * np.array([np.cos(turn), np.sin(turn)])])
    return found


def make(cells: int, path: Path) -> None:
    """Mesh the network with about so many triangles and write .msh 4.1, binary."""
    import gmsh

    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ, network = gmsh.model.occ, traces()
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
    make(int(sys.argv[1]), Path(sys.argv[2]))
