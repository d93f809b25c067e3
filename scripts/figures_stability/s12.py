"""S12: up to which time step explicit steps are stable: by the joint's stiffness, the mass of the rock, and the shape of cells.

Two blocks of 4 by 3 cells meet at a joint of constant stiffness. They start with velocities of all vibrations at once.
Measured: the step from which on these grow, by halving. Predicted: the program's own critical step, which knows the rock alone.
Forces of joints follow the trapezoidal rule, with J in M + dt^2/4 J as in K + J: it drops out of dt^2 (K + J) = 4 M + dt^2 J.
Joints that take part as the rock does would need dt^2 (K + J) < 4 M, which is drawn too. A longer step is taken in parts.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, GREEN, INK, ORANGE, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI, PETSc
from fracflow.advance.initial_state import equilibrium_state
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import run
from fracflow.solve.explicit import ExplicitModel
from fracflow.solve.leapfrog.steps import Leapfrog
from fracflow.solve.request import StepRequest

MODULUS, POISSON, DENSITY = 40e9, 0.25, 2700.0
ACROSS, UP = 4, 3  # cells of a block
STEPS, GROWN = 500, 100.0  # steps of a trial; a velocity that is so many times the largest of the first tenth has grown
HALVINGS, BETWEEN = 8, (0.95, 1.15)  # of the step, over the program's
CLOSE = 5e-3  # stiff joints make walls heavy: growth just past the critical step is slow, and found a little late
SPEED = np.sqrt(MODULUS * (1.0 - POISSON) / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON)) / DENSITY)  # of P waves [m/s]
SCENE = """
output = {{pictures = false}}
method = {{stepper = "explicit"}}
[rock]
below = {{youngs_modulus = {modulus}, poissons_ratio = {poisson}, density = {below}}}
above = {{youngs_modulus = {modulus}, poissons_ratio = {poisson}, density = {above}}}
[mesh]
file = "blocks.geo"
[fracture.joint]
law = "linear"
normal_stiffness = {k_n}
shear_stiffness = {k_s}
aperture = 1
[[load]]
on = "north"
traction = [[[0, 0], [{time}, 1e6]], [[0, 0], [{time}, -1e6]]]
[[stage]]
kind = "dynamic"
time_step = {time}
steps = 40
"""
GEO = """
x[] = {{0, {width}}}; y[] = {{-{height}, 0, {height}}};
For j In {{0:2}}
  For i In {{0:1}}
    Point(2*j + i + 1) = {{x[i] + {skew}*y[j], y[j], 0}};
  EndFor
  Line(j + 1) = {{2*j + 1, 2*j + 2}}; Transfinite Curve{{j + 1}} = {across} + 1;
EndFor
For j In {{0:1}}
  Line(10 + j) = {{2*j + 1, 2*j + 3}}; Line(20 + j) = {{2*j + 2, 2*j + 4}};
  Transfinite Curve{{10 + j, 20 + j}} = {up} + 1;
  Curve Loop(j + 1) = {{j + 1, 20 + j, -(j + 2), -(10 + j)}}; Plane Surface(j + 1) = {{j + 1}};
