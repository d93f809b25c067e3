"""PETSc options of each solver, by prefix. The scene's [petsc] table overrides them, the command line comes last."""

from __future__ import annotations

from collections.abc import Mapping

from fracflow._petsc import PETSc
from fracflow.errors import InputError
from fracflow.solve.rock_cost import SWIFT_FROM, SWIFT_TO, RockChoice

Value = str | float | int | bool

DIRECT: dict[str, Value] = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}

_SPLITS: dict[str, Value] = {
    f"fieldsplit_{part}_{key}": value for part in ("solid", "flow") for key, value in DIRECT.items()
}

NEWTON: dict[str, Value] = {"snes_linesearch_type": "basic"}

OPTIONS: dict[str, dict[str, Value]] = {
    "monolithic": {
        **NEWTON,
        "ksp_type": "fgmres",
        "ksp_rtol": 1e-9,
        "ksp_max_it": 100,
        "ksp_gmres_restart": 100,
        "pc_type": "fieldsplit",
        "pc_fieldsplit_type": "schur",
        "pc_fieldsplit_schur_fact_type": "full",
        "pc_fieldsplit_schur_precondition": "selfp",
        **_SPLITS,
    },
    "whole-lu": NEWTON | DIRECT,
    "solid": NEWTON | DIRECT,
    # The displacements are held: their rows are those of the identity, and need no factorisation.
    "flow": {
        **NEWTON,
        "ksp_type": "preonly",
        "pc_type": "fieldsplit",
        "pc_fieldsplit_type": "additive",
        **_SPLITS,
        "fieldsplit_solid_pc_type": "none",
    },
    # MUMPS took 99 s to order a diagonal of 200 000 rows; a lumped mass is solved for in one iteration.
    "mass": {"ksp_type": "cg", "pc_type": "jacobi", "ksp_rtol": 1e-14, "ksp_max_it": 1000},
    "condensed": {"ksp_type": "preonly", "pc_type": "cholesky"},  # the rock with elastic joints is positive definite
    "period": DIRECT,
    "handed": DIRECT,
    "stability": DIRECT,
    "explicit": {"ksp_type": "preonly", "pc_type": "lu"},  # the pressures of an explicit step
}
"""Prefix -> options. A prefix is written with a trailing underscore: -monolithic_ksp_rtol, -solid_pc_type."""

# Sparse coarse grids: a cycle takes two thirds of the time of BoomerAMG's defaults in PETSc, with as many iterations. The first
# grid is coarsened twice: a quarter of the memory of the grids, 1.5 times the iterations, and the same time.
# Each part is linear, so that GMRES serves, with half the vectors of FGMRES.
# Rows of the flow may be many orders smaller than the rock's, or larger, and FGMRES weighs them by their size. The first guess
# is the preconditioner's. It leaves a residual in rock outside the strips alone, and so do all that follow.
_FRACTURED: dict[str, Value] = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_knoll": True,
    "ksp_rtol": 1e-4,  # of what the first guess leaves: Newton iterations are as many as with 1e-5
    "ksp_max_it": 100,
    "ksp_gmres_restart": 30,
    "pc_type": "shell",  # fracflow/solve/fractured_rock
    "intact_ksp_type": "preonly",
    "intact_pc_type": "hypre",
    "intact_pc_hypre_boomeramg_coarsen_type": "HMIS",
    "intact_pc_hypre_boomeramg_interp_type": "ext+i",
    "intact_pc_hypre_boomeramg_P_max": 4,
    "intact_pc_hypre_boomeramg_agg_nl": 1,
    "intact_pc_hypre_boomeramg_agg_num_paths": 2,
    "intact_pc_hypre_boomeramg_relax_type_all": "SOR/Jacobi",  # two thirds of the time of sweeps to and fro
    **{f"{part}_{key}": value for part in ("jumps", "strips") for key, value in DIRECT.items()},
}
MULTIGRID: dict[str, dict[str, Value]] = {"monolithic": _FRACTURED, "solid": _FRACTURED}
"""Options that take the place of those above in large scenes."""

_UMFPACK: dict[str, Value] = {"pc_factor_mat_solver_type": "umfpack"}
# With 638 jumps UMFPACK takes about 35 ms to factor a dense matrix, MUMPS 19 ms. Its scaling by iterations takes 5 ms of these.
_DENSE: dict[str, Value] = {"pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_8": 1}
_SMALL_PARTS: dict[str, dict[str, Value]] = {
    prefix: {f"{part}_{key}": value for part in ("jumps", "strips") for key, value in _UMFPACK.items()}
    for prefix in MULTIGRID
}


def is_swift(unknowns: int, ranks: int) -> bool:
    """Whether so many displacements are solved for by UMFPACK."""
    fits = ranks == 1 and SWIFT_FROM < unknowns <= SWIFT_TO
    return fits and bool(PETSc.Sys.hasExternalPackage("suitesparse"))


