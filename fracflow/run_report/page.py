"""The report of a run: one HTML file that opens offline, with its charts, its map and their data."""

from __future__ import annotations

import base64
import datetime
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow._version import __version__
from fracflow.output.folder import write_atomic
from fracflow.output.history import last_of, shut_line
from fracflow.output.remarks import last_limit
from fracflow.run_report.catalogue import Charts, events_of, figure
from fracflow.run_report.data import Chart, RunReport, Series, number, read_run
from fracflow.run_report.map import Frames, map_record, read_frames
from fracflow.run_report.words import (
    LOST,
    STORED,
    check_table,
    energy_left,
    energy_table,
    fluid_sums,
    fracture_table,
    items,
    key_numbers,
    mesh_line,
    notes_of,
    of_columns,
    plan_table,
    safe,
    scene_in_words,
    state_of,
    warnings_of,
)
from fracflow.scene.quantities import QUANTITIES
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import ENERGY, FLOW_RATE, LENGTH, STRESS, TIME, VELOCITY, VOLUME

WORDS = {"pressure": "pressure", "aperture": "aperture", "plastic_slip": "plastic slip"}
_OF_WELLS = {"pressure": STRESS, "rate": FLOW_RATE, "volume": VOLUME}
MOST_SHOWN = 9  # fractures whose fields are open at once, those that slip most
MOST_OPEN = 8  # warnings, and notes, that are open at once
MOST_LOG = 200  # lines of the log


def write_report(folder: str | Path, output: str | Path | None = None) -> tuple[Path, list[str]]:
    """Write the page of a run, by default report.html in its folder; gives the file, and lines on what could not be read.

    Raises InputError where the folder holds no run, OSError where the page cannot be written.
    """
    run = read_run(folder)
    path = Path(folder) / "report.html" if output is None else Path(output)
    write_atomic(path, page(run))
    return path, run.faults


def page(run: RunReport) -> str:
    """The page as text."""
    frames = run.attempt(lambda: read_frames(run), None)
    drawn = map_record(run, frames)
    charts: Charts = {}
    made = [
        ("warnings", "Warnings", _lines(list(warnings_of(run))) or "<p>None.</p>"),
        ("scene", "The scene", _scene(run)),
        ("mesh", "Mesh and fractures", _mesh(run, frames)),
        ("wells", "Wells", _wells(run, charts, frames)),
        ("map", "Map", _map(drawn, last_limit(run.log))),
        ("along", "Along the fractures", _along(frames)),
        ("probes", "Probes", _probes(run, charts)),
        ("events", "Events", events_of(run, charts)),
        ("energy", "Energy balance", _energy(run, charts)),
        ("model", "Parts modelled and left out", _model(run)),
        ("steps", "Steps", _steps(run, charts)),
        ("notes", "Notes", _lines(list(notes_of(run)))),
        ("repeat", "How to repeat it", _repeat(run)),
    ]
    body = "".join(f'<section id="{key}"><h2>{safe(head)}</h2>{text}</section>' for key, head, text in made if text)
    index = "".join(f'<li><a href="#{key}">{safe(head)}</a></li>' for key, head, text in made if text)
    data = {"charts": {key: chart.as_record() for key, chart in charts.items()}, "map": drawn}
    when = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    numbers = "".join(f"<div><dt>{safe(w)}</dt><dd>{safe(v)}</dd></div>" for w, v in key_numbers(run, frames))
    head = f"<h1>{safe(run.title)}</h1><p>{safe(state_of(run))}</p><dl>{numbers}</dl>"
    foot = f"Written by fracflow {__version__} on {when} from the run folder {run.folder.resolve().name}."
    return _filled(run.title, index, f"<header>{head}</header>{body}<footer>{safe(foot)}</footer>", data)


