"""Pictures of a run, drawn from its folder alone: where it slipped, how fast, and where the energy went."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow.output.drawing.axes import Axis, Floats, axis_of
from fracflow.output.drawing.labels import beside_trace, placed
from fracflow.output.drawing.network_map import (
    FLAT,
    FLATTEST,
    Network,
    coloured,
    draw_map,
    name_all,
    name_size,
    plain_numbers,
    scaled,
    write_name,
)
from fracflow.output.plot_style import COLOURS, INK, PALE, draw_head, plain, save, styled
from fracflow.output.reader import Abscissa, RunData, load_run_data
from fracflow.scene.quantities import QUANTITIES, OutputQuantity, probed
from fracflow.scene.units import ENERGY, FLOW_RATE, LENGTH, STRESS, VELOCITY

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
    ("leak_off", "leak-off"),
    ("damping", "damped at faults"),
)
_OF_WELLS = (("pressure", STRESS), ("rate", FLOW_RATE), ("volume", "length**3"))
_MOTIONS = ("slip", "opening", "pressure", "displacement")  # walls that rest on each other move with the rock
_STRESSES = ("pressure", "shear_traction", "normal_traction")
_CHANGES = ("plastic_slip", "opening", "aperture")
_MAX_LINES = 7
_MOST_FIRST = 5  # more than these at once show no place of the onset
_LEAST_SLIP = 1e-6  # of the largest, that is drawn
_WIDEST = 6.0  # line of slip [points]
_DECADES = 3.0  # of positive rates, from which on their axis is logarithmic
_WIDE = 10.0  # figure [inches]: letters are read where a page is 760 pixels wide
_LETTERS = 26  # of a label beside a panel, which are about as high as so many are long


def draw(folder: str | Path) -> list[Path]:
    """Draw ``overview.png``, ``probes.png`` and ``wells.png`` into ``pictures`` of a run and return their paths.

    The second and third are left out if the run has no histories of probes or wells. Raises InputError if the folder has no
    history.
    """
    run = load_run_data(folder)
    pictures = Path(folder) / "pictures"
    pictures.mkdir(exist_ok=True)
    with styled():
        drawn = {"overview": _overview(run), "probes": _probes(run), "wells": _wells(run)}
        paths = [save(figure, pictures / f"{name}.png") for name, figure in drawn.items() if figure]
    return paths


def _overview(run: RunData) -> Figure:
    from matplotlib.figure import Figure

    network = _network(run)
    shape = max(network.shape, FLATTEST)
    if shape > FLAT:
        figure = Figure(figsize=(_WIDE, float(np.clip(4.3 * shape + 2.0, 5.6, 7.0))), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=[1.1, 1])
        slip, energy, pressure = right.subplots(3, 1)
    else:
        figure = Figure(figsize=(_WIDE, 9.0 * shape + 4.9), layout="constrained")
        left, right = figure.subfigures(2, 1, height_ratios=[9.0 * shape + 1.9, 3.0])
        slip, energy, pressure = right.subplots(1, 3)
    draw_head(figure, run.title, run.account)
    named, drawn = {}, ""
    if run.probes_with("slip"):
        row = _most_telling(run, _MOTIONS)
        drawn = row.name
        elastic = ", with its elastic part" if row.name == "slip" else ""
        _draw_probes(slip, run, row, f"{row.axis.capitalize()} at the probes{elastic}")
    else:
        row = _most_telling_profile(run, _CHANGES)
        named[slip] = _draw_profiles(slip, run, row, by_size=True)
    _draw_energy(energy, run)
    if run.fractures is not None and run.fractures.has("pressure"):
        named[pressure] = _draw_profiles(pressure, run, QUANTITIES["pressure"])
    else:
        row = _most_telling(run, [name for name in _STRESSES if name != drawn])
        _draw_probes(pressure, run, row, f"{row.axis.capitalize()} at the probes")
    axes = left.subplots()
    scales = _draw_map(axes, run, network)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        left.legend(handles, labels, loc="outside lower left", ncols=3, handletextpad=0.3)
    figure.draw_without_rendering()  # names are placed in the pixels of the final layout
    name_all(axes, network, scales, _WIDEST)
    for panel, lines in named.items():
        _name_lines(panel, lines)
    return figure


def _draw_probes(axes: Axes, run: RunData, row: OutputQuantity, title: str, word: str = "") -> None:
    lines = {name: run.probe(name, row.name) for name in run.probes_with(row.name)}
    _draw_lines(axes, run, lines, title, word or row.axis, row.dimension, run.abscissa(run.settled))


def _most_telling(run: RunData, names: Sequence[str]) -> OutputQuantity:
    """The first of these quantities that changes at the probes, else the first that they have."""
    there = [QUANTITIES[name] for name in names if run.probes_with(name)] or [QUANTITIES[names[-1]]]
    lines = ((row, [run.probe(name, row.name)[run.settled] for name in run.probes_with(row.name)]) for row in there)
    return next((row for row, each in lines if not _axis_of(run, row, each).is_constant), there[0])


def _most_telling_profile(run: RunData, names: Sequence[str]) -> OutputQuantity:
    """The first of these fields of the fractures that is not the same at every place and time, else the first."""
    steps = [run.fractures.before, run.fractures.after] if run.fractures is not None else []
    rows = [QUANTITIES[name] for name in names if any(name in each for each in steps)]
    lines = ((row, [each[row.name] for each in steps if row.name in each]) for row in rows)
    telling = (row for row, each in lines if not _axis_of(run, row, [np.concatenate(each)]).is_constant)
    return next(telling, QUANTITIES[names[0]])


def _axis_of(run: RunData, row: OutputQuantity, lines: Sequence[Floats]) -> Axis:
    return axis_of(row.dimension, lines, run.units, run.noise.get(row.dimension, 0.0))


def _network(run: RunData) -> Network:
    """Rock, fractures, wells, probes and first slips of a run, for its map; the mesh of an event near the fractures."""
    found = run.fractures
    first = run.first_events()
    marks = {"well": run.wells, "probe": run.probes}
    if 0 < len(first) <= _MOST_FIRST:
        marks["slipped first"] = {f"\0{i}": (event["x"], event["y"]) for i, event in enumerate(first)}
    if run.limit is not None:
        marks["limit point"] = {"\0limit": run.limit[1]}
    if found is None:
        return Network(
            run.rock or [],
            np.zeros((0, 2, 2)),
            np.zeros(0, dtype=np.int64),
            [],
            run.units,
            marks,
            is_meshed=run.is_meshed,
        )
    network = Network(
        run.rock or [], found.segments, found.fracture, found.names, run.units, marks, is_meshed=run.is_meshed
    )
    return network.near_fractures() if run.rock and run.was_unmeshed else network


def _draw_map(axes: Axes, run: RunData, network: Network) -> tuple[Axis, Axis]:
    fractures = run.fractures
    axes.set_title(f"Where the rock slipped, until {run.at(fractures.time)}" if fractures else "Where the rock slipped")
    scales = draw_map(axes, network)
    if fractures is None or not len(network.segments):
        return scales
    slip = np.abs(fractures.on_segments("plastic_slip"))
    axis = axis_of(LENGTH, [np.r_[0.0, slip]], run.units, run.noise.get(LENGTH, 0.0))
    top = float(axis(slip[np.isfinite(slip)]).max(initial=0.0))
    if axis.is_constant:
        since = run.slipped_since() if run.is_behind else []
        later = f"; {len(since)} {'has' if len(since) == 1 else 'have'} since" if since else ""
        axes.set_title(f"The fractures: none had slipped at {run.at(fractures.time)}{later}")
        pressure = fractures.on_segments("pressure")
        axis = _axis_of(run, QUANTITIES["pressure"], [pressure])
        if axis.is_constant:
            return scales
        axes.set_title(f"Pressure at {run.at(fractures.time)}: no fracture had slipped{later}")
        moved, word = np.isfinite(pressure), "pressure"
        shown = axis(pressure[moved])
        low, top, widths = float(shown.min()), float(shown.max()), np.full(len(shown), 2.5)
    else:
        moved, word = axis(slip) > _LEAST_SLIP * top, "plastic slip"
        shown = axis(slip[moved])
        low, widths = 0.0, 2.0 + (_WIDEST - 2.0) * shown / top
    lines = coloured(axes, scaled(network.segments[moved], *scales), shown, widths, "viridis_r", (low, top))
    label = axis.label(f"{word} at {run.at(fractures.time)}")
    look: dict[str, Any] = dict(location="bottom", shrink=0.7, aspect=40, pad=0.03, panchor=False)
    bar = axes.figure.colorbar(lines, ax=axes, label=label, **look)
    plain_numbers(bar.ax, "x")
    return scales


def _draw_lines(
    axes: Axes,
    run: RunData,
    lines: dict[str, np.ndarray],
    title: str,
    word: str,
    dimension: str,
    over: Abscissa,
    is_held: bool = False,
) -> None:
    """Histories, named at their right ends; the largest ones if there are many. Held values are those of steps."""
    axes.set_title(title, wrap=True)
    span, x = over.steps, over.values
    ranked = sorted(lines, key=lambda name: -np.ptp(np.nan_to_num(lines[name][span])))[:_MAX_LINES]
    shown = [name for name in lines if name in ranked]
    if not shown or len(x) == 0:
        _say_nothing(axes)
        return
    if len(shown) < len(lines):
        axes.set_title(f"{title} ({len(shown)} of {len(lines)})", wrap=True)
    scale = axis_of(dimension, [lines[name][span] for name in shown], run.units, run.noise.get(dimension, 0.0))
    drawn = {name: scale(lines[name][span]) for name in shown}
    for (_, values), colour in zip(drawn.items(), COLOURS, strict=False):
        look = "steps-pre" if is_held else "default"
        axes.plot(x, values, color=colour, marker="." if len(x) == 1 else "", drawstyle=look)
    axes.margins(x=0.0)
    axes.set_xlabel(over.label)
    axes.set_ylabel(fill(scale.label(word), _LETTERS, break_long_words=False))
    if dimension == VELOCITY and not scale.is_constant and _spans_decades([lines[name][span] for name in shown]):
        axes.set_yscale("log")
        plain_numbers(axes, "x")
    else:
        plain_numbers(axes)
    ends = [(name, float(np.nan_to_num(values[-1]))) for name, values in drawn.items()]
    if scale.is_constant:
        _draw_constant(axes, [value for _, value in ends])
    _name_ends(axes, ends, scale.unit if scale.is_constant else None)


def _spans_decades(lines: Sequence[Floats]) -> bool:
    """Whether values are all positive and span so many decades that a straight axis would show the largest ones alone."""
    known = np.concatenate([line[np.isfinite(line)] for line in lines])
    return bool(known.size and known.min() > 0.0 and np.log10(known.max() / known.min()) >= _DECADES)


def _draw_constant(axes: Axes, values: list[float]) -> None:
    """An axis on which nothing changes: wide about its values, which are said beside it."""
    axes.set_title(f"{axes.get_title(loc='left')}: constant", loc="left")
    around = max(0.2 * max(abs(value) for value in values), 1.0 if not any(values) else 0.0)
    axes.set_ylim(min(values) - around, max(values) + around)
    if not any(values):
        axes.set_yticks([0.0])


def _name_ends(axes: Axes, ends: list[tuple[str, float]], unit: str | None = None) -> None:
    """Name lines beside their last values, together where these coincide, else moved apart.

    unit  say the values too, in this unit
    """
    upright = axes.transData - axes.transAxes
    heights = [float(upright.transform((axes.get_xlim()[1], value))[1]) for _, value in ends]
    groups: list[list[int]] = []
    for i in sorted(range(len(ends)), key=heights.__getitem__):
        if groups and heights[i] - heights[groups[-1][0]] < 0.01:
            groups[-1].append(i)
        else:
            groups.append([i])
    count = np.array([(len(group) + 1) // 2 for group in groups])  # lines of each text, of two names at most
    gaps = min(0.12, 1.0 / max(1, count.sum())) * 0.5 * (count[1:] + count[:-1])
    spread = np.array([heights[group[0]] for group in groups])
    for i in range(1, len(spread)):
        spread[i] = max(spread[i], spread[i - 1] + gaps[i - 1])
    spread -= max(0.0, spread[-1] - 1.0)
    for i in range(len(spread) - 2, -1, -1):
        spread[i] = min(spread[i], spread[i + 1] - gaps[i])
    for group, y in zip(groups, spread, strict=True):
        colour = COLOURS[group[0]] if len(group) == 1 else INK
        names = [plain(ends[i][0]) for i in sorted(group)]
        said = "" if unit is None else f": {ends[group[0]][1]:.5g} {unit}".rstrip()
        text = ",\n".join(", ".join(names[k : k + 2]) for k in range(0, len(names), 2))
        line = dict(arrowstyle="-", color=colour, lw=0.7, shrinkA=0, shrinkB=0, relpos=(0.0, 0.5))
        axes.annotate(
            text + said, (1.0, heights[group[0]]), (1.03, y),
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
    _draw_lines(axes, run, lines, title, "change", ENERGY, run.abscissa(slice(start, None)))
    if lines:
        axes.axhline(0.0, color=PALE, lw=0.8, zorder=1)


def _draw_profiles(
    axes: Axes, run: RunData, row: OutputQuantity, by_size: bool = False
) -> dict[str, tuple[Floats, str]]:
    """A field along the fractures where it changes most, in the first fields written (dashed) and the last.

    Returns the last lines (k, 2) by name, with their colours.

    by_size  along those where it is largest
    """
    fractures, word = run.fractures, row.axis.capitalize()
    if fractures is None or not fractures.has(row.name) or not len(fractures.segments):
        axes.set_title(f"{word} along fractures")
        _say_nothing(axes)
        return {}
    profiles = fractures.profiles(row.name, _MAX_LINES, by_size)
    changes = not by_size and fractures.has_before and row.name in fractures.before
    which = (
        f"{len(profiles)} with most"
        if by_size
        else f"the {len(profiles)} {'that change most' if changes else 'longest'}"
    )
    of = "fractures" if len(profiles) == len(fractures.names) else which
    both = [np.ravel(line) for _, before, after in profiles.values() for line in (before, after) if line is not None]
    scale = axis_of(row.dimension, [np.concatenate(both)], run.units, run.noise.get(row.dimension, 0.0))
    begins = run.at(fractures.begins) if run.settled.start == 0 else "initial"  # a stage may have taken no time since
    first = f"{begins} dashed, " if fractures.has_before else ""
    when = "" if scale.is_constant else f": {first}{run.at(fractures.time)}"
    axes.set_title(f"{word} along {of}{when}", wrap=True)
    s = axis_of(LENGTH, [along for along, _, _ in profiles.values()], run.units)
    drawn = {}
    for (name, (along, before, after)), colour in zip(profiles.items(), COLOURS, strict=False):
        if before is not None:
            axes.plot(s(along), scale(np.ravel(before)), color=colour, lw=1.0, ls=(0, (4, 2)), alpha=0.7)
        axes.plot(s(along), scale(np.ravel(after)), color=colour)
        drawn[name] = (np.stack([s(along), scale(np.ravel(after))], axis=1), colour)
    axes.set_xlabel(s.label("distance along the fracture"))
    axes.set_ylabel(fill(scale.label(row.axis), _LETTERS, break_long_words=False))
    plain_numbers(axes)
    axes.margins(x=0.0)
    if scale.is_constant:
        _draw_constant(axes, [float(np.nan_to_num(line[0, 1])) for line, _ in drawn.values()])
    return drawn


def _name_lines(axes: Axes, lines: dict[str, tuple[Floats, str]]) -> None:
    """Names of lines (k, 2) beside them, in their colours, off the others where that can be; the figure is laid out."""
    traces = {name: axes.transData.transform(line) for name, (line, _) in lines.items()}
    traces = {name: line for name, line in traces.items() if np.all(np.isfinite(line)) and len(line) > 1}
    pieces = [np.stack([line[:-1], line[1:]], axis=1) for line in traces.values()]
    labels = [beside_trace(line, name_size(axes, name)) for name, line in traces.items()]
    bounds = np.ravel(axes.get_window_extent().get_points())
    found = placed(labels, np.concatenate(pieces or [np.zeros((0, 2, 2))]), np.zeros((0, 4)), bounds)
    for name, at in zip(traces, found, strict=True):
        if at is not None:
            write_name(axes, name, axes.transData.inverted().transform(at), lines[name][1])


def _probes(run: RunData) -> Figure | None:
    shown = [row for row in probed().values() if row.drawn and run.probes_with(row.name)]
    if not shown:
        return None
    figure, panels = _sheet(run, "probes", len(shown))
    for axes, row in zip(panels, shown, strict=True):
        _draw_probes(axes, run, row, row.axis.capitalize(), row.name.replace("_", " "))
    return figure


def _wells(run: RunData) -> Figure | None:
    shown = [(word, dimension) for word, dimension in _OF_WELLS if _of_wells(run, word)]
    if not shown:
        return None
    figure, panels = _sheet(run, "wells", len(shown))
    over = run.times(run.settled)  # rates are given by time
    for axes, (word, dimension) in zip(panels, shown, strict=True):
        is_rate = dimension == FLOW_RATE  # which is that of the step before
        _draw_lines(axes, run, _of_wells(run, word), word.capitalize(), word, dimension, over, is_held=is_rate)
    return figure


def _of_wells(run: RunData, quantity: str) -> dict[str, Floats]:
    """Histories (steps,) of a quantity by the names of the wells."""
    tail = f"/{quantity}"
    keys = [key for key in run.history if key.startswith("well/") and key.endswith(tail)]
    return {key[len("well/") : -len(tail)]: run.history[key] for key in keys}


def _sheet(run: RunData, of: str, count: int) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in two columns, of three panels in three."""
    from matplotlib.figure import Figure

    columns = 3 if count == 3 else 2
    rows = -(-count // columns)
    figure = Figure(figsize=(_WIDE, 0.6 + 2.3 * rows), layout="constrained")
    draw_head(figure, f"{run.title}: {of}", run.account.partition(". Map")[0])
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[count:]:
        axes.remove()
    return figure, list(grid[:count])
