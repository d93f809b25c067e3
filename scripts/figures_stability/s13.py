"""S13: which steps and joints slow slip by rate-and-state friction needs, over dt V/D_c and h/L_b.

A short fault in rock that is not meshed slips slowly as pressure rises at its middle (a > b). The error is the larger of
potency and largest rate, against the finest joints and steps. Predicted, with k chosen: a step in which ln V changes
by as much as slip over D_c leaves (V dt/D_c)^2/24 of its slip. Equal joints take (k h)^2/6 off the stiffness against a wave
(``fracflow.elements.dislocation``). The one that counts is chosen, so that errors agree: sqrt(2) times as long as that whose
quarter is the zone 9 pi/32 L_b in which the state evolves, k = 1.26/L_b.

By the slip law the state falls over D_c/ln(V0 theta/D_c) at the front of slip, here a ninth of D_c. The order shows on joints
that are shorter than L_b/9: potency is compared on three meshes about that length.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from figures_verification.runs import solve
from matplotlib.axes import Axes
from sheets import BLUE, INK, NODE_COLOURS, ORANGE, Check, Floats, save, sheet, write_csv

SHEAR, POISSON, SIGMA, A, B, D_C = 30e9, 0.25, 50e6, 0.012, 0.010, 1e-3
L_B = SHEAR / (1.0 - POISSON) * D_C / (B * SIGMA)
HALF, REACH, END, TOP, LOW = 8.0 * L_B, 3.0 * L_B, 1e6, 8e6, 5e6
"""Half of the fault and of the pressure's reach [m]; time [s] in which the pressure comes to its top, or a lower one [Pa]."""
ALLOWED = 0.03  # error with which an answer holds
OF_SLIP_LAW, SHARE, LEAST_ORDER = (64, 128, 256), 0.9, 1.5  # joints, dt V/D_c; asked of the order of potency
WAVE = 16.0 / 9.0 / np.sqrt(2.0)  # k L_b
SCENE = f"""
rock.rock = {{{{youngs_modulus = {2.0 * SHEAR * (1.0 + POISSON)}, poissons_ratio = {POISSON}, density = 2700}}}}
initial_stress = {{{{xx = {-SIGMA}, yy = {-SIGMA}, zz = {-SIGMA}, xy = {0.58 * SIGMA}}}}}
fluid = {{{{viscosity = 1e-3, initial_pressure = 0}}}}
accuracy.slip_share = {{share}}
probe = [{{{{name = "middle", at = [0, 0], on = "fault", quantities = ["sliding_rate"]}}}}]
stage = [{{{{kind = "steady", time_step = {END / 16}, end = {END}}}}}]
[geometry]
domain = "unbounded"
size_at_fractures = {{size}}
fracture = [{{{{name = "fault", points = [[{-HALF}, 0], [{HALF}, 0]]}}}}]
[fracture.fault]
law = "rate-and-state"
normal_stiffness = 1e14
shear_stiffness = 1e14
aperture = 1e-3
friction_coefficient = 0.6
reference_slip_rate = 1e-6
direct_effect = {A}
evolution_effect = {B}
characteristic_slip = {D_C}
initial_slip_rate = 1e-10
state_law = "{{law}}"
pressure = {{{{along = {{along}}, time = [0, {END}], value = {{values}}}}}}
"""


def predicted(share: Floats, size: Floats) -> Floats:
    """Error of slip by dt V/D_c and h/L_b, arrays of one shape."""
    found: Floats = share**2 / 24.0 + (WAVE * size) ** 2 / 6.0
    return found