EndFor
Transfinite Surface "*";
{recombine}
Physical Surface("below") = {{1}}; Physical Surface("above") = {{2}};
Physical Curve("joint") = {{2}}; Physical Curve("north") = {{3}};
Physical Curve("rest") = {{1, 10, 11, 20, 21}};
"""


class Blocks(NamedTuple):
    """Two blocks and their joint: stiffnesses over E/h, width over height h of cells, masses, skew, nodes a cell."""

    normal: float = 1.0
    shear: float = 1.0
    aspect: float = 1.0
    mass: float = 1.0
    skew: float = 0.0
    nodes: int = 4

    def scene(self, folder: Path, time: float = 1.0) -> Scene:
        """The scene, with cells 1 m high."""
        geo = {"width": ACROSS * self.aspect, "height": UP, "across": ACROSS, "up": UP, "skew": self.skew}
        recombine = 'Recombine Surface "*";' if self.nodes == 4 else ""
        (folder / "blocks.geo").write_text(GEO.format(**geo, recombine=recombine), encoding="utf-8")
        stiff = {"k_n": self.normal * MODULUS, "k_s": self.shear * MODULUS}
        rock = {"modulus": MODULUS, "poisson": POISSON, "below": DENSITY, "above": self.mass * DENSITY}
        (folder / "scene.toml").write_text(SCENE.format(**stiff, **rock, time=time), encoding="utf-8")
        return load(folder / "scene.toml")


class Found(NamedTuple):
    """Critical steps [s]: of the program; of the equations, and of joints that take part as the rock does; measured."""

    program: float
    equations: float
    with_joints: float
    measured: float


def dense(matrix: PETSc.Mat) -> Floats:
    """A matrix of one rank as an array."""
    rows, cols = matrix.getSize()
    indptr, indices, values = matrix.getValuesCSR()
    result = np.zeros((rows, cols))
    np.add.at(result, (np.repeat(np.arange(rows), np.diff(indptr)), indices), values)
    return result


def of_equations(model: Any, blocks: Blocks) -> tuple[float, float]:
    """2/omega of the largest omega^2 of M^-1 K, and of M^-1 (K + J)."""
    operators = model.operators
    jump, weights = dense(operators.joints.jump), np.repeat(operators.joints.weights, 2)
    moduli = np.tile([blocks.shear * MODULUS, blocks.normal * MODULUS], len(weights) // 2)
    mass, rock = np.sqrt(np.diag(dense(operators.mass))), dense(operators.stiffness)
    both = rock, rock + jump.T @ ((weights * moduli)[:, None] * jump)
    first, second = (2.0 / np.sqrt(np.linalg.eigvalsh(each / mass[:, None] / mass)[-1]) for each in both)
    return float(first), float(second)


@cache
def critical_steps(blocks: Blocks) -> Found:
    """All of them."""
    with tempfile.TemporaryDirectory() as name:
        model = prepare(blocks.scene(Path(name)), MPI.COMM_SELF)
    explicit, state = ExplicitModel(model.scene, model.operators, model.loads), equilibrium_state(model)
    leapfrog, number = Leapfrog(explicit, model.scene, model.loads), state.motion.velocity.getSize()
    state.motion.velocity.setArray(1e-6 * np.random.default_rng(1).normal(size=number))

    def grows(dt: float) -> bool:
        trial, largest = leapfrog.run, []
        trial.last = None
        trial.begin(state, dt)
        request = StepRequest(0.0, dt, {}, model.loads)
        for _ in range(STEPS):
            trial.predict(0.0, {}, (dt, dt))
            trial.pull(leapfrog.joints_at_end(trial.free_strain(), request).sections)
            trial.move(0.0, (dt, dt), False)
            largest.append(float(np.abs(trial.rock.v).max()))
            if largest[-1] > GROWN * max(largest[: STEPS // 10]):
                return True
        return False

    low, high = BETWEEN
    assert not grows(low * explicit.critical) and grows(high * explicit.critical)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle * explicit.critical) else (middle, high)
    found = Found(explicit.critical, *of_equations(model, blocks), 0.5 * (low + high) * explicit.critical)
    leapfrog.destroy()
    explicit.destroy()
    return found


def parted(blocks: Blocks, times: float) -> tuple[int, float]:
    """Parts of a step that is so many times the critical one, and how far a run of 40 of them misses its energies."""
    with tempfile.TemporaryDirectory() as name:
        totals = run(blocks.scene(Path(name), times * critical_steps(blocks).program), Path(name) / "run")
        text, found = (Path(name) / "run" / "log.txt").read_text(), read_history(Path(name) / "run" / "history.h5")
    assert totals.steps == 41
    energy = {key: np.abs(values).max() for key, values in found.items() if key.startswith("energy/")}
    parts = int(text.split(" is taken in ")[1].split()[0]) if " is taken in " in text else 1
    return parts, float(energy["energy/residual"] / max(energy.values()))


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s12`` into ``folder`` and return the bars."""
    stiff = 10.0 ** (np.array([-2.0, 4.0]) if small else np.arange(-2.0, 4.1))
    shapes = np.array([0.25, 2.0]) if small else np.array([0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
    masses = np.array([0.1]) if small else np.array([0.01, 0.1, 1.0, 10.0, 100.0])
    panels = {
        "stiffness": _lines(stiff, small, {
            f"$k_s/k_n$ = {ratio:g}": lambda each, ratio=ratio: Blocks(each, ratio * each) for ratio in (1.0, 0.001)
        }),
        "shape": _lines(shapes, small, {
            "quadrilaterals": lambda each: Blocks(0.1, 0.1, each),
            "the same, sheared by 45 degrees": lambda each: Blocks(0.1, 0.1, each, skew=1.0),
            "triangles": lambda each: Blocks(0.1, 0.1, each, nodes=3),
        }),
        "mass": _lines(masses, small, {
            "$k h/E$ = 10": lambda each: Blocks(10.0, 10.0, mass=each),
            "$k h/E$ = 0.1": lambda each: Blocks(0.1, 0.1, mass=each),
        }),
    }  # fmt: skip
    figure, axes = sheet(
        "S12  Up to which time step explicit steps are stable",
        "Two blocks of 4 by 3 cells at a joint, all vibrations at once. Marks: measured; lines: the program's critical step.",
        [list(panels)], (11.6, 4.6),
    )  # fmt: skip
    for (name, lines), x in zip(panels.items(), (stiff, shapes, masses), strict=True):
        _panel(axes[name], x, lines)
    _without_limit(axes["stiffness"], stiff, panels["stiffness"])
    axes["stiffness"].set(
        title="Joints", xlabel=r"normal stiffness $k_n h/E$", ylabel=r"critical step $\Delta t\,c_P/h$"
    )
    axes["shape"].set(title=r"Cells, $k_n = k_s = 0.1\,E/h$", xlabel="their width over their height $h$")
    axes["shape"].set_xticks(shapes, [f"{each:g}" for each in shapes])
    axes["shape"].minorticks_off()
    axes["mass"].set(title="Mass", xlabel="density above over density below", yscale="log")
    for axis in axes.values():
        axis.legend(loc="best", framealpha=1.0)
    save(figure, folder, "s12", "No joint makes the critical step shorter; of the rock alone it is known before a run.")
    every = list(dict.fromkeys(each for lines in panels.values() for line in lines.values() for each in line))
    found = [critical_steps(each) for each in every]
    columns = {name: [getattr(each, name) for each in every] for name in Blocks._fields}
    columns |= {f"{name}_s": [getattr(each, name) for each in found] for name in Found._fields}
    write_csv(folder, "s12", columns, ["scripts/figures stability --only S12"])
    off = max(abs(each.measured / each.equations - 1.0) for each in found)
    least, most = (pick(each.measured / each.program for each in found) for pick in (min, max))
    spared = max(each.measured / each.with_joints for each in found)
    parts, missed = parted(Blocks(100.0, 10.0), 3.5)
    return [
        Check("S12 measured critical step, off that of the equations", off, f"<= {CLOSE:g}", off <= CLOSE),
        Check("S12 measured critical step over the program's, least", least, f">= {1.0 - CLOSE:g}", least >= 1.0 - CLOSE),
        Check("S12 the same, most", most, "<= 1.05", most <= 1.05),
        Check("S12 the same over that of joints taken as rock, most", spared, ">= 10", spared >= 10.0),
        Check("S12 parts of a step of 3.5 critical ones", parts, "4", parts == 4),
        Check("S12 energy that 40 such steps miss", missed, "<= 1e-10", missed <= 1e-10),
    ]  # fmt: skip


def _lines(x: Floats, small: bool, of: dict[str, Callable[[float], Blocks]]) -> dict[str, list[Blocks]]:
    """Blocks along some lines; a small figure has the first one."""
    return {name: [make(each) for each in x.tolist()] for name, make in list(of.items())[: 1 if small else None]}


def _panel(axis: Axes, x: Floats, lines: dict[str, list[Blocks]]) -> None:
    """Measured critical steps of some lines of blocks, and those of the program."""
    unit = 1.0 / SPEED  # a P wave crosses a cell
    for (name, line), colour, mark in zip(lines.items(), (BLUE, ORANGE, GREEN), "os^", strict=False):
        found = [critical_steps(each) for each in line]
        axis.plot(x, [each.program / unit for each in found], "-", color=colour, lw=1.0)
        axis.plot(x, [each.measured / unit for each in found], mark, color=colour, ms=5, mfc="none", label=name)
    axis.set(xscale="log")


def _without_limit(axis: Axes, x: Floats, lines: dict[str, list[Blocks]]) -> None:
    """The critical step if joints took part as the rock does."""
    found = [critical_steps(each).with_joints * SPEED for each in next(iter(lines.values()))]
    axis.plot(x, found, ":", color=INK, label="joints taken as the rock")
    axis.set(yscale="log")
