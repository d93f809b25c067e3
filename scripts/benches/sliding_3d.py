"""A stiffness in three dimensions with sliding planes, for solvers: sliding_3d.py [UNKNOWNS] [--cells KIND] [--out DIR].

A block of hexahedra or tetrahedra is cut by three planes: one through it that dips, one that ends inside and crosses the first,
one that ends on the first. Their joints slide: stiff across, weak or nothing along the slip, and an opening takes
mu k_n off the shear traction, so that the matrix is not symmetric. Outer sides are held.

Written are PETSc's binary files: matrix.petsc (block size 3), then right.petsc (1 MPa in the planes), places.petsc
(coordinates of the nodes) and motions.petsc (the six rigid motions, one after the other), and facts.json. The system is solved
as the program solves large scenes ("multigrid"), as it solves small ones ("lu"), or not at all. CPU seconds are of all ranks.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from _boxes import box

from fracflow._petsc import MPI, PETSc
from fracflow.elements import facet, joint
from fracflow.laws.elastic import solid_stiffness
from fracflow.mesh.blocks import Blocks, petsc_ints
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.distribute import distribute
from fracflow.mesh.split import split, summary
from fracflow.model.joints import jump_matrix, section_groups
from fracflow.model.layout import add_blocks, create_matrix, layout_of
from fracflow.model.solid import nodal_layout, node_unknowns, stiffness_of
from fracflow.solve.fractured_rock import FracturedRock, parts_of
from fracflow.solve.options import BY_FACTORS, BY_MULTIGRID, set_defaults

SIZE, MODULUS, RATIO, PRESSURE = 10.0, 5e10, 0.25, 1e6
FRICTION, SLIP = 0.6, (0.8, 0.6)  # which way the planes slide: along strike, up the dip
LEAN = 0.3  # of the planes x = const: a shift of x with z
SOLVERS = {"lu": "direct", "multigrid": "multigrid"}
"""Ways to solve -> ``method.rock_solver``."""


@contextmanager
def timed(facts: dict[str, Any], name: str) -> Iterator[None]:
    """Add the CPU seconds of all ranks to the facts. Collective."""
    start = time.process_time()
    yield
    facts[name] = round(MPI.COMM_WORLD.allreduce(time.process_time() - start), 2)


def mesh_of(count: int, tetrahedra: bool) -> Any:
    """The split mesh of ``count`` cells along each side, and its facts."""
    middle = count // 2
    raw = box(
        (count,) * 3,
        [
            (0, middle, lambda x: np.ones(len(x), dtype=bool)),
            (2, middle, lambda x: (np.abs(x - count / 2)[:, :2] < 0.35 * count).all(axis=1)),
            (1, middle, lambda x: x[:, 0] > middle),
        ],
        tetrahedra,
    )
    raw.points[:, 0] += LEAN * raw.points[:, 2]
    raw.points[:] *= SIZE
    return split(raw)


def moduli(sections: int, normal: float, shear: float) -> Floats:
    """Tangent moduli (s, 3, 3) of sections that slide, strike, dip and normal [stress/length]."""
    result = np.zeros((sections, 3, 3))
    result[:, [0, 1], [0, 1]] = shear
    result[:, 2, 2] = normal
    result[:, :2, 2] = -FRICTION * normal * np.array(SLIP)
    return result


class System(NamedTuple):
    """Matrix and right side, the unknowns ``held`` of the outer sides, and the number of sections of all ranks."""

    blocks: Blocks
    matrix: PETSc.Mat
    right: PETSc.Vec
    held: Ints
    sections: int


def assemble(blocks: Blocks, count: int, normal: float, shear: float) -> System:
    """The system with ``count`` cells along each side of the block. Collective."""
    block = blocks.solid
    cells = np.arange(len(block.cells))
    matrix = stiffness_of(blocks, cells, np.repeat(solid_stiffness(MODULUS, RATIO), len(cells), axis=0))
    corners = block.points[blocks.joints.bottom]
    sections = facet.RULES["nodal"][corners.shape[1]]
    sizes = facet.section_sizes(corners, sections).ravel()
    jump = jump_matrix(blocks, sections.natural, None)
    tangents = moduli(len(sizes), normal, shear)
    planes = create_matrix((nodal_layout(blocks), nodal_layout(blocks)), 30, blocks.comm)
    for group in section_groups(jump, 3):
        chosen = group.sections
        values = joint.tangent(group.jump[:, None], tangents[chosen, None], sizes[chosen, None])
        add_blocks(planes, group.unknowns, group.unknowns, values)
    planes.assemble()
    matrix.axpy(1.0, planes, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    planes.destroy()
    push, right = jump.createVecLeft(), PETSc.Vec().createMPI(nodal_layout(blocks), comm=blocks.comm)
    push.setArray((sizes[:, None] * np.array([0.0, 0.0, PRESSURE])).ravel())
    jump.multTranspose(push, right)
    own = block.points[: block.owned].copy()
    own[:, 0] -= LEAN * own[:, 2]
    held = np.flatnonzero((np.abs(own / (0.5 * SIZE * count) - 1.0) > 1.0 - 1e-9).any(axis=1))
    rows = petsc_ints(node_unknowns(blocks, held).ravel())
    matrix.zeroRowsColumns(rows, MODULUS * SIZE, right.duplicate(), right)
    push.destroy()
    jump.destroy()
    return System(blocks, matrix, right, rows, blocks.comm.allreduce(len(sizes)))


def describe(blocks: Blocks, matrix: PETSc.Mat) -> PETSc.Vec:
    """Tell the matrix that three unknowns belong to a node and which motions are rigid; gives the places. Collective."""
    places = PETSc.Vec().createMPI(nodal_layout(blocks), bsize=3, comm=blocks.comm)
    places.setArray(blocks.solid.points[: blocks.solid.owned].ravel())
    matrix.setBlockSize(3)
    space = PETSc.NullSpace().createRigidBody(places)
    matrix.setNearNullSpace(space)
    space.destroy()
    return places


def write(folder: Path, matrix: PETSc.Mat, right: PETSc.Vec, places: PETSc.Vec) -> None:
    """Write all that a solver asks for. Collective."""
    comm = matrix.getComm()
    for name, things in (
        ("matrix", [matrix]), ("right", [right]), ("places", [places]), ("motions", matrix.getNearNullSpace().getVecs()),
    ):  # fmt: skip
        viewer = PETSc.Viewer().createBinary(str(folder / f"{name}.petsc"), "w", comm=comm)
        for each in things:
            each.view(viewer)
        viewer.destroy()


def solve(system: System, rock_solver: str) -> tuple[PETSc.Vec, dict[str, Any]]:
    """Solve, to 1e-9, as the program solves the displacements of a dry scene. Collective."""
    blocks, matrix, right, held, _ = system
    set_defaults({}, BY_MULTIGRID if rock_solver == "multigrid" else BY_FACTORS)
    solver = PETSc.KSP().create(comm=matrix.getComm())
    solver.setOptionsPrefix("solid_")
    solver.setFromOptions()
    solver.setOperators(matrix)
    solver.setTolerances(rtol=1e-9)
    result, left, facts = right.duplicate(), right.duplicate(), {}
    with timed(facts, "set_up_cpu_s"):
        if solver.getPC().getType() == "shell":
            parts = parts_of(blocks, layout_of(blocks, with_flow=False), SIZE, held)
            facts["parts"] = {"jumps": parts.jumps.getSize()[1], "strips": parts.strips.getSize()}
            filled = SimpleNamespace(matrix=matrix, standing=lambda: nullcontext(matrix), stood=None, alphas=None)
            solver.getPC().setType("python")
            solver.getPC().setPythonContext(FracturedRock(parts, filled, "solid", 3))
        solver.setUp()
    with timed(facts, "solve_cpu_s"):
        solver.solve(right, result)
    matrix.mult(result, left)
    left.aypx(-1.0, right)
    facts["krylov"], facts["reason"] = solver.getIterationNumber(), int(solver.getConvergedReason())
    facts["true_residual"] = left.norm() / right.norm()
    solver.destroy()
    left.destroy()
    return result, facts


def count_of(unknowns: int) -> int:
    """Cells along a side, an even number, for about so many unknowns."""
    return max(2 * round(0.5 * ((unknowns / 3) ** (1 / 3) - 1.0)), 4)


def main() -> int:
    """Assemble, write and solve; 1 where a solver did not converge."""
    parser = argparse.ArgumentParser(prog="scripts/bench sliding_3d", description=__doc__.splitlines()[0])
    parser.add_argument("unknowns", nargs="?", type=int, default=100_000)
    parser.add_argument("--cells", choices=("hexahedra", "tetrahedra"), default="hexahedra")
    parser.add_argument("--normal", type=float, default=1e11, help="normal stiffness of the planes [Pa/m]")
    parser.add_argument("--shear", type=float, default=1e6, help="what is left of the shear stiffness [Pa/m]")
    parser.add_argument("--solve", nargs="*", choices=SOLVERS, default=["multigrid"])
    parser.add_argument("--out", type=Path, default=Path("runs/bench/sliding_3d"))
    given = parser.parse_args()
    comm = MPI.COMM_WORLD
    facts: dict[str, Any] = {"command": shlex.join(["scripts/bench", "sliding_3d", *sys.argv[1:]]), "ranks": comm.size}
    count = count_of(given.unknowns)
    with timed(facts, "mesh_cpu_s"):
        mesh = mesh_of(count, given.cells == "tetrahedra") if comm.rank == 0 else None
        blocks = distribute(mesh, comm)
    if mesh is not None:
        facts |= {key: value for key, value in summary(mesh).items() if key != "lengths"}
    with timed(facts, "assembly_cpu_s"):
        system = assemble(blocks, count, given.normal, given.shear)
        matrix, facts["sections"] = system.matrix, system.sections
        places = describe(blocks, matrix)
    facts["unknowns"], facts["entries"] = (
        matrix.getSize()[0],
        int(matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]),
    )
    given.out.mkdir(parents=True, exist_ok=True)
    write(given.out, matrix, system.right, places)
    for name in given.solve:
        result, facts[name] = solve(system, SOLVERS[name])
        facts[name]["largest"] = float(result.norm(PETSc.NormType.INFINITY))
        result.destroy()
    if comm.rank == 0:
        text = json.dumps(facts, indent=1)
        (given.out / "facts.json").write_text(text, encoding="utf-8")
        print(text)
    return int(any(facts[name]["reason"] <= 0 for name in given.solve))


if __name__ == "__main__":
    sys.exit(main())
