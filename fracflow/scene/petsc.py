"""PETSc options that a scene may give: methods, tolerances and limits, as plain values.

PETSc's options do more than choose solvers: some run Python files or load libraries, and any viewer or monitor may
write to a file. A scene comes from anybody, and so does its copy in a run folder: it gives what is listed here. The
command line, which only the user writes, gives any option.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from fracflow.scene.messages import nearest

Value = str | float | int | bool

SOLVERS = (
    "monolithic", "whole-lu", "solid", "flow", "mass", "condensed", "period", "stability", "explicit",
)  # fmt: skip
"""Prefixes of the program's solvers; each has one, so that an option without one reaches none."""
_SOLVER = re.compile(f"(?:{'|'.join(SOLVERS)})_")
_INNER = re.compile(
    r"fieldsplit_(?:solid|flow|\d{1,2})_|mg_(?:coarse|levels|fine)_(?:\d{1,2}_)?|(?:sub|redundant|ksp|esteig|inner|upper)_"
)
_NUMBER = r"[-+]?(?:\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})(?:[eE][-+]?\d{1,3})?"
_NUMBERS = re.compile(rf"{_NUMBER}(?:,{_NUMBER}){{0,19}}")
LARGEST = 10_000_000  # whole number, such as a count of iterations

_KRYLOV = (
    "preonly none richardson chebyshev cg groppcg pipecg cgne fcg gmres fgmres lgmres dgmres pgmres pipefgmres bcgs ibcgs fbcgs"
    " fbcgsr bcgsl qmrcgs cgs tfqmr tcqmr bicg cr gcr pipegcr minres symmlq lsqr"
)
_PRECONDITIONERS = (
    "none jacobi pbjacobi vpbjacobi bjacobi sor eisenstat ilu icc asm gasm ksp redundant lu cholesky qr svd gamg mg hypre ml"
    " fieldsplit lsc"
)
_SWITCHES = (
    "ksp_initial_guess_nonzero ksp_knoll ksp_reuse_preconditioner ksp_converged_maxits ksp_diagonal_scale"
    " ksp_diagonal_scale_fix ksp_lag_norm ksp_converged_use_initial_residual_norm ksp_gmres_modifiedgramschmidt"
    " ksp_gmres_classicalgramschmidt ksp_gmres_preallocate ksp_richardson_self_scale ksp_cg_single_reduction ksp_bcgsl_cxpoly"
    " ksp_lgmres_constant pc_use_amat pc_factor_reuse_ordering pc_factor_reuse_fill pc_factor_diagonal_fill"
    " pc_factor_in_place pc_factor_pivot_in_blocks pc_jacobi_abs pc_jacobi_fixdiagonal pc_sor_symmetric pc_sor_backward"
    " pc_sor_forward pc_sor_local_symmetric pc_sor_local_backward pc_sor_local_forward pc_fieldsplit_detect_saddle_point"
    " pc_fieldsplit_off_diag_use_amat pc_fieldsplit_diag_use_amat pc_mg_distinct_smoothup pc_gamg_reuse_interpolation"
    " pc_gamg_repartition pc_gamg_use_sa_esteig pc_gamg_recompute_esteig pc_gamg_asm_use_agg"
    " pc_gamg_use_parallel_coarse_grid_solver pc_gamg_sym_graph pc_gamg_symmetrize_graph pc_hypre_boomeramg_no_CF"
    " pc_hypre_boomeramg_nodal_relaxation pc_hypre_boomeramg_vec_interp_smooth snes_ksp_ew snes_lag_jacobian_persists"
    " snes_lag_preconditioner_persists"
)
_WHOLE = (
    "ksp_max_it ksp_gmres_restart ksp_gcr_restart ksp_lgmres_augment ksp_bcgsl_ell ksp_check_norm_iteration"
    " ksp_chebyshev_esteig_steps pc_factor_levels pc_sor_its pc_sor_lits pc_bjacobi_blocks pc_bjacobi_local_blocks"
    " pc_asm_blocks pc_asm_local_blocks pc_asm_overlap pc_gasm_overlap pc_redundant_number pc_mg_levels"
    " pc_mg_multiplicative_cycles pc_gamg_agg_nsmooths pc_gamg_coarse_eq_limit pc_gamg_process_eq_limit pc_gamg_square_graph"
    " pc_gamg_aggressive_coarsening pc_gamg_esteig_ksp_max_it pc_fieldsplit_gkb_delay pc_fieldsplit_gkb_maxit"
    " pc_hypre_boomeramg_max_levels pc_hypre_boomeramg_max_iter pc_hypre_boomeramg_numfunctions"
    " pc_hypre_boomeramg_P_max pc_hypre_boomeramg_agg_nl pc_hypre_boomeramg_agg_num_paths"
    " pc_hypre_boomeramg_grid_sweeps_all pc_hypre_boomeramg_grid_sweeps_down pc_hypre_boomeramg_grid_sweeps_up"
    " pc_hypre_boomeramg_grid_sweeps_coarse pc_hypre_boomeramg_nodal_coarsen pc_hypre_boomeramg_nodal_coarsen_diag"
    " pc_hypre_boomeramg_vec_interp_variant pc_hypre_boomeramg_vec_interp_qmax pc_hypre_boomeramg_interp_refine"
    " pc_hypre_pilut_maxiter pc_hypre_pilut_factorrowsize pc_hypre_parasails_nlevels snes_max_it snes_max_funcs"
    " snes_max_fail snes_max_linear_solve_fail snes_lag_jacobian snes_lag_preconditioner snes_ksp_ew_version"
    " snes_linesearch_max_it snes_linesearch_order"
    # not 1 to 4, which name units that Fortran writes to, nor 22, which keeps the factors in files
    + "".join(
        f" mat_mumps_icntl_{n}" for n in (6, 7, 8, 10, 11, 12, 13, 14, 20, 23, 24, 25, 27, 28, 29, 31, 33, 35, 36, 38)
    )
)
_NUMERIC = (
    "ksp_rtol ksp_atol ksp_divtol ksp_gmres_haptol ksp_gmres_breakdown_tolerance ksp_richardson_scale ksp_bcgsl_xres"
    " ksp_bcgsl_pinv pc_factor_fill pc_factor_shift_amount pc_factor_zeropivot pc_factor_column_pivot"
    " pc_factor_nonzeros_along_diagonal pc_sor_omega pc_eisenstat_omega pc_fieldsplit_schur_scale pc_fieldsplit_gkb_tol"
    " pc_fieldsplit_gkb_nu pc_gamg_threshold_scale pc_hypre_boomeramg_tol pc_hypre_boomeramg_truncfactor"
    " pc_hypre_boomeramg_strong_threshold pc_hypre_boomeramg_max_row_sum pc_hypre_boomeramg_relax_weight_all"
    " pc_hypre_boomeramg_outer_relax_weight_all pc_hypre_boomeramg_nongalerkin_tol pc_hypre_pilut_tol"
    " pc_hypre_parasails_thresh pc_hypre_parasails_filter snes_rtol snes_atol snes_stol snes_divergence_tolerance"
    " snes_ksp_ew_rtol0 snes_ksp_ew_rtolmax snes_ksp_ew_gamma snes_ksp_ew_alpha snes_ksp_ew_alpha2 snes_ksp_ew_threshold"
    " snes_linesearch_damping snes_linesearch_maxstep snes_linesearch_minlambda snes_linesearch_alpha"
    " snes_linesearch_rtol snes_linesearch_atol snes_linesearch_ltol mat_mumps_cntl_1 mat_mumps_cntl_2 mat_mumps_cntl_3"
    " mat_mumps_cntl_4 mat_mumps_cntl_5 mat_mumps_cntl_7 mat_superlu_diagpivotthresh"
)
_LISTS = (
    "ksp_chebyshev_eigenvalues ksp_chebyshev_esteig pc_gamg_threshold pc_gamg_eigenvalues pc_gamg_rank_reduction_factors"
    " pc_hypre_boomeramg_relax_weight_level pc_hypre_boomeramg_outer_relax_weight_level"
)
_TO_TERMINAL = "ksp_monitor ksp_monitor_true_residual ksp_converged_reason snes_monitor snes_converged_reason"
_RELAXATIONS = (
    "Jacobi sequential-Gauss-Seidel seqboundary-Gauss-Seidel SOR/Jacobi backward-SOR/Jacobi symmetric-SOR/Jacobi"
    " l1scaled-SOR/Jacobi Gaussian-elimination l1-Gauss-Seidel backward-l1-Gauss-Seidel CG Chebyshev FCF-Jacobi"
    " l1scaled-Jacobi"
)
_WORDS = {
    "ksp_type": _KRYLOV,
    "pc_gamg_esteig_ksp_type": _KRYLOV,
    "ksp_pc_side": "left right symmetric",
    "ksp_norm_type": "none preconditioned unpreconditioned natural",
    "ksp_gmres_cgs_refinement_type": "refine_never refine_ifneeded refine_always",
    "ksp_cg_type": "hermitian symmetric",
    "ksp_fcg_truncation_type": "standard notay",
    "pc_type": _PRECONDITIONERS,
    "pc_factor_mat_solver_type": "petsc mumps superlu superlu_dist umfpack cholmod klu spqr",
    "pc_factor_mat_ordering_type": "natural nd 1wd rcm qmd rowlength amd metisnd external none",
    "pc_factor_shift_type": "none nonzero positive_definite inblocks",
    "pc_jacobi_type": "diagonal rowmax rowsum",
    "pc_asm_type": "basic restrict interpolate none",
    "pc_asm_local_type": "additive multiplicative",
    "pc_gasm_type": "basic restrict interpolate none",
    "pc_fieldsplit_type": "additive multiplicative symmetric_multiplicative schur gkb",
    "pc_fieldsplit_schur_fact_type": "diag lower upper full",
    "pc_fieldsplit_schur_precondition": "self selfp a11 full",
    "pc_mg_type": "multiplicative additive full kaskade",
    "pc_mg_cycle_type": "v w",
    "pc_mg_galerkin": "both pmat mat none",
    "pc_gamg_type": "agg geo classical",
    "pc_hypre_type": "boomeramg pilut parasails",
    "pc_hypre_boomeramg_cycle_type": "V W",
    "pc_hypre_boomeramg_measure_type": "local global",
    "pc_hypre_boomeramg_coarsen_type": "CLJP Ruge-Stueben modifiedRuge-Stueben Falgout PMIS HMIS",
    "pc_hypre_boomeramg_interp_type": "classical direct multipass multipass-wts ext+i ext+i-cc standard standard-wts block"
    " block-wtd FF FF1 ext ad-wts ext-mm ext+i-mm ext+e-mm",
    "pc_hypre_boomeramg_relax_type_all": _RELAXATIONS,
    "pc_hypre_boomeramg_relax_type_down": _RELAXATIONS,
    "pc_hypre_boomeramg_relax_type_up": _RELAXATIONS,
    "pc_hypre_boomeramg_relax_type_coarse": _RELAXATIONS,
    "pc_hypre_parasails_sym": "nonsymmetric SPD nonsymmetric,SPD",
    "snes_type": "newtonls newtontr ksponly",
    "snes_linesearch_type": "basic bt l2 cp nleqerr",
}