@cache
def slipped(share: float, joints: int, top: float = TOP, law: str = "ageing") -> tuple[float, float]:
    """Potency [m2] and largest rate at the middle [m/s] of a run in steps of slip ``share`` D_c on so many joints, by a law."""
    places = np.linspace(-HALF, HALF, 129)
    pressure = top * np.exp(-((places / REACH) ** 2))
    scene = SCENE.format(
        share=share, law=law, size=2.0 * HALF / joints * (1.0 + 1e-9), along=(places + HALF).tolist(),
        values=[[0.0] * len(places), pressure.tolist()],
    )  # fmt: skip
    found = solve(scene)
    state = found.fractures[-1]
    order = np.argsort(state.points[:, 0], kind="stable")
    z, slip = state.points[order, 0], np.abs(state.point["plastic_slip"][order])
    return float(np.sum((slip[1:] + slip[:-1]) / 2 * np.diff(z))), float(found.probe("middle", "sliding_rate").max())


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s13`` into ``folder`` and return the bars."""
    shares, joints, top = ((0.9,), (32,), LOW) if small else ((0.9, 0.6, 0.3), (16, 32, 64), TOP)
    finest = slipped(0.3, 64, top) if small else slipped(0.2, 128)
    grid = np.meshgrid(shares, joints)
    found = np.array([slipped(float(x), int(n), top) for x, n in zip(*map(np.ravel, grid), strict=True)])
    errors = np.abs(found / finest - 1.0).max(axis=1).reshape(grid[0].shape)
    size = 2.0 * HALF / L_B / grid[1]
    foretold = predicted(grid[0], size)
    figure, axes = sheet(
        "S13  Which steps and joints slow slip by rate-and-state friction needs",
        "A short fault in unmeshed rock, slow slip as pressure rises, a > b; the worse error of potency and largest rate.",
        [["map", "error"]], (10.2, 4.6),
    )  # fmt: skip
    _map(axes["map"], grid[0], size, errors)
    _curves(axes["error"], shares, size, errors)
    save(figure, folder, "s13", "Predicted: (V dt/D_c)^2/24 + (k h)^2/6, k = 1.26/L_b; k alone is chosen.")
    columns = {
        "dt_rate_over_d_c": grid[0].ravel(), "joint_over_l_b": size.ravel(), "error": errors.ravel(),
        "predicted": foretold.ravel(),
    }  # fmt: skip
    write_csv(folder, "s13", columns, ["scripts/figures stability --only S13"])
    wrong = int(np.sum((errors > ALLOWED) & (foretold <= ALLOWED)))
    most, least = float((errors / foretold).max()), float((errors / foretold).min())
    found_order = [] if small else [_order_of_slip_law()]
    return [
        *found_order,
        Check("S13 runs that fail where they are predicted to hold", wrong, "= 0", wrong == 0),
        Check("S13 error over the predicted one, at most", most, "<= 1.5", most <= 1.5),
        Check("S13 error over the predicted one, at least", least, ">= 0.3", least >= 0.3),
    ]  # fmt: skip


def _order_of_slip_law() -> Check:
    """By three meshes, each of half the joints of the one before."""
    coarse, middle, fine = (slipped(SHARE, joints, law="slip")[0] for joints in OF_SLIP_LAW)
    order = float(np.log2((middle - coarse) / (fine - middle)))
    return Check("S13 slip law, order of potency", order, f">= {LEAST_ORDER}", order >= LEAST_ORDER)


def _map(axis: Axes, share: Floats, size: Floats, errors: Floats) -> None:
    """Mark each run by whether it holds; draw the boundary."""
    for chosen, mark, colour, label in (
        (errors <= ALLOWED, "o", BLUE, f"within {100 * ALLOWED:g} %"),
        (errors > ALLOWED, "X", ORANGE, "off by more"),
    ):
        axis.plot(share[chosen], size[chosen], mark, color=colour, ms=8, label=label, ls="")
    for at, of, error in zip(share.ravel(), size.ravel(), errors.ravel(), strict=True):
        axis.annotate(f"{100 * error:.2g} %", (at, of), (7, 4), textcoords="offset points", fontsize=7)
    fine = np.meshgrid(np.linspace(0.01, 1.0, 60), np.geomspace(0.1, 1.5, 60))
    axis.contour(*fine, predicted(*fine), [ALLOWED], colors=INK, linestyles="--")
    axis.plot([], [], "--", color=INK, label=f"predicted: {100 * ALLOWED:g} %")
    axis.axhline(1.0 / 3.0, color=INK, lw=0.6)
    axis.text(0.02, 0.345, "3 joints in $L_b$ (check)", fontsize=7)
    axis.set(
        xlabel=r"$V\,\Delta t\,/\,D_c$ (slip_share)",
        ylabel=r"$h\,/\,L_b$",
        yscale="log",
        xlim=(0.0, 1.0),
        ylim=(0.15, 2.4),
    )
    axis.set_title("What runs do")
    axis.legend(loc="upper left", framealpha=1.0, ncols=3, fontsize=7)


def _curves(axis: Axes, shares: tuple[float, ...], size: Floats, errors: Floats) -> None:
    """Errors over h/L_b, beside the predicted ones."""
    fine = np.geomspace(0.15, 1.2, 60)
    for number, share in enumerate(shares):
        colour = NODE_COLOURS[number % len(NODE_COLOURS)]
        axis.plot(fine, predicted(np.full_like(fine, share), fine), "-", color=colour, lw=0.8)
        axis.plot(size[:, number], errors[:, number], "os^"[number % 3], color=colour, ms=5, label=f"{share:g}")
    axis.set(xlabel=r"$h\,/\,L_b$", ylabel="error of potency or largest rate", xscale="log", yscale="log")
    axis.set_title("Lines: predicted")
    axis.legend(title=r"$V\,\Delta t\,/\,D_c$")
