"""S6: at which load slip runs away along a bar, against the length of joints: a drop of strength at once, and one with slip.

The bar of meshes/failures/rupture_along_bar, E D = rho D = 1, symmetric, as a chain of nodes in NumPy: the program's joint
laws answer at the nodes, a central difference moves them, all loads at once. In |x| < 4 strength is 0.6 from the start, beyond
it 1 until slip begins; S = (1 - tau_0)/(tau_0 - 0.6). Slip that passes x = 12 runs away. The card is asked of the scene itself;
tests/failures/test_rupture_along_bar.py runs that, too.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, GREEN, INK, ORANGE, PALE, ROOT, SKY, Check, Floats, save, sheet, write_csv

from fracflow.diagnostics import pre_run_checks
from fracflow.laws import JOINT_LAWS
from fracflow.model.setup import place
from fracflow.reduction.prepare import read_split
from fracflow.scene.scene import load

SCENE = ROOT / "meshes" / "failures" / "rupture_along_bar" / "scene.toml"
LENGTH, PATCH, FAR, END = 24.0, 4.0, 12.0, 26.0
PEAK, LOW = 1.0, 0.6
COURANT = 0.4
LEAST, MOST, AT_ONCE = 0.5, 200.0, 15  # loads tried at once, between the smallest and the largest
CLOSE = 1.004  # to which a threshold is found
FLAT = 0.05
STIFF = 400.0  # k_s of the joint that weakens with slip: its own length is 0.05
Make = Callable[[Floats, Floats], Any]


def jump(scale: float) -> Make:
    """A drop at once, of a joint whose own length sqrt(E D/k_s) is ``scale``."""
    return lambda weak, tau: JOINT_LAWS["hyperbolic-coulomb"](
        normal_stiffness=1.0, shear_stiffness=1.0 / scale**2, aperture=10.0, initial_normal_traction=-1.0,
        friction_coefficient=np.where(weak, LOW, PEAK), stick_slip_ratio=np.where(weak, 1.0, LOW / PEAK),
        initial_shear_traction=tau,
    )  # fmt: skip


def weakening(zone: float) -> Make:
    """A fall with slip, over a D_c that makes sqrt(E D D_c/dtau) ``zone``."""
    return lambda weak, tau: JOINT_LAWS["slip-weakening"](
        normal_stiffness=1.0, shear_stiffness=STIFF, aperture=10.0, initial_normal_traction=-1.0,
        friction_coefficient=np.where(weak, LOW, PEAK), dynamic_friction_coefficient=LOW,
        slip_weakening_distance=zone**2 * (PEAK - LOW), initial_shear_traction=tau,
    )  # fmt: skip


def runs_away(make: Make, size: float, excess: Floats) -> np.ndarray:
    """Whether slip passes FAR, for each S (n,), with joints of a length."""
    x = np.arange(0.0, LENGTH + size / 2, size)
    tau = np.repeat((PEAK + LOW * excess) / (1.0 + excess), len(x))
    law = make(np.tile(x < PATCH - 1e-9, len(excess)), tau)
    dt = COURANT * size / np.sqrt(1.0 + np.max(law.shear_stiffness) * size**2 / 4.0)
    strain, speed = np.zeros((len(tau), 2)), np.zeros((len(excess), len(x)))
    past, beyond = law.initial_history(len(tau), 2), np.tile(x > FAR, len(excess))
    for _ in range(int(np.ceil(END / dt))):
        answer = law.evaluate(strain, past)
        past = answer.history
        u = strain[:, 0].reshape(speed.shape)
        pull = np.zeros_like(u)
        pull[:, 1:-1] = u[:, 2:] - 2.0 * u[:, 1:-1] + u[:, :-2]
        pull[:, 0] = 2.0 * (u[:, 1] - u[:, 0])
        speed += dt * (pull / size**2 - (answer.traction[:, 0] - tau).reshape(u.shape))
        speed[:, -1] = 0.0
        strain[:, 0] += dt * speed.ravel()
    slid = (past["plastic_slip"][:, 0] > 0.0) & beyond
    return slid.reshape(speed.shape).any(axis=1)


def threshold(make: Make, size: float) -> float:
    """Largest S that runs away."""
    low, high = LEAST, MOST
    while high / low > CLOSE:
        tried = np.geomspace(low, high, AT_ONCE + 2)
        ran = runs_away(make, size, tried[1:-1])
        last = int(np.flatnonzero(ran)[-1]) + 1 if ran.any() else 0
        low, high = tried[last], tried[last + 1]
    return float(np.sqrt(low * high))


def warned(number: str, *settings: str) -> bool:
    """Whether the card says of the scene on joints of length 1 that a number is out of range."""
    scene = load(SCENE, list(settings))
    mesh = read_split(scene)
    card = {each.name: each for each in pre_run_checks(scene, mesh, place(scene, mesh).wells)}
    return card[number].out_of_range


def warned_of_jump(ratio: float) -> bool:
    """Of joints of h/l = ``ratio``."""
    return warned("joint length scale", f"fracture.bed.shear_stiffness={ratio**2 * (1 - 1e-9)}")


def warned_of_weakening(ratio: float) -> bool:
    """Of joints of h over sqrt(E D D_c/dtau) = ``ratio``."""
    law = "law = 'slip-weakening', normal_stiffness = 1, aperture = 10, friction_coefficient = 1"
    falls = f"dynamic_friction_coefficient = 0.6, slip_weakening_distance = {0.4 / ratio**2 * (1 + 1e-9)}"
    return warned("cohesive zone", f"fracture.bed={{{law}, shear_stiffness = 400, {falls}}}")


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s6`` and return the bars; ``small`` without the finest joints."""
    finest = 2 if small else 4
    scales = (1.0, 0.05) if small else (1.0, 0.5, 0.05)
    sizes = {scale: (0.5**n for n in range(finest + 1 + (scale == 0.5))) for scale in scales}
    drops = {s: np.array([(h / s, threshold(jump(s), h)) for h in each]) for s, each in sizes.items()}
    falls = np.array([(0.5**n, threshold(weakening(1.0), 0.5**n)) for n in range(finest + 1)])
    flags = {s: np.array([warned_of_jump(ratio) for ratio in found[:, 0]]) for s, found in drops.items()}
    flags_falls = np.array([warned_of_weakening(ratio) for ratio in falls[:, 0]])
    figure, axes = sheet(
        "S6  The load at which slip runs away along a bar, against the length of joints",
        "A drop at once is resolved on l/4, l = sqrt(E D/k_s): coarser joints set the threshold themselves, and the card warns."
        " Weakening needs a quarter of its own length.",
        [["drop", "fall"]], (10.6, 4.3), width_ratios=[1.25, 1.0],
    )  # fmt: skip
    for (scale, found), colour in zip(drops.items(), (BLUE, SKY, ORANGE), strict=False):
        _curve(axes["drop"], found, flags[scale], colour, f"l = {scale:g}")
    _curve(axes["fall"], falls, flags_falls, GREEN, "sqrt(E D $D_c$/dtau) = 1, l = 0.05")
    axes["drop"].set(xlabel="$h/l$", ylabel="largest $S$ that runs away", title="Strength drops at once", yscale="log")
    axes["fall"].set(xlabel=r"$h/\Lambda$", title="Strength falls with slip", ylim=(0.0, 7.0))
    for axis in axes.values():
        axis.set_xscale("log")
        axis.axvline(0.25, color=INK, lw=1.3, ls="--")
        axis.legend(loc="lower left" if axis is axes["fall"] else "upper right")
    note = (
        "Patch of half-length 4, bar of 24, until time 26; open marks: the card warns (dashed: from there on). Chain of"
        " nodes with the program's laws, central difference."
    )
    save(figure, folder, "s6", note)
    columns = {f"{what} l={s:g}": found[:, n] for s, found in drops.items() for n, what in enumerate(("h/l", "S"))}
    columns |= {"h/Lambda": falls[:, 0], "S weakening": falls[:, 1]}
    write_csv(folder, "s6", columns, ["scripts/figures stability --only S6"], note)
    return _checks(drops, flags, falls, flags_falls)