def _expected() -> dict[str, str | Sequence[str]]:
    """Name of an option, without the prefixes of solvers -> its kind of value, or the words that it takes."""
    kinds = {"switch": _SWITCHES, "whole": _WHOLE, "number": _NUMERIC, "list": _LISTS, "terminal": _TO_TERMINAL}
    found: dict[str, str | Sequence[str]] = {name: kind for kind, names in kinds.items() for name in names.split()}
    return found | {name: tuple(words.split()) for name, words in _WORDS.items()}


EXPECTED: Mapping[str, str | Sequence[str]] = _expected()


def reaches_a_solver(option: str) -> bool:
    """Whether an option begins with the prefix of one of the program's solvers."""
    return _SOLVER.match(option) is not None


def refusal(option: str, value: Value) -> str:
    """Why a scene may not give an option of PETSc this value; empty where it may."""
    if not re.fullmatch(r"[A-Za-z][!-~]{0,150}", option):
        return "is no name of a PETSc option; give it without dash, such as solid_pc_type"
    elsewhere = f"or give it on the command line: -- -{option}"
    name = base = _SOLVER.sub("", option, count=1) if _SOLVER.match(option) else option
    while name not in EXPECTED and (inner := _INNER.match(name)):
        name = name[inner.end() :]
    expected = EXPECTED.get(name)
    if expected is None:
        close = nearest(base, EXPECTED)
        hint = f"{close} " if close.startswith("did") else ""
        return (
            "is not among the PETSc options that a scene may give, which choose methods, tolerances and limits of the solvers"
            f" {', '.join(SOLVERS)}; {hint}{elsewhere}"
        )
    if _fits(expected, value):
        return ""
    needs = {
        "switch": "true or false",
        "whole": f"a whole number, at most {LARGEST}",
        "number": "a number",
        "list": "numbers with commas between",
        "terminal": '"", which writes to the terminal',
    }
    wanted = needs[expected] if isinstance(expected, str) else f"one of {', '.join(expected)}"
    return f"must be {wanted}; {elsewhere}"


def _fits(expected: str | Sequence[str], value: Value) -> bool:
    """Whether a value is of the kind that an option takes in a scene."""
    if not isinstance(expected, str):
        return isinstance(value, str) and value.lower() in [word.lower() for word in expected]
    if isinstance(value, int) and abs(value) > LARGEST:
        return False
    text = str(value).lower() if isinstance(value, bool) else value if isinstance(value, str) else repr(value)
    if expected == "switch":
        return text in ("", "0", "1", "true", "false")
    if expected == "terminal":
        return text == ""
    if len(text) > 1000 or _NUMBERS.fullmatch(text) is None or (expected != "list" and "," in text):
        return False
    return expected != "whole" or (re.fullmatch(r"[-+]?\d{1,9}", text) is not None and abs(int(text)) <= LARGEST)
