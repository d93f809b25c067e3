"""Figs. 12, 13, 14: application 5.2, a block between two joints that is pushed and left alone."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from sheets import AMBER, BLUE, GREEN, HALO, INK, ORANGE, PALE, STYLE, Check, Floats, plain, save, sheet, write_csv

from figures_report.common import RECONSTRUCTED, Run, Runner, command, energy, phases, probe, shade

SCENE = "report_5_2"
PLASTIC, LINEAR = ("model=report",), ("model=report", "fracture.default.law=linear")
END_OF_LOAD, SETTLED = 3.4, 9.0
FORCE = ((0, 0), (0.1, 2), (1.6, 2), (1.7, 0), (1.8, -2), (3.3, -2), (3.4, 0))  # (R), the scene's
NOTE = f"{RECONSTRUCTED} $k_{{s0}}$ = 1/2 (R), force (R). Time step 0.1, trapezoidal rule."


def draw(folder: Path, run: Runner) -> list[Check]:
    """Draw the three figures into ``folder`` and return their checks."""
    plastic, linear = run(SCENE, *PLASTIC), run(SCENE, *LINEAR)
    with matplotlib.rc_context(STYLE):
        return [*displacement(folder, plastic, linear), *force(folder, plastic), *energies(folder, plastic)]


def displacement(folder: Path, plastic: Run, linear: Run) -> list[Check]:
    """Fig. 12."""
    time = plastic.history["time"]
    u, elastic = (probe(run, "block", "displacement")[:, 0] for run in (plastic, linear))
    late = time > SETTLED
    centre, amplitude = swing(time[late], u[late])
    free = time > END_OF_LOAD + 1e-9
    largest = float(np.abs(elastic[free]).max())
    figure, axes = sheet(
        "Fig. 12  Displacement of a block between two joints",
        "Pushed for 3.4 s, then free. Slip leaves it displaced for good; it swings elastically about its new place.",
        [["force"], ["u"]], (8.4, 5.0), height_ratios=[1, 4.2], sharex=True,
    )  # fmt: skip
    axes["force"].fill_between(*np.array(FORCE).T, color="#c9d6df", lw=0)
    axes["force"].plot(*np.array(FORCE).T, color=INK, lw=1)
    axes["force"].set_ylabel("force (R)")
    axes["force"].set_yticks([-2, 0, 2])
    main = axes["u"]
    shade(main, phases(plastic, "lower joint"))
    main.plot(time, elastic, color=BLUE, lw=1.2, ls=(0, (5, 2)), label="linear joints")
    main.plot(time, u, color=ORANGE, lw=2, label="elastic-plastic joints")
    main.axhline(centre, color=ORANGE, lw=0.8, ls=":")
    main.axhline(0, color=PALE, lw=0.8)
    for value, base, colour, text in (
        (largest, 0.0, BLUE, f"{largest:.2f}"), (centre + amplitude, centre, ORANGE, f"{amplitude:.2f}"),
    ):  # fmt: skip
        x = time[-1] + 0.35 + (0.9 if colour == ORANGE else 0.0)
        main.annotate("", (x, value), (x, base), arrowprops=dict(arrowstyle="<->", color=colour, shrinkA=0, shrinkB=0))
        main.text(x + 0.12, 0.5 * (value + base), text, color=colour, va="center", fontsize=8.5)
    main.text(10.25, centre + 0.12, "new rest position", color=ORANGE, fontsize=7.5, path_effects=HALO)
    main.set(xlabel="time", ylabel="displacement", xlim=(0, time[-1] + 2.2))
    main.legend(loc="upper right", ncols=3, bbox_to_anchor=(0.95, 1.13), borderaxespad=0)
    save(figure, folder, "fig_12", NOTE)
    columns = {"time": time, "displacement": u, "displacement of linear joints": elastic}
    write_csv(folder, "fig_12", columns, [command(SCENE, *PLASTIC), command(SCENE, *LINEAR)], NOTE)
    return [
        Check("12 amplitude, linear joints", largest, "4.3, as printed", round(largest, 1) == 4.3),
        Check("12 amplitude, elastic-plastic", amplitude, "2 to 2e-3", abs(amplitude - 2.0) < 2e-3),
        Check("12 permanent displacement", centre, "not zero: > 1", abs(centre) > 1.0),
    ]


def force(folder: Path, plastic: Run) -> list[Check]:
    """Fig. 13: two joints of length 1, strength 1 and stiffness 1/2 each."""
    time, u = plastic.history["time"], probe(plastic, "block", "displacement")[:, 0]
    lower, upper = (probe(plastic, f"{side} joint", "shear_traction") for side in ("lower", "upper"))
    total = lower - upper  # on the block; the upper joint has it on its other side
    plastic_slip = probe(plastic, "lower joint", "plastic_slip")
    off = float(np.abs(total - (u - plastic_slip)).max())
    figure, axes = sheet(
        "Fig. 13  Internal shear force in the joints against displacement",
        "Elastic lines of slope $2 k_s$ = 1 between the strengths ±2: each slip shifts the line to a new rest position.",
        [["f"]], (7.0, 4.8),
    )  # fmt: skip
    main = axes["f"]
    for level in (-2, 2):
        main.axhline(level, color=INK, lw=0.8, ls=(0, (4, 3)))
    main.text(u.min(), 2.06, "strength 2 = two joints of $f_{sy}$ = 1", fontsize=8, va="bottom")
    main.plot(u, total, color="#cccccc", lw=1.0)
    points = main.scatter(u, total, c=time, s=11, cmap="viridis", zorder=3, linewidths=0)
    rest = u[-1] - total[-1]
    main.plot(0, 0, "o", mfc="white", mec=INK, ms=7, zorder=4)
    main.annotate("start", (0, 0), (8, -12), textcoords="offset points", fontsize=8)
    main.plot(rest, 0, "s", mfc="white", mec=ORANGE, mew=1.5, ms=7, zorder=4)
    main.annotate(f"rest at {rest:.2f}", (rest, 0), (8, -12), textcoords="offset points", fontsize=8, color=ORANGE)
    main.set(xlabel="displacement of the block", ylabel="shear force", ylim=(-2.6, 2.6))
    figure.colorbar(points, ax=main, label="time", aspect=35)
    save(figure, folder, "fig_13", NOTE)
    columns = {"time": time, "displacement": u, "force": total, "plastic slip": plastic_slip}
    write_csv(folder, "fig_13", columns, [command(SCENE, *PLASTIC)], NOTE)
    peak = float(np.abs(total).max())
    return [
        Check("13 largest shear force", peak, "2: the strength of two joints", abs(peak - 2.0) < 1e-9),
        Check("13 distance from slope 1 between slips", off, "< 1e-9", off < 1e-9),
    ]


def energies(folder: Path, plastic: Run) -> list[Check]:
    """Fig. 14."""
    time = plastic.history["time"]
    parts = {
        "dissipated $E_D$": energy(plastic, "friction"),
        "strain $U$": energy(plastic, "joint_shear", "joint_normal"),
        "kinetic $E_K$": energy(plastic, "kinetic"),
    }
    total = np.sum(list(parts.values()), axis=0)
    after = total[time >= END_OF_LOAD - 1e-9]
    figure, axes = sheet(
        "Fig. 14  Strain, kinetic and dissipated energy of the block",
        "After the force has gone, at 3.4 s, the three add up to one constant: (5.1) with $E_0$ = 8.",
        [["e"]], (8.4, 4.4),
    )  # fmt: skip
    main = axes["e"]
    main.stackplot(time, *parts.values(), labels=parts, colors=[AMBER, GREEN, BLUE], alpha=0.85, lw=0)
    main.plot(time, total, color=INK, lw=1.4)
    main.axvline(END_OF_LOAD, ymax=8 / 9.4, color=INK, lw=0.8, ls=":")
    main.text(END_OF_LOAD + 0.15, 0.35, "force gone", fontsize=8, color="white")
    main.text(
        time[-1], total[-1] + 0.15, f"$E_D + E_K + U$ = {total[-1]:.2f}", ha="right", fontsize=9, fontweight="bold"
    )
    main.set(xlabel="time", ylabel="energy", xlim=(0, time[-1]), ylim=(0, 9.4))
    main.grid(False)
    main.legend(loc="upper left", ncols=3)
    save(figure, folder, "fig_14", NOTE)
    columns = {"time": time, **{plain(key): values for key, values in parts.items()}, "sum": total}
    write_csv(folder, "fig_14", columns, [command(SCENE, *PLASTIC)], NOTE)
    drift = float(np.ptp(after) / after[0])
    return [
        Check(
            "14 total energy after the force", float(after[-1]), "8 to 1 %", bool(np.all(np.abs(after - 8.0) < 0.08))
        ),
        Check("14 its drift", drift, "< 1e-9", drift < 1e-9),
    ]


def swing(time: Floats, values: Floats) -> tuple[float, float]:
    """Centre and amplitude of the free oscillation, of the trapezoidal rule's frequency at K = m = 1."""
    dt = time[1] - time[0]
    phase = 2.0 / dt * np.arctan(0.5 * dt) * time
    basis = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    centre, a, b = np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(centre), float(np.hypot(a, b))