def are_on_one_rank(unknowns: int, ranks: int) -> bool:
    """Whether multigrid's small systems beside so many displacements are each factored by one rank, with UMFPACK."""
    suits = ranks == 1 or (ranks > 1 and unknowns <= SWIFT_TO)
    return suits and bool(PETSc.Sys.hasExternalPackage("suitesparse"))


def factors_are_meant(prefix: str) -> bool:
    """Whether the scene or the command line chooses how the solver of that prefix factors."""
    return any(name.startswith((f"{prefix}_pc_", f"{prefix}_mat_")) for name in _given)


def _unless_given(table: dict[str, Value]) -> dict[str, dict[str, Value]]:
    """Options of the solvers whose factorisation neither the scene nor the command line chooses."""
    return dict.fromkeys((prefix for prefix in ("whole-lu", "solid") if not factors_are_meant(prefix)), table)


def _alone(rock: RockChoice) -> dict[str, dict[str, Value]]:
    """The factorisation of the rock on one rank."""
    if rock.is_dense:
        return _unless_given(_DENSE)
    return _unless_given(_UMFPACK) if is_swift(rock.unknowns, 1) else {}


def solver_of(matrix: PETSc.Mat, prefix: str) -> PETSc.KSP:
    """A linear solver with the options of a prefix. The caller destroys it. Collective."""
    solver = PETSc.KSP().create(comm=matrix.getComm())
    solver.setOperators(matrix)
    solver.setOptionsPrefix(prefix)
    solver.setFromOptions()
    return solver


_ours: set[str] = set()
_given: set[str] = set()


def forget() -> None:
    """Take out what ``set_defaults`` put in: PETSc can report the others that were not used at its end."""
    database = PETSc.Options()
    for key in _ours:
        database.delValue(key)
    _ours.clear()


def is_meant(prefix: str) -> bool:
    """Whether the scene or the command line gives options to the solver of that prefix."""
    return any(name.startswith(f"{prefix}_") for name in _given)


BY_FACTORS, BY_MULTIGRID = RockChoice(), RockChoice(by_multigrid=True)
"""Choices that no cost has led to."""


def set_defaults(given: Mapping[str, Value], rock: RockChoice = BY_FACTORS, ranks: int = 0) -> None:
    """Put the defaults and the scene's own options into PETSc's database; those of the command line stay.

    ``rock`` decides between factorisation and multigrid, and ``ranks`` between factorisations. Options of an earlier call, for
    this scene or another of this process, are removed.
    """
    database = PETSc.Options()
    forget()
    _given.clear()
    _given.update(given, database.getAll())
    tables = [
        OPTIONS,
        *([MULTIGRID] if rock.by_multigrid else []),
        *([_SMALL_PARTS] if rock.by_multigrid and are_on_one_rank(rock.unknowns, ranks) else []),
        *([_alone(rock)] if ranks == 1 else []),
    ]
    merged = {f"{prefix}_{key}": v for table in tables for prefix, own in table.items() for key, v in own.items()}
    for key, value in {**merged, **given}.items():
        if not database.hasName(key):
            database.setValue(key, value)
            _ours.add(key)
    _try_options()


def _try_options() -> None:
    """Raise InputError where PETSc does not know a type or cannot read a number, before anything is written."""
    for prefix in (*OPTIONS, *(f"monolithic_fieldsplit_{part}" for part in ("solid", "flow"))):
        solver = PETSc.SNES().create(comm=PETSc.COMM_SELF)
        solver.setOptionsPrefix(f"{prefix}_")
        try:
            solver.setFromOptions()
            solver.getKSP().setFromOptions()
        except PETSc.Error as error:
            reason = str(error).splitlines()[-1].partition("] ")[2]
            where = f"PETSc option of -{prefix}_, in [petsc] or on the command line"
            raise InputError(f"{where}: {reason}; see PETSc's manual") from None
        finally:
            solver.destroy()
    _try_types()


def _try_types() -> None:
    """Raise InputError for a ``-mat_type`` or ``-vec_type`` that the program's matrices and vectors cannot have."""
    given, alone = PETSc.Options(), PETSc.COMM_WORLD.getSize() == 1
    for option, new, default in (("mat_type", PETSc.Mat, "aij"), ("vec_type", PETSc.Vec, "mpi")):
        name, thing, reason = given.getString(option, default), new().create(comm=PETSc.COMM_SELF), ""
        if option == "mat_type" and not name.removeprefix("seq").removeprefix("mpi").startswith("aij"):
            reason = "the program fills and factors types of the family aij alone, such as aijcusparse or aijkokkos"
        elif name.startswith("seq") and not alone:
            reason = "that type is of one rank"
        try:
            thing.setSizes(1)
            thing.setType(name)
        except PETSc.Error as error:
            reason = reason or str(error).splitlines()[-1].partition("] ")[2]
        finally:
            thing.destroy()
        if reason:
            raise InputError(f"PETSc option -{option} {name}: {reason}; take another, or leave it out")