def _curve(axis: Axes, found: Floats, flags: np.ndarray, colour: str, label: str) -> None:
    axis.plot(*found.T, color=colour, label=label)
    axis.plot(*found[~flags].T, "o", color=colour)
    axis.plot(*found[flags].T, "o", color=colour, mfc="white")
    for ratio, value in found:
        axis.annotate(
            f"{value:.3g}", (ratio, value), (0, 6), textcoords="offset points", fontsize=7.5, color=PALE, ha="center"
        )


def _off(found: Floats) -> Floats:
    """How far each threshold is from that on the shortest joints."""
    return np.abs(found[:, 1] / found[-1, 1] - 1.0)


def _checks(
    drops: dict[float, Floats], flags: dict[float, np.ndarray], falls: Floats, flags_falls: np.ndarray
) -> list[Check]:
    resolved = {scale: found for scale, found in drops.items() if found[-1, 0] <= 0.25}
    flat = max(float(_off(found)[found[:, 0] <= 0.25].max()) for found in resolved.values())
    flat_falls = float(_off(falls)[falls[:, 0] <= 0.25].max())
    pairs = [(found, flags[scale]) for scale, found in drops.items()] + [(falls, flags_falls)]
    silent = sum(int(((_off(found) > FLAT) & ~flag).sum()) for found, flag in pairs)
    coarse = sum(int((flag != (found[:, 0] > 0.25 * (1 + 1e-6))).sum()) for found, flag in pairs)
    doubles = drops[0.05][1, 1] / drops[0.05][0, 1]
    return [
        Check("S6 drop at once, h <= l/4: off the finest", flat, f"<= {FLAT:g}", flat <= FLAT),
        Check("S6 weakening, h <= Lambda/4: off the finest", flat_falls, f"<= {FLAT:g}", flat_falls <= FLAT),
        Check("S6 off by more, and no warning", silent, "0", silent == 0),
        Check("S6 warnings where joints resolve, or none where not", coarse, "0", coarse == 0),
        Check("S6 drop at once, l = 0.05: threshold on half the joints", float(doubles), "> 1.9", bool(doubles > 1.9)),
    ]
