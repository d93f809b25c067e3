"""S1: where each coupling of rock and fluid works, over time step and pressure; the boundary of plain cycles predicted.

A stiff block on a film between two fixed pressures, pumped in the middle: one opening w and one pressure p, so every number is
closed. From steady flow at p the pumping rises by 1 % within one trapezoidal step. With d the aperture at p, k = p/w, and tau_d
the time in which the film drains, a plain cycle (4.5) multiplies the error by 2 tau_d/dt + 3 p/(k d).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from sheets import BLUE, HALO, INK, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.errors import SolveError
from fracflow.integrators import Newmark, Steady
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.solve import Coupling
from fracflow.solve.accept import accept
from fracflow.solve.fixed_point.iteration import FixedPoint
from fracflow.solve.monolithic import Monolithic
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest, StepRule

REACH, STIFFNESS, VISCOSITY, PRESSURE = 10.0, 1e9, 1e-3, 1e5
"""Length of each of the two elements [m], k_n [Pa/m], viscosity [Pa s], pressure of the steady flow [Pa]."""
SPRING = 2.0 * STIFFNESS  # p over opening: the ends' fixed pressures leave half the film to push
MOST_CYCLES = 250
RAISE = 0.01
BAND = 0.1
MOST_NEWTON, AGREEMENT = 8, 0.98
METHODS = {
    "plain": "plain cycles (4.5)", "aitken": "Aitken", "anderson": "Anderson (5)", "added-storage": "added storage",
    "monolithic": "monolithic",
}  # fmt: skip
STEPS = [1, 3, 5, 9, 17, 33, 65, 129, 250]
COLOURS = ["#f7fbf4", "#dff0d8", "#bfe3bb", "#97d1a5", "#63b98f", "#3a9c86", "#227d7b", "#155b66"]
LOST = "#D55E00"


def scene(method: dict[str, Any]) -> Scene:
    """The block on its film; its aperture is set point by point."""
    fracture = {"law": "linear", "normal_stiffness": STIFFNESS, "shear_stiffness": STIFFNESS, "aperture": 1e-4}
    return Scene.from_data(
        {
            "method": method,
            "accuracy": {"max_cycles": MOST_CYCLES},
            "geometry": {
                "domain": [0.0, -REACH, 2 * REACH, REACH], "size": REACH, "cells": "quads",
                "fracture": [{"name": "film", "points": [[0.0, 0.0], [2 * REACH, 0.0]]}],
            },
            # stiff, so that the block stays flat, and so light that its inertia does not count
            "rock": {"rock": {"youngs_modulus": 1e3 * STIFFNESS * REACH, "poissons_ratio": 0.0, "density": 1e-12}},
            "fracture": {"film": fracture},
            "fluid": {"viscosity": VISCOSITY, "density": 1000.0},
            "support": [
                {"on": ["south"]},
                {"on": ["north"], "components": ["x"]},
            ],
            "well": [
                {"name": "in", "at": [REACH, 0.0], "flow_rate": 0.0},
                {"name": "west", "at": {"fracture": "film", "end": "start"}, "pressure": 0.0},
                {"name": "east", "at": {"fracture": "film", "end": "end"}, "pressure": 0.0},
            ],
            "stage": [{"kind": "dynamic", "time_step": 1.0, "steps": 1}],
        }
    )  # fmt: skip


class Film:
    """The scene made ready once, and the point of the map that it stands at."""

    def __init__(self) -> None:
        self.model: Model = prepare(scene({}), MPI.COMM_SELF)
        self.start = equilibrium_state(self.model)
        self.steady = Monolithic(self.model.scene, self.model.operators, self.model.loads)

    def couplings(self) -> dict[str, Coupling]:
        """All methods, their solvers kept from point to point."""
        made: dict[str, Coupling] = {}
        for name in METHODS:
            method = {"coupling": "monolithic"} if name == "monolithic" else {"fixed_point": name}
            kind: Callable[..., Coupling] = Monolithic if name == "monolithic" else Unrefused
            made[name] = kind(scene(method), self.model.operators, self.model.loads)
        return made

    def destroy(self) -> None:
        """Free the solver and the state at rest."""
        self.steady.destroy()
        self.start.destroy()

    def problem(self, aperture: float, state: State, stepper: Any, dt: float, rate: float) -> StepProblem:
        """A step of the film with an aperture at rest, pumped at a rate."""
        operators = self.model.operators
        assert operators.flow is not None
        film = np.full_like(operators.flow.aperture, aperture)
        flow = replace(operators.flow, aperture=film, law=replace(operators.flow.law, aperture=film))
        problem = StepProblem(
            replace(operators, flow=flow),
            state,
            StepRequest(state.time + dt, dt, {}, self.model.loads),
            StepRule(stepper.alphas(dt)),
        )
        problem.source.axpy(rate, self.model.loads.wells[0].vector)
        return problem

    def flowing(self, aperture: float, rate: float) -> State:
        """Steady flow at a rate."""
        problem = self.problem(aperture, self.start, Steady(), 0.0, rate)
        self.steady.solve(problem)
        state = accept(problem, self.start.energy)
        problem.destroy()
        return state


class Unrefused(FixedPoint):
    """Plain cycles are tried whatever is predicted, to see."""

    limit = np.inf


def at_ratio(ratio: float) -> tuple[float, float, float]:
    """Aperture at rest, rate and tau_d of a film that flows at PRESSURE with p/(k d) = ``ratio``."""
    opening = PRESSURE / SPRING
    aperture = opening / ratio
    conductance = 2.0 * aperture**3 / (12.0 * VISCOSITY * REACH)
    return aperture - opening, conductance * PRESSURE, REACH / SPRING / conductance


def measure(steps: Floats, ratios: Floats) -> dict[str, Floats]:
    """Iterations of each method, NaN where it fails, and the factor that was predicted; (ratios, steps) each."""
    film = Film()
    made = film.couplings()
    found = {name: np.full((len(ratios), len(steps)), np.nan) for name in (*METHODS, "predicted")}
    for row, ratio in enumerate(ratios):
        aperture, rate, tau = at_ratio(ratio)
        state = film.flowing(aperture, rate)
        for column, step in enumerate(steps):
            for name, coupling in made.items():
                problem = film.problem(aperture, state, Newmark(), step * tau, (1.0 + RAISE) * rate)
                try:
                    report = coupling.solve(problem)
                    found[name][row, column] = report.newton if name == "monolithic" else report.cycles
                except SolveError:
                    pass
                problem.destroy()
            plain = made["plain"]
            assert isinstance(plain, Unrefused) and plain.linearised is not None
            found["predicted"][row, column] = plain.linearised.prediction.factor
        state.destroy()
    for coupling in made.values():
        coupling.destroy()
    film.destroy()
    return found


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure and draw the map; its bars."""
    steps = np.logspace(-2, 2, 9 if small else 41)
    ratios = np.logspace(-3, np.log10(0.9), 5 if small else 26)
    found = measure(steps, ratios)
    closed = 2.0 / steps[None, :] + 3.0 * ratios[:, None]
    off = np.abs(closed - 1.0) > BAND
    converged = np.isfinite(found["plain"])
    agree = {
        name: np.mean(((rho < 1.0) == converged)[off])
        for name, rho in (("line", closed), ("predicted", found["predicted"]))
    }
    wrong = np.abs(found["predicted"] / closed - 1.0).max()
    figure, axes = sheet(
        "S1  Coupling of rock and fluid: where cycles converge, and where they do not",
        "Plain cycles work only to the right of the black line, where the trapezoidal rule rings; monolithic works everywhere.",
        [[*METHODS, "bar"]], (14.2, 4.1), width_ratios=[1] * len(METHODS) + [0.09],
    )  # fmt: skip
    map_colours = ListedColormap(COLOURS)
    map_colours.set_bad(LOST)
    norm = BoundaryNorm(STEPS, map_colours.N)
    for name, title in METHODS.items():
        axis, share = axes[name], np.isfinite(found[name]).mean()
        shown = axis.pcolormesh(
            steps, ratios, np.ma.masked_invalid(found[name]), cmap=map_colours, norm=norm, shading="nearest"
        )
        edge = np.linspace(0.0, 0.9, 400)[:-1]
        edge = edge[3.0 * edge < 1.0]
        axis.plot(2.0 / (1.0 - 3.0 * edge), np.maximum(edge, 1e-4), color=INK, lw=1.8)
        axis.axvline(2.0, color=BLUE, lw=1.3, ls=(0, (4, 2)))
        axis.set(xscale="log", yscale="log", xlim=steps[[0, -1]], ylim=ratios[[0, -1]], xlabel=r"$\Delta t/\tau_d$")
        axis.set_title(f"{title}: {100 * share:.0f} %" if share < 1 else f"{title}: all")
        axis.grid(False)
        if name != "plain":
            axis.tick_params(labelleft=False)
    first = axes["plain"]
    first.set_ylabel("$p/(k d)$")
    first.text(0.03, 0.05, "diverges", color="white", fontweight="bold", transform=first.transAxes)
    first.annotate(
        "$\\Delta t = 2\\tau_d$", (2.0, ratios[0]), (4, 5), textcoords="offset points", color=BLUE, path_effects=HALO
    )
    first.annotate("2$\\tau_d/\\Delta t$ + 3$p/(kd)$ = 1", (0.04, 0.93), xycoords="axes fraction", color="white")
    figure.colorbar(shown, cax=axes["bar"], label="cycles; Newton iterations for monolithic")
    note = (
        f"{len(steps)} x {len(ratios)} trapezoidal steps from steady flow, pumping raised by 1 %, at most {MOST_CYCLES} cycles;"
        " orange: failed. Titles: share that converged. One mode only, where Aitken and Anderson are at"
        " their best; speckles: tests at round-off."
    )
    save(figure, folder, "s1", note)
    grid = np.meshgrid(steps, ratios)
    columns = {"dt_over_tau_d": grid[0].ravel(), "p_over_kd": grid[1].ravel(), "closed_form": closed.ravel()}
    write_csv(
        folder, "s1", columns | {name: values.ravel() for name, values in found.items()},
        ["scripts/figures stability --only S1"], "cycles, for monolithic Newton iterations; nan: failed", note,
    )  # fmt: skip
    newton = float(np.nan_to_num(found["monolithic"], nan=np.inf).max())
    return [
        Check("S1 monolithic, most Newton iterations", newton, f"<= {MOST_NEWTON}, everywhere", newton <= MOST_NEWTON),
        Check("S1 plain: as the line says", agree["line"], f">= {AGREEMENT} off a 10 % band", agree["line"] >= AGREEMENT),
        Check(
            "S1 plain: as was predicted before", agree["predicted"], f">= {AGREEMENT} off a 10 % band",
            agree["predicted"] >= AGREEMENT,
        ),
        Check("S1 predicted factor against the closed form", wrong, "<= 0.02", wrong <= 0.02),
    ]  # fmt: skip
