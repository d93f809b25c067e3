"""Pictures of a run, drawn from its folder alone: where it slipped, how fast, and where the energy went."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fracflow.output.plot_style import COLOURS, INK, PALE, plain, styled
from fracflow.output.reader import RunData, load_run_data
from fracflow.scene.quantities import QUANTITIES, OutputQuantity, probed
from fracflow.scene.units import ENERGY, LENGTH, STRESS, VELOCITY
from fracflow.storage.files import fresh, replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ENERGIES = (
    ("kinetic", "kinetic"),
    ("friction", "friction"),
    ("rock_strain", "rock strain"),
    ("joint_shear", "joint shear"),
    ("joint_normal", "joint normal"),
    ("viscous", "viscous"),
    ("radiated", "radiated"),
    ("damping", "damped at faults"),
)
_MAX_LINES = 7
_MOST_FIRST = 5  # more than these at once show no place of the onset


def draw(folder: str | Path) -> list[Path]:
    """Draw ``pictures/overview.png`` and ``pictures/probes.png`` of a run and return their paths.

    The second is left out if the run has no probes. Raises InputError if the folder has no history.
    """
    run = load_run_data(folder)
    pictures = Path(folder) / "pictures"
    pictures.mkdir(exist_ok=True)
    with styled():
        drawn = {"overview": _overview(run), "probes": _probes(run)}
        paths = [_save(figure, pictures / f"{name}.png") for name, figure in drawn.items() if figure]
    return paths


def _save(figure: Figure, path: Path) -> Path:
    with replacing(path) as part:
        figure.savefig(fresh(part), format="png")
    return path


def _overview(run: RunData) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, _height(run)), layout="constrained")
    axes = figure.subplot_mosaic([["map", "slip"], ["map", "energy"], ["map", "pressure"]], width_ratios=[1.15, 1])
    _draw_head(figure, run.title, run.account)
    _draw_map(axes["map"], run)
    _draw_probes(axes["slip"], run, QUANTITIES["slip"], "Slip at the probes")
    _draw_energy(axes["energy"], run)
    if not _draw_pressure_profiles(axes["pressure"], run):
        _draw_probes(axes["pressure"], run, QUANTITIES["pressure"], "Pressure at the probes")
    return figure


def _draw_probes(axes: Axes, run: RunData, row: OutputQuantity, title: str) -> None:
    lines = {name: run.probe(name, row.name) for name in run.probes_with(row.name)}
    _draw_lines(axes, run, lines, title, row.axis, row.dimension, run.settled)


def _draw_head(figure: Figure, title: str, below: str) -> None:
    """The title, and a smaller line under it."""
    from matplotlib.text import Annotation

    head = figure.suptitle(f"{plain(title)}\n", fontsize=13, fontweight="bold", x=0.01, ha="left")
    place = dict(xy=(0.0, 0.0), xycoords=head, xytext=(0.0, 2.0), textcoords="offset points")
    figure.add_artist(Annotation(plain(below), **place, fontsize=9, annotation_clip=False))  # type: ignore[arg-type]


def _height(run: RunData) -> float:
    """Height in inches of a map as wide as its column, within the limits of the panels beside it."""
    if not run.rock:
        return 7.4
    wide, high = np.ptp(np.concatenate([cell.reshape(-1, 2) for cell in run.rock]), axis=0)
    return float(np.clip(5.2 * high / max(wide, 1e-300) + 2.2, 6.2, 7.6))


_SCALED = {
    STRESS: ((1e6, "MPa"), (1e3, "kPa")),
    ENERGY: ((1e6, "MJ/m"), (1e3, "kJ/m")),
    LENGTH: ((1e-1, ""), (1e-3, "mm"), (1e-6, "µm")),
    VELOCITY: ((1e-1, ""), (1e-3, "mm/s")),
}
"""Dimension -> sizes in SI from which on numbers are drawn in a unit, "" for that of the run; the largest first."""


def _unit(run: RunData, word: str, dimension: str, largest: float) -> tuple[float, str]:
    """Factor and axis label: in MPa, MJ and mm where the run is in SI and its numbers call for it."""
    if (run.units.get("length"), run.units.get("force")) == ("m", "N") and 0.0 < largest < np.inf:
        for size, unit in _SCALED.get(dimension, ()):
            if largest >= size:
                return (1.0 / size, f"{word} [{unit}]") if unit else (1.0, run.label(word, dimension))
    return 1.0, run.label(word, dimension)


def _draw_map(axes: Axes, run: RunData) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    fractures = run.fractures
    axes.set_title(f"Where the rock slipped, until {run.at(fractures.time)}" if fractures else "Where the rock slipped")
    axes.grid(False)
    axes.set_aspect("equal", anchor="N")
    if run.rock is not None:
        look = dict(facecolors="#f4f1ea", edgecolors="#dcd6c8", linewidths=0.25)
        axes.add_collection(PolyCollection(run.rock, **look))  # type: ignore[arg-type]
    if fractures is not None and len(fractures.segments):
        ends = fractures.segments
        axes.add_collection(LineCollection(list(ends), colors=INK, linewidths=1.0))
        slip = np.abs(fractures.on_segments("plastic_slip"))
        top = slip.max(initial=0.0)
        if top == 0.0:
            since = run.slipped_since() if run.is_behind else []
            later = f"; {len(since)} {'has' if len(since) == 1 else 'have'} since" if since else ""
            axes.set_title(f"The fractures: none had slipped at {run.at(fractures.time)}{later}")
        else:
            share = slip / top
            moved = share > 1e-6
            lines = LineCollection(
                list(ends[moved]), cmap="viridis_r", linewidths=(2.0 + 6.0 * share[moved]), capstyle="round"
            )
            factor, label = _unit(run, f"plastic slip at {run.at(fractures.time)}", LENGTH, top)
            lines.set_array(factor * slip[moved])
            lines.set_clim(0.0, factor * top)
            axes.add_collection(lines)
            look = dict(location="bottom", shrink=0.7, aspect=40, pad=0.02, panchor=False)
            bar = axes.figure.colorbar(lines, ax=axes, label=label, **look)  # type: ignore[arg-type]
            _tidy_numbers(bar.ax)
        for name, (x, y) in fractures.label_places().items():
            _tag(axes, name, x, y, (0, 0), color="#5a5a5a", ha="center", va="center")
    _draw_marks(axes, run)
    axes.autoscale_view()
    axes.margins(0.03)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel(run.label("x", LENGTH))
    axes.set_ylabel(run.label("y", LENGTH))


def _draw_marks(axes: Axes, run: RunData) -> None:
    first = run.first_events()
    if 0 < len(first) <= _MOST_FIRST:
        x, y = np.array([(event["x"], event["y"]) for event in first]).T
        axes.plot(x, y, "*", ms=11, mfc="#D55E00", mec="white", mew=0.8, zorder=6.5, label="slipped first")
    looks = ((run.wells, "v", "#56B4E9", "well", 11), (run.probes, "o", "white", "probe", 5))
    for places, marker, colour, label, size in looks:
        if places:
            x, y = np.array(list(places.values())).T
            axes.plot(x, y, marker, ms=size, mfc=colour, mec=INK, mew=0.9, ls="", zorder=6, label=label)
    names: dict[tuple[float, float], list[str]] = {}
    for name, place in [*run.probes.items(), *run.wells.items()]:
        there = names.setdefault(place, [])
        there += [] if name in there else [name]
    for (x, y), found in names.items():
        _tag(axes, ", ".join(found), x, y, (9, 0), va="center")
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure = axes.get_figure()
        assert figure is not None
        figure.legend(handles, labels, loc="outside lower left", ncols=3, handletextpad=0.3)


def _tag(axes: Axes, text: str, x: float, y: float, shift: tuple[float, float], **how: str) -> None:
    import matplotlib.patheffects as effects

    halo = [effects.withStroke(linewidth=2.5, foreground="white")]
    place = dict(xy=(x, y), xytext=shift, textcoords="offset points", fontsize=7.5, zorder=7)
    axes.annotate(plain(text), path_effects=halo, **place, **how)  # type: ignore[arg-type]


def _draw_lines(
    axes: Axes,
    run: RunData,
    lines: dict[str, np.ndarray],
    title: str,
    word: str,
    dimension: str,
    span: slice = slice(None),
) -> None:
    """Histories, named at their right ends; the largest ones if there are many."""
    axes.set_title(title)
    x, x_label = run.axis(span)
    ranked = sorted(lines, key=lambda name: -np.ptp(np.nan_to_num(lines[name][span])))[:_MAX_LINES]
    shown = [name for name in lines if name in ranked]
    if not shown or len(x) == 0:
        _say_nothing(axes)
        return
    if len(shown) < len(lines):
        axes.set_title(f"{title} (the {len(shown)} that change most)")
    largest = max(float(np.abs(np.nan_to_num(lines[name][span])).max()) for name in shown)
    factor, label = _unit(run, word, dimension, largest)
    drawn = {name: factor * lines[name][span] for name in shown}
    for (_, values), colour in zip(drawn.items(), COLOURS, strict=False):
        axes.plot(x, values, color=colour, marker="." if len(x) == 1 else "")
    axes.margins(x=0.0)
    axes.set_xlabel(x_label)
    axes.set_ylabel(label)
    _tidy_numbers(axes)
    _name_ends(axes, [(name, float(np.nan_to_num(values[-1]))) for name, values in drawn.items()])


def _tidy_numbers(axes: Axes) -> None:
    axes.ticklabel_format(axis="both", scilimits=(-2, 4), useMathText=True)
    axes.locator_params(axis="both", nbins=6)


def _name_ends(axes: Axes, ends: list[tuple[str, float]]) -> None:
    """Name lines beside their last values, together where these coincide, else moved apart."""
    low, high = axes.get_ylim()
    heights = [(value - low) / (high - low) for _, value in ends]
    groups: list[list[int]] = []
    for i in sorted(range(len(ends)), key=heights.__getitem__):
        if groups and heights[i] - heights[groups[-1][0]] < 0.01:
            groups[-1].append(i)
        else:
            groups.append([i])
    gap = min(0.12, 1.0 / max(1, len(groups)))
    spread = np.array([heights[group[0]] for group in groups])
    for i in range(1, len(spread)):
        spread[i] = max(spread[i], spread[i - 1] + gap)
    spread -= max(0.0, spread[-1] - 1.0)
    for i in range(len(spread) - 2, -1, -1):
        spread[i] = min(spread[i], spread[i + 1] - gap)
    for group, y in zip(groups, spread, strict=True):
        colour = COLOURS[group[0]] if len(group) == 1 else INK
        names = [plain(ends[i][0]) for i in sorted(group)]
        line = dict(arrowstyle="-", color=colour, lw=0.7, shrinkA=0, shrinkB=0)
        axes.annotate(
            ",\n".join(", ".join(names[k : k + 2]) for k in range(0, len(names), 2)), (1.0, heights[group[0]]), (1.03, y),
            "axes fraction", "axes fraction", arrowprops=line, color=colour, fontsize=8, va="center", annotation_clip=False,
        )  # fmt: skip


def _say_nothing(axes: Axes, text: str = "none in this run") -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=PALE)
    axes.set_xticks([])
    axes.set_yticks([])


def _draw_energy(axes: Axes, run: RunData) -> None:
    start = run.start
    keys = {label: f"energy/{key}" for key, label in _ENERGIES if f"energy/{key}" in run.history}
    changes = {label: run.history[key] - run.history[key][start] for label, key in keys.items()}
    scale = max((np.abs(values[start:]).max() for values in changes.values()), default=0.0)
    lines = {label: v for label, v in changes.items() if np.abs(v[start:]).max() > 1e-3 * scale}
    settled = "Energy since equilibrium" if start else "Energy since the start"
    title = "Energy since the dynamics began" if run.has_dynamics else settled
    _draw_lines(axes, run, lines, title, "change", ENERGY, slice(start, None))
    if lines:
        axes.axhline(0.0, color=PALE, lw=0.8, zorder=1)


def _draw_pressure_profiles(axes: Axes, run: RunData) -> bool:
    """Pressure along each fracture, in the first fields written (dashed) and the last; False if there is no fluid."""
    fractures = run.fractures
    if fractures is None or not fractures.has("pressure"):
        return False
    first = f"{run.at(fractures.begins)} (dashed) and " if fractures.has_before else ""
    axes.set_title(f"Pressure along the fractures at {first}{run.at(fractures.time)}")
    profiles = fractures.profiles("pressure", _MAX_LINES)
    largest = max((float(np.abs(after).max()) for _, _, after in profiles.values()), default=0.0)
    factor, label = _unit(run, QUANTITIES["pressure"].axis, STRESS, largest)
    for (name, (along, before, after)), colour in zip(profiles.items(), COLOURS, strict=False):
        if before is not None:
            axes.plot(along, factor * before, color=colour, lw=1.0, ls=(0, (4, 2)), alpha=0.7)
        axes.plot(along, factor * after, color=colour)
        _tag(axes, name, along[-1], factor * after[-1], (4, 2), color=colour)
    axes.set_xlabel(run.label("distance along the fracture", LENGTH))
    axes.set_ylabel(label)
    _tidy_numbers(axes)
    axes.margins(x=0.0)
    return True


def _probes(run: RunData) -> Figure | None:
    from matplotlib.figure import Figure

    shown = [row for row in probed().values() if row.drawn and run.probes_with(row.name)]
    if not shown:
        return None
    rows = -(-len(shown) // 2)
    figure = Figure(figsize=(12, 0.6 + 2.5 * rows), layout="constrained")
    _draw_head(figure, f"{run.title}: probes", run.account.partition(". Map")[0])
    grid = figure.subplots(rows, 2, squeeze=False).ravel()
    for axes, row in zip(grid, shown, strict=False):
        _draw_probes(axes, run, row, row.axis.capitalize())
    for axes in grid[len(shown) :]:
        axes.remove()
    return figure
