"""The report of a run: its energy balance and slip."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fracflow.errors import InputError
from fracflow.mesh.places import extent_of, place_text
from fracflow.mesh.store import load_mesh
from fracflow.output.drawing.axes import shown, unit_for
from fracflow.output.events import read_events
from fracflow.output.fields import list_steps, read_mesh, read_step
from fracflow.output.fracture_table import COLUMNS, fracture_table
from fracflow.output.history import last_of, read_attributes, read_history, read_units, shut_line
from fracflow.output.slip_at_crossings import crossing_lines
from fracflow.scene.quantities import quantities
from fracflow.scene.scene import load
from fracflow.scene.units import LENGTH, TIME, VOLUME
from fracflow.storage.files import shown_plain

BOOKS = (
    "kinetic", "rock_strain", "tips", "joint_normal", "joint_shear", "fluid_storage", "friction", "viscous", "radiated",
    "leak_off", "damping", "scheme", "spurious", "dropped",
    "work_boundaries", "work_wells", "work_pressure", "work_incident", "work_initial", "residual", "residual_closed",
    "dilation", "change_of_rock",
)  # fmt: skip
WIDTH = 100  # columns of a table, where the terminal has no fewer
MOST_EVENTS = 20
MOST_FRACTURES = 40
OPEN = 1e-6  # of the largest entry of the energy balance
COARSE = 1e-2  # the same, of what closed forms of the stored energies leave


def _nearest(folder: Path) -> str:
    """Where the last fields of the fractures are nearest to their strength."""
    steps = list_steps(folder, "fractures")
    if not steps:
        return ""
    points, _, about = read_mesh(folder, "fractures")
    _, at_points, at_cells = read_step(steps[-1][1])
    share = np.asarray(at_points["utilisation"]).ravel()
    if not np.any(np.isfinite(share) & (share > 0.0)):
        return ""
    nearest = int(np.nanargmax(np.where(np.isfinite(share), share, np.nan)))
    name = json.loads(about["fractures"])[int(np.asarray(at_cells["fracture"])[nearest // 2])]
    at = place_text(points[nearest, :2], extent_of(points))
    return (
        f"; nearest to it at the end is {name} at {at}, |f_s|/f_sy = {share[nearest]:.4g}:"
        f" {_further(folder)} may reach it"
    )


def _further(folder: Path) -> str:
    """Changes of the stages of a run that lead it further, by the keys that its stages have."""
    scene = load(folder / "scene.toml")
    last = scene.stage[-1]
    ways = ["a larger increment_per_step"] if any(stage.increment_per_step for stage in scene.stage) else []
    if any(well.flow_rate is not None or well.pressure is not None for well in scene.well):
        ways.append("more pressure")
    longer = "a later end" if last.end is not None else "more steps"
    return f"{', '.join([longer, *ways[:-1]])} or {ways[-1]}" if ways else longer


def _balance_lines(left: float, closed: float, most: float, noise: float) -> Iterator[str]:
    """Lines on an open energy balance: by ``left``, by ``closed`` with closed forms, beside the largest entry ``most``.

    noise  round-off of sums of forces times displacements, of which nothing is known [energy per thickness]
    """
    if left > max(OPEN * most, noise):
        yield (
            f"! energy balance: {left / most:.1e} of the largest entry is left over, and the results are not known better: look"
            " for a wrong unit, very wide beside very narrow fractures, or a loose tolerance"
        )
    if closed > max(COARSE * most, noise):
        yield (
            f"! energy balance: with the closed forms of what joints store {closed / most:.1e} of the largest entry is left"
            " over: steps are too long for the joints, or unstable; compare with a shorter time_step"
        )
    if 0.0 < most <= noise:
        yield (
            f"energy balance: all entries are round-off, below {noise:.1e}, the machine's precision of the energy that the"
            " initial stresses store; no motion exceeds round-off"
        )


def _report_wells(history: Mapping[str, Any], units: Mapping[str, str], console: Console) -> None:
    """Print the wells at the end, and the volumes of the network; nothing for a run without their histories."""
    if "volume/injected" not in history:
        return
    names = dict.fromkeys(key.removeprefix("well/").rpartition("/")[0] for key in history if key.startswith("well/"))
    table = Table("well", title="Wells at the end", title_style="bold")
    columns = []
    for row in quantities("well").values():
        word = row.name.removeprefix("well/")
        if word == "limit":
            continue
        values = np.array([last_of(history[f"well/{name}/{word}"]) for name in names], dtype=float)
        factor, unit = unit_for(row.dimension, _largest(values), units)
        table.add_column(escape(f"{word} [{shown_plain(unit)}]" if unit else word), justify="right")
        columns.append([f"{factor * value:.5g}" if np.isfinite(value) else "-" for value in values])
    for name, *cells in zip(names, *columns, strict=True):
        table.add_row(escape(name), *cells)
    console.print(table)
    for line in filter(None, (shut_line(history, name, lambda t: shown(TIME, t, units, 6)) for name in names)):
        console.print(line, soft_wrap=True, markup=False)
    parts = [key.removeprefix("volume/") for key in history if key.startswith("volume/")]
    ends = {part.replace("_", " "): float(history[f"volume/{part}"][-1]) for part in parts}
    factor, unit = unit_for(VOLUME, _largest(np.array([*ends.values()])), units)
    moved = [part.replace("_", " ") for part in parts if history[f"volume/{part}"].any()]
    lines = ", ".join(f"{part} {factor * ends[part]:.5g} {shown_plain(unit)}".rstrip() for part in moved)
    console.print(f"fluid since the start: {lines or 'none moved'}", soft_wrap=True, markup=False)


def report(folder: Path, console: Console, failed: bool = False) -> None:
    """Print energy balance and events of a run folder; no advice if it ``failed``. Raises InputError without a history."""
    history = read_history(folder / "history.h5")
    about = read_attributes(folder / "history.h5")
    units = read_units(folder / "history.h5", about)
    length, force = (shown_plain(units.get(key, "")) for key in ("length", "force"))
    title = "Energy balance" + (f" [{force} {length} per {length} of thickness]" if length else "")
    table = Table("entry", "at the end", "largest", title=escape(title), title_style="bold")
    books = [name for name in BOOKS if f"energy/{name}" in history]  # earlier versions had fewer
    others = [key.removeprefix("energy/") for key in history if key.startswith("energy/")]
    for name in [*(name for name in others if name not in BOOKS), *books]:  # first those of terms
        values = history[f"energy/{name}"]
        if not values.any() and not name.startswith("residual"):
            continue  # of parts that the scene has not
        table.add_row(name, f"{values[-1]: .6e}", f"{np.abs(values).max():.3e}")
    console.print(table)
    _report_wells(history, units, console)
    left, closed, most = (
        max((np.abs(history[f"energy/{name}"]).max() for name in books if name in names), default=0.0)
        for names in (("residual",), ("residual_closed",), BOOKS)
    )
    noise = about.get("energy_noise", 0.0)
    if isinstance(noise, str):
        raise InputError(f"{folder / 'history.h5'}: its energy_noise is no number; name the folder of a run")
    noise *= len(history["time"])
    for line in _balance_lines(left, closed, most, noise):
        console.print(line, soft_wrap=True, markup=False)
    _report_fractures(folder, console, units)
    events = read_events(folder / "events.csv")
    if not events:
        found = fracture_table(folder)
        if found is not None and np.nan_to_num(found.columns["largest_slip"]).any():
            console.print("slip crept: no event, and no section opened", soft_wrap=True, markup=False)
            return
        near = "" if failed else _nearest(folder)
        console.print(f"no section reached its strength or opened{near}", soft_wrap=True, markup=False)
        return
    _report_events([event for event in events if event["kind"] == "event"], console, units)
    for line in crossing_lines(events, load_mesh(folder / "mesh.h5"), units):
        console.print(line, soft_wrap=True, markup=False)


def _report_fractures(folder: Path, console: Console, units: Mapping[str, str]) -> None:
    """A row a fracture, in units that suit the numbers; those of most slip first, then the longest."""
    found = fracture_table(folder)
    if found is None:
        return
    at = shown_plain(shown(TIME, found.time, units, 6))
    table = Table(title=escape(f"Fractures at {at}"), title_style="bold", box=SIMPLE_HEAD, padding=0)
    table.add_column("fracture", overflow="fold", min_width=min(12, max(map(len, found.names), default=8)))
    columns = {key: values for key, values in found.columns.items() if np.isfinite(values).any()}
    scales = {key: unit_for(COLUMNS[key], _largest(values), units) for key, values in columns.items()}
    for key, (_, unit) in scales.items():
        unit = unit.replace("J", "N·m") if key == "moment" else unit  # which is no energy
        table.add_column(
            escape(f"{key.replace('_', ' ')} [{shown_plain(unit)}]" if unit else key.replace("_", " ")), justify="right"
        )
    table.add_column("state", no_wrap=True)
    slip, length = np.nan_to_num(found.columns["largest_slip"]), found.columns["length"]
    order = np.lexsort((-length, -slip))
    for i in order[:MOST_FRACTURES]:
        cells = (_cell(key, scales[key][0] * float(values[i])) for key, values in columns.items())
        table.add_row(escape(shown_plain(found.names[i])), *cells, found.state[i])
    console.print(table)
    if len(order) > MOST_FRACTURES:
        rest = f"and {len(order) - MOST_FRACTURES} more; all by: fracflow export {folder} --csv"
        console.print(rest, soft_wrap=True, markup=False)


def _cell(key: str, value: float) -> str:
    """A number of the table of fractures; a first slip before any time has passed, as in steady stages, is said in words."""
    if key == "first_slip" and value == 0.0:
        return "at time 0"
    return f"{value:.4g}" if np.isfinite(value) else "-"


def _largest(values: NDArray[np.float64]) -> float:
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _report_events(events: Sequence[Mapping[str, Any]], console: Console, units: Mapping[str, str]) -> None:
    """The catalogue's events, the largest of them, in their order."""
    if not events:
        return
    table = Table(title="Events", title_style="bold")
    for head in ("begins on", "from", "to", "largest slip", "magnitude"):
        table.add_column(head)
    largest = sorted(events, key=lambda event: -abs(event["slip"]))[:MOST_EVENTS]
    for event in sorted(largest, key=lambda event: event["start"]):
        times = ["" if event[key] is None else shown(TIME, event[key], units, 8) for key in ("start", "end")]
        size = "–" if event["magnitude"] is None else f"{event['magnitude']:.2f}"
        slip = shown(LENGTH, event["slip"], units)
        table.add_row(*(escape(shown_plain(text)) for text in (event["fracture"], *times, slip, size)))
    console.print(table)
    if all(event["magnitude"] is None for event in events):
        console.print("magnitudes need output.event_length and a scene with units", soft_wrap=True)
    if len(events) > MOST_EVENTS:
        console.print(f"and {len(events) - MOST_EVENTS} more, of smaller slip, in events.csv", soft_wrap=True)