def _filled(title: str, index: str, body: str, data: Mapping[str, Any]) -> str:
    """The template with its parts; the browser runs no script but the template's own."""
    source = files("fracflow.run_report")
    script = source.joinpath("page.js").read_text(encoding="utf-8")
    style = source.joinpath("page.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'"
    text = json.dumps(_finite(data), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":  # what could end the element, or a line of a script
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return "\n".join([
        '<!DOCTYPE html>', '<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<title>{safe(title)}</title>', f"<style>{style}</style></head><body>",
        f'<nav><details open><summary>Contents</summary><ol>{index}</ol></details></nav>',
        f"<main>{body}<noscript><p>The charts and the map need JavaScript.</p></noscript></main>",
        f'<script type="application/json" id="data">{text}</script>', f"<script>{script}</script>", "</body></html>", "",
    ])  # fmt: skip


def _finite(value: Any) -> Any:
    """A value without numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _lines(found: Sequence[tuple[str, str]]) -> str:
    """A list of headings and texts, the first few of them open."""
    lines = [f"<li><b>{safe(head)}</b> {safe(text)}</li>" for head, text in found]
    few, rest = "".join(lines[:MOST_OPEN]), "".join(lines[MOST_OPEN:])
    more = f"<details><summary>{len(lines) - MOST_OPEN} more</summary><ul>{rest}</ul></details>" if rest else ""
    return f'<ul class="lines">{few}</ul>{more}' if few else ""


def _scene(run: RunReport) -> str:
    lines = scene_in_words(run)
    return items(lines) if lines else "<p>The run folder has no readable scene.toml.</p>"


def _mesh(run: RunReport, frames: Frames | None) -> str:
    return f"<p>{safe(mesh_line(run))}</p>{fracture_table(run, frames)}"


def _model(run: RunReport) -> str:
    if not run.plan and not run.checks:
        return "<p>The run folder has no readable plan.json.</p>"
    return f"{plan_table(run)}<details><summary>Checks before the run</summary>{check_table(run)}</details>"


def histories_of_wells(
    run: RunReport, frames: Frames | None
) -> dict[str, dict[str, tuple[NDArray[Any], NDArray[Any]]]]:
    """Histories of the wells by quantity and name: time (n,) and values (n,).

    quantity  "pressure" [stress], "rate" into the fracture [length^3/time], "volume" that came in [length^3]

    They are those of history.h5 where it has any. Otherwise pressures are those of the nearest point on the profiles, and
    rates those that the scene prescribes.
    """
    found: dict[str, dict[str, tuple[NDArray[Any], NDArray[Any]]]] = {"pressure": {}, "rate": {}, "volume": {}}
    for key, values in run.history.items():
        name, _, quantity = key.removeprefix("well/").rpartition("/")
        if (
            key.startswith("well/")
            and (kind := {"flow_rate": "rate"}.get(quantity, quantity)) in found
            and values.ndim == 1
        ):
            found[kind][name] = (run.times, np.asarray(values, dtype=float))
    for name, place in run.wells.items():
        if name not in found["pressure"] and frames is not None and "pressure" in frames.fields:
            nearest = int(np.argmin(np.linalg.norm(frames.points - np.array(place), axis=1)))
            found["pressure"][name] = (frames.times, frames.fields["pressure"][:, nearest])
    for well in run.scene.well if run.scene is not None else ():
        if well.name in found["rate"] or not isinstance(well.flow_rate, TimeTable) or not len(run.times):
            continue
        factor = run.history.get(f"step/control/{well.control}", np.ones(1)) if well.control else np.ones(1)
        found["rate"][well.name] = (run.times, np.array([well.flow_rate(t) for t in run.times]) * factor)
    return found


def _wells(run: RunReport, charts: Charts, frames: Frames | None) -> str:
    if not run.wells and not (run.scene and run.scene.well):
        return "<p>The scene has no wells.</p>"
    text = ""
    histories = histories_of_wells(run, frames)
    ends = [(quantity, _OF_WELLS[quantity], lines) for quantity, lines in histories.items() if lines]
    if run.wells:
        unit = run.unit(LENGTH, np.array([*run.wells.values()]))
        places = [f"({number(unit.factor * x, 5)}, {number(unit.factor * y, 5)})" for x, y in run.wells.values()]
        on = [frames.nearest(place) if frames else "–" for place in run.wells.values()]
        columns: list[tuple[str, Sequence[object]]] = [("well", [*run.wells]), (unit.label("at"), places), ("on", on)]
        for quantity, dimension, lines in ends:
            last = [last_of(lines[name][1]) if name in lines else None for name in run.wells]
            columns.append(run.column(f"{quantity} at the end", dimension, last))
        text += of_columns(columns)
    shut = [shut_line(run.history, name, run.clock_text) for name in run.wells] if len(run.times) else []
    text += "".join(f"<p>{safe(line)}.</p>" for line in shut if line)
    if sums := fluid_sums(run):
        text += f"<p>Fluid since the start: {safe(sums)}.</p>"
    for quantity, lines in histories.items():
        dimension = _OF_WELLS[quantity]
        unit = run.unit(dimension, np.concatenate([np.zeros(1), *(values for _, values in lines.values())]))
        moves = len(run.times) > 0 and np.ptp(run.times) > 0.0
        series = [
            Series(name, time * run.clock.factor if moves else np.arange(len(time)), unit.factor * values)
            for name, (time, values) in lines.items()
        ]
        series = [each.held() for each in series] if quantity == "rate" else series
        title = {"pressure": "Pressure at the wells", "rate": "Flow rate into the fractures", "volume": "Volume"}[
            quantity
        ]
        label = run.clock.label("time") if moves else "state"
        text += figure(charts, f"well-{quantity}", Chart(title, label, unit.label(quantity), series))
    return text


def _map(drawn: dict[str, Any] | None, limit: tuple[str, tuple[float, float]] | None) -> str:
    if drawn is None:
        return "<p>The run folder has neither a plane mesh nor fields of fractures to draw.</p>"
    if not drawn.get("times"):
        return '<div id="chart-map"><canvas></canvas></div><p>No fields of the fractures are on disk yet.</p>'
    options = "".join(
        f'<option value="{key}">{safe(WORDS[key])}</option>'
        for key in sorted(drawn["fields"], key=("plastic_slip", "pressure", "aperture").index)
    )
    names = "".join(
        f'<option value="{i}"{" selected" * (i == drawn["most"])}>{safe(name)}</option>'
        for i, (name, _, _) in enumerate(drawn["fractures"])
    )
    diamond = (
        f" Diamond: the last limit point, from which slip runs away: {safe(limit[0])}." if limit is not None else ""
    )
    last = len(drawn["times"]) - 1
    slider = f'<input type="range" id="slider" min="0" max="{last}" value="{last}" aria-label="state shown on the map">'
    return (
        f'<div class="controls"><label>show <select id="quantity">{options}</select></label>'
        '<label id="whole-rock"><input type="checkbox" id="whole"> whole rock</label>'
        f'<button type="button" id="play">play</button>{slider}<output id="now"></output></div>'
        '<div id="chart-map"><canvas></canvas></div><div id="scale"></div><p id="under"></p>'
        "<p>Orange: sections that slip between this state and the one before. Circles: events so far, larger with the"
        f" magnitude. Triangles: wells. Dots: probes.{diamond}</p>"
        f'<figure class="chart" id="profile"><figcaption>Along <select id="fracture">{names}</select> at this time,'
        " and at the first state (dashed)</figcaption><div></div></figure>"
    )


def _along(frames: Frames | None) -> str:
    if frames is None or not frames.fields:
        return "<p>The run folder has no fields of fractures.</p>"
    if len(frames.times) < 3:
        many = f"{len(frames.times)} state{'s' * (len(frames.times) > 1)}"
        return f"<p>Fields of the fractures are on disk at {many} only; see the map.</p>"
    text = "<p>Distance from the start of each fracture upwards, time to the right. Colours are the same for all fractures.</p>"
    by = frames.slips
    order = sorted(range(len(frames.names)), key=lambda i: -float(by[frames.ends[i]].max(initial=0.0)))
    if len(order) <= MOST_SHOWN:
        order.sort()
    for key in ("pressure", "aperture", "plastic_slip"):
        if key not in frames.fields:
            continue
        cells = [f'<figure class="heat" data-field="{key}" data-fracture="{i}"><figcaption>{safe(frames.names[i])}</figcaption>'
                 "<canvas></canvas></figure>" for i in order]  # fmt: skip
        few, rest = "".join(cells[:MOST_SHOWN]), "".join(cells[MOST_SHOWN:])
        head, rest = f"{len(cells) - MOST_SHOWN} more fractures", f'<div class="grid">{rest}</div>' if rest else ""
        more = f"<details><summary>{head}</summary>{rest}</details>" if rest else ""
        scale = f'<div class="scale" data-field="{key}"></div>'
        text += f'<h3>{WORDS[key].capitalize()}</h3>{scale}<div class="grid">{few}</div>{more}'
    return text


def _probes(run: RunReport, charts: Charts) -> str:
    names = sorted({key[6:].rpartition("/")[0] for key in run.history if key.startswith("probe/")})
    if not names:
        return ""
    text = ""
    for quantity, dimension in (("pressure", STRESS), ("plastic_slip", LENGTH), ("slip", LENGTH), ("slip_rate", VELOCITY),
                                ("aperture", LENGTH), ("shear_traction", STRESS), ("normal_traction", STRESS)):  # fmt: skip
        lines = {name: run.history.get(f"probe/{name}/{quantity}", np.zeros((0, 0))) for name in names}
        lines = {name: values for name, values in lines.items() if values.ndim == 1 and len(values) == len(run.times)}
        if not lines or (quantity == "slip" and "probe-plastic_slip" in charts):
            continue
        if not any(np.any(np.nan_to_num(values)) for values in lines.values()):
            continue
        word = QUANTITIES[quantity].axis
        text += figure(charts, f"probe-{quantity}", run.over_time(word.capitalize(), word, dimension, lines))
    return text


def _energy(run: RunReport, charts: Charts) -> str:
    entries = {key[7:]: values for key, values in run.history.items() if key.startswith("energy/")}
    entries = {name: values for name, values in entries.items() if values.ndim == 1 and len(values)}
    if not entries:
        return "<p>No state is on record yet.</p>"
    start = run.settled.start or 0
    changes = {name: entries[name] - entries[name][start] for name in (*STORED, *LOST) if name in entries}
    scale = max((float(np.nanmax(np.abs(values[start:]))) for values in changes.values()), default=0.0)
    lines = {name.replace("_", " "): v for name, v in changes.items() if np.nanmax(np.abs(v[start:])) > 1e-3 * scale}
    work = np.sum([values for name, values in entries.items() if name.startswith("work_")] or [0.0 * run.times], axis=0)
    shown = {**lines, "all work": work - work[start]} if scale > 0.0 else lines
    chart = run.over_time("Change of the entries, per thickness", "energy", ENERGY, shown, most=9)
    text = figure(charts, "energy", chart)
    if (left := energy_left(run)) is not None:
        text += f"<p>Stored and lost energy differ from the work done by at most {number(left, 2)} of the largest entry.</p>"
    return text + energy_table(run)


def _steps(run: RunReport, charts: Charts) -> str:
    length = run.history.get("step/dt", np.zeros(0))
    if len(length) < 2:
        return ""
    steps = np.arange(len(length))
    taken = np.where(length > 0.0, length, np.nan)
    if not np.isfinite(taken).any():
        return ""
    unit = run.unit(TIME, [1.0])
    chart = Chart(
        "Length of the steps",
        "step",
        unit.label("length"),
        [Series("length", steps, unit.factor * taken, "dots")],
        log_y=True,
    )
    text = figure(charts, "step-length", chart)
    if work := next((line for line in reversed(run.log) if line.startswith("work in all:")), ""):
        text += f"<p>{safe(work[0].upper() + work[1:])}.</p>"
    series = [
        Series(word, steps, run.history[f"step/{key}"])
        for key, word in (("slipping", "slipping"), ("open", "open"))
        if f"step/{key}" in run.history and np.any(run.history[f"step/{key}"])
    ]
    return text + figure(charts, "step-status", Chart("Joint ends that slip or are open", "step", "number", series))


def _repeat(run: RunReport) -> str:
    version = safe(run.notes.get("fracflow", __version__))
    digest = hashlib.sha256(run.scene_text.encode()).hexdigest()
    text = f"<p>The run was made with fracflow {version}.</p>"
    if run.scene_text:
        text += (
            "<p>Save the scene below as scene.toml"
            f"{' beside its mesh' if run.scene is not None and run.scene.mesh_path is not None else ''}, then:</p>"
            "<pre>fracflow check scene.toml\nfracflow run scene.toml -o runs/again\nfracflow report runs/again</pre>"
            f"<details><summary>scene.toml, with all defaults (SHA-256 {digest[:16]}…)</summary>"
            f"<pre>{safe_lines(run.scene_text)}</pre></details>"
        )
    if run.log:
        shown = run.log if len(run.log) <= MOST_LOG else [*run.log[: MOST_LOG // 2], "…", *run.log[-MOST_LOG // 2 :]]
        lines = safe_lines("\n".join(shown))
        text += f"<details><summary>log.txt, {len(run.log)} lines</summary><pre>{lines}</pre></details>"
    return text


def safe_lines(text: str) -> str:
    """Lines of a text from outside as HTML."""
    return "\n".join(safe(line) for line in text.splitlines())
