"""S11: how many iterations GMRES takes for rock whose fractures slide, by multigrid of two kinds.

Ten fractures apart, whose sections slide from the start of each to a share of its length, and stick beyond. Predicted:
multigrid with strips and coarse displacements (``method.rock_solver``) takes the iterations of rock without fractures, at any
size, however weak joints are and however long a time step is. BoomerAMG on the rock with its joints serves while they stick.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from sheets import BLUE, GREEN, INK, ORANGE, PALE, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.advance.initial_state import equilibrium_state
from fracflow.integrators import BackwardEuler
from fracflow.mesh.blocks import Blocks
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.solve import options
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.linear import set_up
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest, StepRule

EXTENT, STIFF, FRICTION = 640.0, 1e11, 0.6
LENGTH = 0.21 * EXTENT  # of a fracture
PLAIN = {
    "monolithic_ksp_type": "fgmres",
    "monolithic_pc_type": "fieldsplit",
    "monolithic_fieldsplit_solid_pc_type": "hypre",
}
"""Options of BoomerAMG on the rock with its joints, in PETSc's own split."""
WAYS = {"with strips": {}, "BoomerAMG alone": PLAIN}
MOST, ALLOWED, OVER = 100, 30, 1.6
SHARES = {0.0: BLUE, 0.5: GREEN, 1.0: ORANGE}


def scene_of(unknowns: int) -> Scene:
    """Ten fractures apart in a square of rock, each turned another way and open to a reservoir at its start."""
    random, wide, fractures = np.random.default_rng(1), EXTENT / 4.0, []
    for number in range(10):
        angle = random.uniform(0.0, np.pi)
        middle, half = (
            (np.array(divmod(number, 4)) + 0.5) * wide,
            0.5 * LENGTH * np.array([np.cos(angle), np.sin(angle)]),
        )
        fractures.append({"name": f"f{number}", "points": [(middle - half).tolist(), (middle + half).tolist()]})
    law = {"law": "linear", "normal_stiffness": STIFF, "shear_stiffness": STIFF, "aperture": 1e-3}
    return Scene.from_data(
        {
            "geometry": {
                "domain": [0.0, 0.0, EXTENT, EXTENT], "size": 1.07 * EXTENT / (unknowns / 2) ** 0.5, "cells": "triangles",
                "fracture": fractures,
            },
            "rock": {"rock": {"youngs_modulus": 5e10, "poissons_ratio": 0.25, "density": 2700.0}},
            "fracture": {"default": law},
            "fluid": {"viscosity": 1e-3, "specific_weight": 1e4},
            "support": [{"on": ["south", "north", "west", "east"]}],
            "well": [{"name": f["name"], "at": {"fracture": f["name"], "end": "start"}, "pressure": 0.0} for f in fractures],
            "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
        }
    )  # fmt: skip


def moduli(blocks: Blocks, ratio: float, share: float) -> Floats:
    """Tangent moduli (s, 2, 2): sections stick with k_s = ratio k_n, or slide, where an opening takes shear traction away."""
    joints = blocks.joints
    along, of = joints.along.ravel(), np.repeat(joints.fracture, 2)
    length = np.array([along[of == number].max() for number in range(len(joints.fractures))])
    slides = (along < share * length[of]) | (share == 1.0)
    result = np.zeros((len(along), 2, 2))
    result[:, 1, 1], result[~slides, 0, 0], result[slides, 0, 1] = STIFF, ratio * STIFF, -FRICTION * STIFF
    return result


class Case(NamedTuple):
    """One linear system: size asked for, way to solve it, k_s/k_n, share of sections that slide, time step [s]."""

    unknowns: int
    way: str
    ratio: float = 1e-2
    share: float = 0.5
    dt: float = 1.0


@cache
def system(unknowns: int) -> tuple[JoinedMatrix, object, object]:
    """Matrix, state and model, kept for all cases of a size."""
    model = prepare(scene_of(unknowns), MPI.COMM_SELF)
    return JoinedMatrix(model.operators, model.loads), equilibrium_state(model), model


def krylov(case: Case) -> tuple[int, int]:
    """Iterations to the program's own tolerance, ``MOST`` where these do not suffice; and those predicted."""
    matrix, state, model = system(case.unknowns)
    request, rule = StepRequest(case.dt, case.dt, {}, model.loads), StepRule(BackwardEuler().alphas(case.dt))
    options.set_defaults(WAYS[case.way], options.BY_MULTIGRID)
    problem = StepProblem(model.operators, state, request, rule)
    problem.evaluate()
    chosen = moduli(model.operators.blocks, case.ratio, case.share)
    matrix.fill(problem.alphas, chosen, problem.conduction, problem.flow_scale())
    solver = options.solver_of(matrix.matrix, "monolithic_")
    set_up(solver, matrix)
    made, predicted = _solve(solver, matrix.matrix), 0
    if solver.getPC().getType() == "python":
        rock, first = solver.getPC().getPythonContext(), PETSc.KSP().create(comm=PETSc.COMM_SELF)
        first.setOperators(rock.systems["intact"])
        first.setType("fgmres")
        first.setTolerances(rtol=solver.getTolerances()[0], max_it=MOST)
        first.setPC(rock.cycle.getPC())
        predicted = _solve(first, rock.systems["intact"])
        solver.getPC().setType("none")
        first.destroy()
    destroy(solver, problem)
    return made, predicted


