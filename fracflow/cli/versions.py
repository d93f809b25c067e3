"""The versions that a report of a fault names: fracflow, PETSc and MPI, and the packages around them."""

from __future__ import annotations

import platform
import re
from importlib import import_module

from fracflow._version import __version__
from fracflow.errors import InputError

SOLVERS = ("mumps", "hypre", "superlu_dist", "ptscotch", "parmetis", "hdf5")  # packages of PETSc that runs may use
PACKAGES = ("numpy", "scipy", "h5py", "gmsh", "meshio", "pydantic", "pint", "typer", "matplotlib")


def versions() -> list[str]:
    """A line for fracflow, Python, PETSc, MPI and the other packages; none on ranks but the first. Collective."""
    lines, rank = [f"fracflow {__version__}", f"Python {platform.python_version()} on {platform.platform()}"], 0
    try:
        from fracflow._petsc import MPI, PETSc, petsc4py

        rank = MPI.COMM_WORLD.rank
        held = [name for name in SOLVERS if PETSc.Sys.hasExternalPackage(name)]
        numbers = "complex" if PETSc.ScalarType().dtype.kind == "c" else "real"
        kind = f"{numbers}, {8 * PETSc.IntType().itemsize}-bit indices; {', '.join(held) or 'no other packages'}"
        petsc = ".".join(map(str, PETSc.Sys.getVersion()))
        library = re.split(r"[,\n\0]", MPI.Get_library_version())[0]
        lines.append(f"PETSc {petsc} ({kind}), petsc4py {petsc4py.__version__}")
        lines.append(f"{library}, {_version('mpi4py')}, ranks: {MPI.COMM_WORLD.size}")
    except InputError as error:
        lines.append(str(error))
    return [*lines, ", ".join(map(_version, PACKAGES))] if rank == 0 else []


def _version(name: str) -> str:
    try:
        found = import_module(name)
    except Exception as error:  # gmsh raises OSError where a library of the system is missing
        return f"{name} does not import ({' '.join(str(error).split())})"
    return f"{name} {getattr(found, '__version__', 'of unknown version')}"
