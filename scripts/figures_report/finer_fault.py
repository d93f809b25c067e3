"""Figs. 16 to 19: application 5.4, the fault of 5.3 on a finer mesh, and joints that do not lock."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from sheets import GREEN, HALO, INK, NODE_COLOURS, ORANGE, PALE, PINK, STYLE, Check, Floats, save, sheet, write_csv

from figures_report.common import RECONSTRUCTED, Run, Runner, command, dynamic, name_ends, phases, probe, slipped, thick
from figures_report.setup_panel import draw_setup

SCENE = "report_5_4"
NODES = tuple(f"node{i}" for i in range(1, 6))
ROCK = ("node6", "node7", "node8", "node10")  # those that the report plots
RULES = {"nodal": "at the nodes (2.30)", "gauss2": "two Gauss points", "one-point": "one point"}
# ten times the report's stiffness: a tenth of the joint's own swing
STIFF = ("fracture.fault.shear_stiffness=1e9", "stage.failure.steps=60")
SHEAR_STIFFNESS = 1e8
GIVEN = ("model=report", "method.quadrature=nodal")
WIDE = (
    "model=report", "fracture.fault.aperture=1", "control.pumping.increment=1e6", "stage.failure.time_step=0.001",
    "stage.failure.steps=150",
)  # fmt: skip
WALLS = float(np.sqrt(2.0 * 1e8 * 1000.0 / (5.12 * 0.5e6)) / (2.0 * np.pi))
"""Frequency at which the two walls of a node swing against each other on k_n L, of masses rho times half a quad."""
NOTE = (
    f"{RECONSTRUCTED} Mesh, supports, wells and their raise, and which rock points (R). model = report, time step 0.01."
)


def draw(folder: Path, run: Runner) -> list[Check]:
    """Draw the four figures into ``folder`` and return their checks."""
    rules = {rule: run(SCENE, "model=report", f"method.quadrature={rule}") for rule in RULES}
    stiff = {rule: run(SCENE, "model=report", f"method.quadrature={rule}", *STIFF) for rule in RULES}
    nodal = rules["nodal"]
    with matplotlib.rc_context(STYLE):
        return [
            *displacements(folder, nodal), *larger_scale(folder, nodal, run(SCENE, *WIDE)), *in_the_rock(folder, nodal),
            *not_locking(folder, rules, stiff),
        ]  # fmt: skip


def displacements(folder: Path, run: Run) -> list[Check]:
    """Fig. 16: set-up, and u_y of nodes 1 and 2."""
    figure, axes = sheet(
        "Fig. 16  The same fault on a finer mesh, stick-slip ratio 0.99",
        "A smaller drop of strength: node 2 slips, sets off node 1 at the fault's end, and slips once more.",
        [["mesh", "pressure", "u"]], (11.4, 4.9), width_ratios=[1.5, 0.8, 3.2],
    )  # fmt: skip
    draw_setup(axes["mesh"], axes["pressure"], SCENE, run, {"node2": 1.0, "node4": -1.0})
    _histories(axes["u"], run, NODES[:2])
    axes["u"].set_title("displacement of nodes 1 and 2; thick: slipping")
    _save(figure, folder, "fig_16", run, NODES[:2])
    found = slipped(run)
    first = min((event["start"], event["probe"]) for event in run.events)[1]
    return [
        Check("16 nodes that slip", " ".join(sorted(found)), "1 and 2, which it plots", found == {"node1", "node2"}),
        Check("16 slips first", first, "node2: the injection", first == "node2"),
    ]


def larger_scale(folder: Path, run: Run, wide: Run) -> list[Check]:
    """Fig. 17: u_y of nodes 1, 2, 3, and how 2 and 4 answer in x to the last step of the pressure.

    A film of 0.01 ft lets its walls part only as fast as fluid comes, so they creep. The report saw them vibrate: so
    they do in a film that is wide enough to fill at once, whose wall motion has no weight in the flow.
    """
    figure, axes = sheet(
        "Fig. 17  Displacements of the fault, in a larger scale",
        "Left: along it. Right: across it, the last raise of the pressure sets 2 and 4 vibrating if the film fills at once.",
        [["u", "x"]], (11.4, 4.4), width_ratios=[1.35, 1],
    )  # fmt: skip
    _histories(axes["u"], run, NODES[:3], until=1.0)
    axes["u"].set_title("$u_y$ of nodes 1, 2, 3; thick: slipping")
    amplitude, turns, ends, columns = {}, 0, [], {}
    for film, look in ((wide, dict(lw=1.2)), (run, dict(lw=1.6, ls=(0, (4, 2))))):
        time, rows = film.history["time"], dynamic(film)
        shown = rows & (time <= 0.12 + 1e-9)
        columns[f"time ({'wide' if film is wide else 'given'} film)"] = time[shown]
        for name, colour in zip(NODES, NODE_COLOURS, strict=False):
            opening = probe(film, name, "opening") - probe(film, name, "opening")[rows][0]
            columns[f"opening {name} ({'wide' if film is wide else 'given'} film)"] = opening[shown]
            if name in ("node2", "node3", "node4"):
                axes["x"].plot(time[shown], 1e6 * opening[shown], color=colour, **look)
            if film is wide:
                amplitude[name] = 0.5 * float(np.ptp(opening[rows]))
                if name == "node2":
                    turns = int((np.diff(np.sign(np.diff(opening[rows]))) != 0).sum())
                    last = float(time[-1] - time[rows][0])
                if name in ("node2", "node3", "node4"):
                    middle = 0.5e6 * float(opening[rows].max() + opening[rows].min())
                    ends.append((name.removeprefix("node"), middle, colour))
    axes["x"].set(title="opening: full, film of 1 ft; dashed, of 0.01 ft as given", xlabel="time [s]")
    axes["x"].set_ylabel("jump of $u_x$ since failure [10$^{-6}$ ft]")
    axes["x"].margins(x=0)
    name_ends(axes["x"], ends)
    save(figure, folder, "fig_17", f"{NOTE[:-1]}, in the film of 1 ft 0.001.")
    columns = {
        "time": run.history["time"],
        **{f"u_y {n}": probe(run, n, "displacement")[:, 1] for n in NODES[:3]},
    } | columns
    write_csv(folder, "fig_17", columns, [command(SCENE, *GIVEN), command(SCENE, *WIDE)], NOTE)
    both = (amplitude["node2"], amplitude["node4"])
    others = max(amplitude[name] for name in ("node1", "node3", "node5"))
    frequency = 0.5 * turns / last
    return [
        Check("17 vibration in x at 2 and 4, against 1, 3, 5", min(both) / others, "> 1.9: 1 and 5 feel half",
              min(both) > 1.9 * others),
        Check("17 its amplitude at 2 over that at 4", both[0] / both[1], "1 to 1 %", abs(both[0] / both[1] - 1.0) < 0.01),
        Check("17 its frequency [Hz]", frequency, f"{WALLS:.1f} to 5 %: two walls on k_n",
              abs(frequency / WALLS - 1.0) < 0.05),
    ]  # fmt: skip


def in_the_rock(folder: Path, run: Run) -> list[Check]:
    """Fig. 18: u_y of points within the rock."""
    figure, axes = sheet(
        "Fig. 18  Displacements within the elastic rock",
        "Half way between the fault and the fixed face the rock follows the slip, late and by a part, and rings on.",
        [["u"]], (8.4, 4.4),
    )  # fmt: skip
    main = axes["u"]
    time, rows = run.history["time"], dynamic(run)
    for name, beside in zip(("node1", "node2"), (PALE, "#bdbdbd"), strict=True):
        main.plot(time[rows], probe(run, name, "displacement")[rows, 1], color=beside, lw=1.0, ls=(0, (4, 2)))
    _histories(main, run, ROCK)
    for name in ("node1", "node2"):
        end = float(probe(run, name, "displacement")[-1, 1])
        main.text(2.95, end + 1e-4, f"{name[-1]}, on the fault", color=PALE, fontsize=8, ha="right", path_effects=HALO)
    main.set_title("$u_y$ of rock points 6, 7, 8, 10 (R), beside nodes 1, 2, 3, 5")
    _save(figure, folder, "fig_18", run, ROCK)
    u = {name: probe(run, name, "displacement")[rows, 1] for name in (*ROCK, "node1", "node2")}
    start = {name: u[name][0] for name in u}
    rest = {name: float(u[name][-150:].mean() - start[name]) for name in u}
    shares = [rest["node6"] / rest["node1"], rest["node7"] / rest["node2"]]
    lag = _arrival(u["node7"] - start["node7"]) - _arrival(u["node2"] - start["node2"])
    return [
        Check("18 rock at 6, 7 follows nodes 1, 2 by", f"{shares[0]:.2f}, {shares[1]:.2f}", "a part: 0 to 1",
              all(0.0 < share < 1.0 for share in shares)),
        Check("18 node 7 moves after node 2 by [steps]", float(lag), "> 0", lag > 0),
    ]  # fmt: skip


def not_locking(folder: Path, rules: dict[str, Run], stiff: dict[str, Run]) -> list[Check]:
    """Fig. 19: the tangential jump at fault nodes with three rules of integration."""
    figure, axes = sheet(
        "Fig. 19  Joints integrated at points that mix two nodes do not lock",
        "Slip at fault nodes 1 and 2. Judged at the nodes it stays where it stopped; at Gauss points, or one, it runs back.",
        [list(RULES)], (11.4, 4.4), sharey=True,
    )  # fmt: skip
    columns: dict[str, Floats] = {}
    for (rule, said), run in zip(RULES.items(), rules.values(), strict=True):
        time, jumps = run.history["time"][dynamic(run)], nodal_jumps(run)
        main = axes[rule]
        columns[f"{rule}: time"] = time
        for name, colour in zip(NODES[:2], NODE_COLOURS, strict=False):
            main.plot(time, 1e3 * jumps[name], color=colour, lw=1.8)
            columns[f"{rule}: jump {name}"] = jumps[name]
        largest = max(np.abs(jump).max() for jump in jumps.values())
        name, back = max(((name, backward(jump)) for name, jump in jumps.items()), key=lambda item: item[1][0])
        main.set_title(f"{said}: back by {100 * back[0] / largest:.2g} %")
        jump = jumps[name]
        top = int(jump.argmax())
        bottom = top + int(np.argmax(jump[top] - jump[top:] >= 0.95 * (jump[top] - jump[top:].min())))
        for low, high in ((back[1], back[2]), (top, bottom)):
            if jump[low] - jump[high] > 0.01 * largest:
                _arrow(main, time, 1e3 * jump, low, high)
        main.set_xlabel("time [s]")
        main.margins(x=0)
    for rule, run in rules.items():
        jumps = nodal_jumps(run)
        name_ends(
            axes[rule], [(n[-1], 1e3 * float(jumps[n][-1]), c) for n, c in zip(NODES[:2], NODE_COLOURS, strict=False)]
        )
    axes["nodal"].set_ylabel("slip at the node [10$^{-3}$ ft]")
    commands = [command(SCENE, "model=report", f"method.quadrature={rule}") for rule in RULES]
    save(figure, folder, "fig_19", NOTE)
    write_csv(folder, "fig_19", columns, commands, NOTE)
    found = {rule: share_back(nodal_jumps(run)) for rule, run in rules.items()}
    found_stiff = {rule: share_back(nodal_jumps(run)) for rule, run in stiff.items()}
    peaks = {rule: share_back(nodal_jumps(run), after_maximum=True) for rule, run in rules.items()}
    inelastic = share_back(nodal_jumps(rules["nodal"], SHEAR_STIFFNESS))
    return [
        Check("19 slip runs back, Gauss", found["gauss2"], "> 0.05 of the largest", found["gauss2"] > 0.05),
        Check("19 slip runs back, one point", found["one-point"], "> 0.05", found["one-point"] > 0.05),
        Check("19 after its maximum, Gauss", peaks["gauss2"], "> 0.05", peaks["gauss2"] > 0.05),
        Check("19 after its maximum, one point", peaks["one-point"], "> 0.05", peaks["one-point"] > 0.05),
        Check("19 slip runs back, nodal, spring's swing f_s/k_s taken off", inelastic, "< 0.001", inelastic < 0.001),
        Check("19 the same with that swing", found["nodal"], "< 0.005: E'/(k_s h)", found["nodal"] < 0.005),
        *(
            Check(f"19 slip runs back, k_s x 10, {rule}", share, "< 0.001" if rule == "nodal" else "> 0.05",
                  share < 0.001 if rule == "nodal" else share > 0.05)
            for rule, share in found_stiff.items()
        ),
    ]  # fmt: skip


def _arrow(axes: matplotlib.axes.Axes, time: Floats, jump: Floats, low: int, high: int) -> None:
    x = time[high] + 0.07
    for row in (low, high):
        axes.plot([time[row], x], [jump[row]] * 2, color=INK, lw=0.8, ls=":")
    look = dict(arrowstyle="-|>", color=INK, lw=1.2, shrinkA=0, shrinkB=0, mutation_scale=9)
    axes.annotate("", (x, jump[high]), (x, jump[low]), arrowprops=look)


def nodal_jumps(run: Run, shear_stiffness: float = np.inf) -> dict[str, Floats]:
    """Tangential jump at the fault nodes, positive in the direction of its largest value, since the dynamics began.

    The joint's own spring gives f_s / k_s of it, which is taken off if k_s is given; that holds at the nodal rule,
    whose tractions are those at the nodes.
    """
    rows = dynamic(run)
    jumps = {}
    for name in NODES:
        jump = (probe(run, name, "displacement") - probe(run, name, "displacement_bottom"))[rows, 1]
        jump = jump - probe(run, name, "shear_traction")[rows] / shear_stiffness
        jump = jump - jump[0]
        jumps[name] = jump * np.sign(jump[np.abs(jump).argmax()] or 1.0)
    return jumps


def backward(jump: Floats) -> tuple[float, int, int]:
    """How far a jump goes back from the largest value it had before, and the rows between which it does."""
    falls = np.maximum.accumulate(jump) - jump
    end = int(falls.argmax())
    return float(falls[end]), int(jump[: end + 1].argmax()), end


def share_back(jumps: dict[str, Floats], after_maximum: bool = False) -> float:
    """The farthest way back at any node, or back from a node's largest jump, over the largest jump at any node."""
    ways = [
        float(jump.max() - jump[jump.argmax() :].min()) if after_maximum else backward(jump)[0]
        for jump in jumps.values()
    ]
    return max(ways) / max(float(np.abs(jump).max()) for jump in jumps.values())