def _solve(solver: PETSc.KSP, matrix: PETSc.Mat) -> int:
    """Iterations from a random right side, the same whenever it is asked for."""
    solution, right = matrix.createVecs()
    right.setArray(np.random.default_rng(0).standard_normal(right.getLocalSize()))
    solver.solve(right, solution)
    made = solver.getIterationNumber() if solver.getConvergedReason() > 0 else MOST
    destroy(solution, right)
    return int(made)


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s11`` into ``folder`` and return the bars."""
    size = 3_000 if small else 25_000
    ratios = np.logspace(-7, 0, 3 if small else 8)
    shares = np.linspace(0.0, 1.0, 3 if small else 9)
    steps = np.array([1e-3, 1e9]) if small else np.logspace(-3, 9, 7)
    sizes = np.array([size]) if small else np.array([6_000, 25_000, 100_000])
    first, second = WAYS
    by_ratio = {
        (w, s): [krylov(Case(size, w, ratio=r, share=s)) for r in ratios.tolist()] for w in WAYS for s in SHARES
    }
    by_share = {way: [krylov(Case(size, way, share=share)) for share in shares.tolist()] for way in WAYS}
    by_step = {share: [krylov(Case(size, first, share=share, dt=dt)) for dt in steps.tolist()] for share in SHARES}
    by_size = {share: [krylov(Case(n, first, share=share)) for n in sizes.tolist()] for share in SHARES}
    real = np.array([system(n)[0].layout.total for n in sizes.tolist()], dtype=float)
    figure, axes = sheet(
        "S11  Iterations for rock that slides along its fractures",
        "Ten fractures, 26 700 unknowns but in the last. Full: multigrid with strips; dotted: predicted; dashed: BoomerAMG.",
        [["ratio", "share"], ["step", "size"]], (8.6, 6.4),
    )  # fmt: skip
    for share, colour in SHARES.items():
        _line(axes["ratio"], ratios, by_ratio[first, share], colour)
        axes["ratio"].plot(ratios, [made for made, _ in by_ratio[second, share]], "--", marker="o", ms=4, color=colour)
        _line(axes["step"], steps, by_step[share], colour)
        _line(axes["size"], real, by_size[share], colour)
    _line(axes["share"], shares, by_share[first], INK)
    axes["share"].plot(shares, [made for made, _ in by_share[second]], "--", marker="o", ms=4, color=INK)
    axes["ratio"].set(xscale="log", xlabel="$k_s/k_n$ of sections that stick", title="By shear stiffness")
    axes["share"].set(xlabel="share of each fracture that slides", title="By what slides")
    axes["step"].set(xscale="log", xlabel="time step [s]", title="By time step")
    axes["size"].set(xscale="log", xlabel="unknowns", title="By size")
    names = {0.0: "all stick", 0.5: "a half slides", 1.0: "all slide"}
    colours = [Line2D([], [], color=colour, marker="o", ms=4, label=names[share]) for share, colour in SHARES.items()]
    for axis in axes.values():
        axis.axhline(ALLOWED, color=PALE, lw=1.0)
        axis.set(yscale="log", ylim=(3, 130), yticks=[3, 10, 30, 100], ylabel="iterations")
        axis.set_yticklabels(["3", "10", "bar, 30", "not in 100"])
        axis.minorticks_off()
    for name in ("step", "size"):
        axes[name].legend(handles=colours, loc="upper left")
    save(figure, folder, "s11", "One linear system each, random right side, relative residual 1e-5.")
    columns: dict[str, Floats] = {"ks_over_kn": ratios, "share": shares, "time_step": steps, "unknowns": real}
    for (way, share), found in by_ratio.items():
        columns[f"{way} by ratio, share {share:g}"] = np.array([made for made, _ in found], dtype=float)
    for way, found in by_share.items():
        columns[f"{way} by share"] = np.array([made for made, _ in found], dtype=float)
    for name, table in (("step", by_step), ("size", by_size)):
        for share, found in table.items():
            columns[f"{first} by {name}, share {share:g}"] = np.array([made for made, _ in found], dtype=float)
    columns["predicted by size, share 1"] = np.array([predicted for _, predicted in by_size[1.0]], dtype=float)
    write_csv(folder, "s11", columns, ["scripts/figures stability --only S11"])
    ours = [pair for (way, _), found in by_ratio.items() if way == first for pair in found]
    ours += [pair for table in (by_share[first], *by_step.values(), *by_size.values()) for pair in table]
    worst, over = max(made for made, _ in ours), max(made / predicted for made, predicted in ours)
    weak = min(made for share, found in ((s, by_ratio[second, s]) for s in (0.5, 1.0)) for made, _ in found)
    return [
        Check("S11 with strips, most iterations", worst, f"<= {ALLOWED}", worst <= ALLOWED),
        Check("S11 with strips, over those predicted", over, f"<= {OVER:g}", over <= OVER),
        Check("S11 BoomerAMG alone where a half slides or all, least", weak, f"> {ALLOWED}", weak > ALLOWED),
    ]


def _line(axis: Axes, x: Floats, found: list[tuple[int, int]], colour: str) -> None:
    axis.plot(x, [made for made, _ in found], "o-", ms=4, color=colour)
    axis.plot(x, [predicted for _, predicted in found], ":", color=INK)