def _arrival(displacement: Floats) -> int:
    """First row with a hundredth of the largest displacement."""
    return int(np.argmax(np.abs(displacement) > 0.01 * np.abs(displacement).max()))


def _histories(axes: matplotlib.axes.Axes, run: Run, names: tuple[str, ...], until: float = np.inf) -> None:
    time = run.history["time"]
    rows = dynamic(run) & (time <= until + 1e-9)
    colours = (*NODE_COLOURS[:3], PINK) if names != ROCK else (NODE_COLOURS[0], ORANGE, GREEN, PINK)
    ends = []
    for name, colour in zip(names, colours, strict=False):
        u = probe(run, name, "displacement")[rows, 1]
        thick(axes, time[rows], u, phases(run, name), colour)
        ends.append((name.removeprefix("node"), float(u[-1]), colour))
    axes.set(xlabel="time [s]", ylabel="$u_y$ [ft]")
    axes.margins(x=0)
    name_ends(axes, ends)


def _save(
    figure: matplotlib.figure.Figure, folder: Path, name: str, run: Run, names: tuple[str, ...],
    more: dict[str, Floats] | None = None,
) -> None:  # fmt: skip
    save(figure, folder, name, NOTE)
    columns = {"time": run.history["time"], **{f"u_y {n}": probe(run, n, "displacement")[:, 1] for n in names}}
    write_csv(folder, name, columns | (more or {}), [command(SCENE, "model=report", "method.quadrature=nodal")], NOTE)
