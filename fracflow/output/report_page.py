"""The report of a run: one HTML file that opens offline, with its charts, its map and their data."""

from __future__ import annotations

import base64
import datetime
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow._version import __version__
from fracflow.output.folder import write_atomic
from fracflow.output.report import VOLUME, Chart, RunReport, Series, read_run
from fracflow.output.report_map import Frames, map_record, read_frames
from fracflow.output.report_words import (
    LOST,
    STORED,
    check_table,
    energy_left,
    energy_table,
    event_table,
    fracture_table,
    items,
    key_numbers,
    mesh_line,
    plan_table,
    safe,
    scene_in_words,
    state_of,
    table,
    warnings_of,
)
from fracflow.output.statistics import COVERED, FEWEST, front_diffusivity, gutenberg_richter, largest_moment
from fracflow.scene.quantities import QUANTITIES
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import ENERGY, FLOW_RATE, LENGTH, STRESS, TIME, VELOCITY

Charts = dict[str, Chart]
WORDS = {"pressure": "pressure", "aperture": "aperture", "plastic_slip": "slip"}
MOST_LISTED = 12  # events in the table
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
    drawn = run.attempt(lambda: map_record(run, frames), None)
    charts: Charts = {}
    parts: list[tuple[str, str, Callable[[], str]]] = [
        ("scene", "The scene", lambda: _scene(run)),
        ("mesh", "Mesh and fractures", lambda: _mesh(run, frames)),
        ("model", "Parts modelled and left out", lambda: _model(run)),
        ("wells", "Wells", lambda: _wells(run, charts, frames)),
        ("map", "Map", lambda: _map(drawn)),
        ("along", "Along the fractures", lambda: _along(frames)),
        ("probes", "Probes", lambda: _probes(run, charts)),
        ("events", "Events", lambda: _events(run, charts)),
        ("energy", "Energy balance", lambda: _energy(run, charts)),
        ("steps", "Steps", lambda: _steps(run, charts)),
    ]
    made = [(key, head, run.attempt(make, "<p>This part could not be made; see the warnings.</p>")) for key, head, make in parts]
    made.append(("repeat", "How to repeat it", _repeat(run)))
    made.insert(0, ("warnings", "Warnings", _warnings(run)))
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
    source = files("fracflow.output")
    script = source.joinpath("report.js").read_text(encoding="utf-8")
    style = source.joinpath("report.css").read_text(encoding="utf-8")
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


def _figure(charts: Charts, key: str, chart: Chart) -> str:
    """A chart's place on the page; empty where it has no point."""
    if not chart.has_data:
        return ""
    charts[key] = chart
    note = f"<p>{safe(chart.note)}</p>" if chart.note else ""
    return f'<figure class="chart" data-chart="{key}"><figcaption>{safe(chart.title)}</figcaption><div></div>{note}</figure>'


def _warnings(run: RunReport) -> str:
    found = list(warnings_of(run))
    if not found:
        return "<p>None.</p>"
    lines = [f"<li><b>{safe(head)}</b> {safe(text)}</li>" for head, text in found]
    more = f"<details><summary>{len(lines) - 8} more</summary><ul>{''.join(lines[8:])}</ul></details>" if len(lines) > 8 else ""
    return f'<ul class="warnings">{"".join(lines[:8])}</ul>{more}'


def _scene(run: RunReport) -> str:
    lines = scene_in_words(run)
    return items(lines) if lines else "<p>The run folder has no readable scene.toml.</p>"


def _mesh(run: RunReport, frames: Frames | None) -> str:
    return f"<p>{safe(mesh_line(run))}</p>{fracture_table(run, frames)}"


def _model(run: RunReport) -> str:
    if not run.plan and not run.checks:
        return "<p>The run folder has no readable plan.json.</p>"
    return f"{plan_table(run)}<details><summary>Checks before the run</summary>{check_table(run)}</details>"


def histories_of_wells(run: RunReport, frames: Frames | None) -> dict[str, dict[str, tuple[NDArray[Any], NDArray[Any]]]]:
    """Histories of the wells by quantity and name: time (n,) and values (n,).

    quantity  "pressure" [stress], "rate" into the fracture [length^3/time], "volume" that came in [length^3]

    They are those of history.h5 where it has any. Otherwise pressures are those of the nearest point on the profiles, and
    rates those that the scene prescribes.
    """
    found: dict[str, dict[str, tuple[NDArray[Any], NDArray[Any]]]] = {"pressure": {}, "rate": {}, "volume": {}}
    for key, values in run.history.items():
        name, _, quantity = key.removeprefix("well/").rpartition("/")
        if key.startswith("well/") and (kind := {"flow_rate": "rate"}.get(quantity, quantity)) in found and values.ndim == 1:
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
    rows = [(name, f"({run.shown(x, LENGTH, 5)}, {run.shown(y, LENGTH, 5)})") for name, (x, y) in run.wells.items()]
    if rows:
        text += table(("well", "at"), rows)
    for quantity, lines in histories_of_wells(run, frames).items():
        dimension = {"pressure": STRESS, "rate": FLOW_RATE, "volume": VOLUME}[quantity]
        unit = run.unit(dimension, np.concatenate([np.zeros(1), *(values for _, values in lines.values())]))
        moves = len(run.times) > 0 and np.ptp(run.times) > 0.0
        series = [
            Series(name, time * run.clock.factor if moves else np.arange(len(time)), unit.factor * values)
            for name, (time, values) in lines.items()
        ]
        title = {"pressure": "Pressure at the wells", "rate": "Flow rate into the fractures", "volume": "Volume"}[quantity]
        label = run.clock.label("time") if moves else "state"
        text += _figure(charts, f"well-{quantity}", Chart(title, label, unit.label(quantity), series))
    return text


def _map(drawn: dict[str, Any] | None) -> str:
    if drawn is None:
        return "<p>The run folder has neither a plane mesh nor fields of fractures to draw.</p>"
    if not drawn.get("times"):
        return '<div id="chart-map"><canvas></canvas></div><p>No fields of the fractures are on disk yet.</p>'
    options = "".join(f'<option value="{key}">{safe(WORDS[key])}</option>' for key in ("plastic_slip", "pressure", "aperture") if key in drawn["fields"])
    names = "".join(f'<option value="{i}">{safe(name)}</option>' for i, (name, _, _) in enumerate(drawn["fractures"]))
    last = len(drawn["times"]) - 1
    slider = f'<input type="range" id="slider" min="0" max="{last}" value="{last}" step="1" aria-label="state shown on the map">'
    return (
        f'<div class="controls"><label>show <select id="quantity">{options}</select></label>'
        f'<button type="button" id="play">play</button>{slider}<output id="now"></output></div>'
        '<div id="chart-map"><canvas></canvas></div><div id="scale"></div><p id="under"></p>'
        "<p>Orange: sections that slip between this state and the one before. Circles: events so far, larger with the magnitude."
        " Triangles: wells. Dots: probes.</p>"
        f'<figure class="chart" id="profile"><figcaption>Along <select id="fracture">{names}</select> at this time,'
        " and at the first state (dashed)</figcaption><div></div></figure>"
    )


def _along(frames: Frames | None) -> str:
    if frames is None or not frames.fields:
        return "<p>The run folder has no fields of fractures.</p>"
    if len(frames.times) < 3:
        return f"<p>Fields of the fractures are on disk at {len(frames.times)} state{'s' * (len(frames.times) > 1)} only; see the map.</p>"
    text = "<p>Distance from the start of each fracture upwards, time to the right. Colours are the same for all fractures.</p>"
    largest = {name: np.nan_to_num(values).max(axis=0) for name, values in frames.fields.items()}
    order_by = largest.get("plastic_slip", next(iter(largest.values())))
    order = sorted(range(len(frames.names)), key=lambda i: -float(order_by[frames.ends[i]].max(initial=0.0)))
    for key in ("pressure", "aperture", "plastic_slip"):
        if key not in frames.fields:
            continue
        cells = [f'<figure class="heat" data-field="{key}" data-fracture="{i}"><figcaption>{safe(frames.names[i])}</figcaption>'
                 "<canvas></canvas></figure>" for i in order]  # fmt: skip
        few, rest = "".join(cells[:9]), "".join(cells[9:])
        more = f'<details class="more"><summary>{len(cells) - 9} more fractures</summary><div class="grid">{rest}</div></details>'
        head = WORDS[key].capitalize()
        text += f'<h3>{head}</h3><div class="scale" data-field="{key}"></div><div class="grid">{few}</div>{more if rest else ""}'
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
        word = QUANTITIES[quantity].axis
        text += _figure(charts, f"probe-{quantity}", run.over_time(word.capitalize(), word, dimension, lines))
    return text


def _events(run: RunReport, charts: Charts) -> str:
    slips = [event for event in run.events if event["kind"] == "slip"]
    if not run.catalogue:
        if not slips:
            return "<p>Nothing slipped.</p>" if run.events else "<p>Nothing slipped or opened.</p>"
        return _onsets(run, charts, slips)
    events = sorted(run.catalogue, key=lambda event: event["start"])
    time = np.array([event["start"] for event in events]) * run.clock.factor
    sizes = np.array([np.nan if event["magnitude"] is None else event["magnitude"] for event in events])
    clock = run.clock.label("time")
    text = f"<p>{len(events)} events, from the first section that slides to the last that sticks.</p>"
    if np.isfinite(sizes).any():
        text += _figure(charts, "magnitude-time", Chart("Magnitude", clock, "magnitude", [Series("events", time, sizes, "dots")]))
        text += _frequency(charts, sizes[np.isfinite(sizes)])
    else:
        text += "<p>Magnitudes need output.event_length and a scene with units.</p>"
    text += _moments(run, charts, events)
    text += _distances(run, charts, events)
    largest = sorted(events, key=lambda event: -(event["moment"] or 0.0))[:MOST_LISTED]
    head = f"<h3>The {len(largest)} largest of them</h3>" if len(events) > len(largest) else "<h3>The events</h3>"
    return f"{text}{head}{event_table(run, sorted(largest, key=lambda event: event['start']))}"


def _frequency(charts: Charts, sizes: NDArray[Any]) -> str:
    """The numbers of events of at least each magnitude, with the fit where there are enough."""
    ranked = np.sort(sizes)
    series = [Series("events", ranked, np.arange(len(ranked), 0, -1), "dots")]
    fit = gutenberg_richter(sizes)
    if fit is None:
        note = f"A b-value needs {FEWEST} events above completeness; there are {len(sizes)} events in all."
    else:
        ends = np.array([fit.completeness, ranked[-1]])
        series.append(Series(f"b = {fit.b:.2f} ± {fit.error:.2f}", ends, [fit.number(m) for m in ends], "dash"))
        note = (
            f"b = {fit.b:.2f} ± {fit.error:.2f} (Aki and Utsu; error of Shi and Bolt), from {fit.count} events of magnitude"
            f" {fit.completeness:.1f} and above, which maximum curvature gives as complete."
        )
        note += " With fewer than 50 events it is a first guess." if fit.count < 50 else ""
    chart = Chart("Gutenberg and Richter: events of at least a magnitude", "magnitude", "number", series, log_y=True, note=note)
    return _figure(charts, "gutenberg-richter", chart)


def _moments(run: RunReport, charts: Charts, events: list[dict[str, Any]]) -> str:
    """Sum of the moments against the net volume that wells had brought, beside McGarr's bound."""
    depth = run.scene.output.event_length if run.scene is not None else None
    known = [e for e in events if e["moment"] is not None and e["injected"] is not None]
    if depth is None or not known:
        return ""
    volume, moment = np.array([e["injected"] for e in known]), np.cumsum([e["moment"] * depth for e in known])
    unit = run.unit(VOLUME, volume)
    each = np.array([e["moment"] * depth for e in known])
    series = [Series("sum", unit.factor * volume, moment, "line"), Series("each event", unit.factor * volume, each, "dots")]
    note = "Moments are those of the plane model times output.event_length."
    if (modulus := _shear_modulus(run)) is not None and volume.max() > 0.0:
        reach = np.linspace(0.0, volume.max(), 60)[1:]
        series.append(Series("G ΔV", unit.factor * reach, largest_moment(modulus, reach), "dash"))
        note += f" Dashed: McGarr's bound of the largest moment, G ΔV with G = {run.shown(modulus, STRESS, 3)}."
    name = "N m" if run.units.get("force") == "N" else f"{run.units.get('force', '')} {run.units.get('length', '')}".strip()
    label = f"moment [{name}]" if name else "moment"
    chart = Chart("Moment against injected volume", unit.label("net injected volume"), label, series, log_y=True, note=note)
    return _figure(charts, "moment-volume", chart)


def _shear_modulus(run: RunReport) -> float | None:
    """The largest of the rocks."""
    found = [
        rock.youngs_modulus / (2.0 * (1.0 + (rock.poissons_ratio or 0.0)))
        for rock in (run.scene.rock.values() if run.scene is not None else ())
        if not rock.rigid and rock.youngs_modulus is not None
    ]
    return max(found, default=None)


def _distances(run: RunReport, charts: Charts, events: list[dict[str, Any]]) -> str:
    """Distance of the events from the nearest well, with the front of a diffusion where they give one."""
    if not run.wells or not len(run.times):
        return ""
    wells, places = np.array(list(run.wells.values())), np.array([[e["x"], e["y"]] for e in events])
    distance = np.linalg.norm(places[:, None] - wells[None], axis=2).min(axis=1)
    time = np.array([e["start"] for e in events])
    since = time - float(run.times[0])
    unit, clock = run.unit(LENGTH, distance), run.clock
    series = [Series("events", clock.factor * time, unit.factor * distance, "dots")]
    diffusivity = front_diffusivity(distance, since)
    note = f"No front is drawn: the distances of these {len(events)} events do not clearly grow with time."
    if diffusivity is not None:
        reach = np.linspace(0.0, since.max(), 100)
        front = np.sqrt(4.0 * math.pi * diffusivity * reach)
        series.append(Series("√(4πDt)", clock.factor * (reach + run.times[0]), unit.factor * front, "dash"))
        own = f"{run.units.get('length', '')}²/{run.units.get('time', '')}" if run.units.get("length") else ""
        note = f"Dashed: for reference, the front √(4πDt) with {COVERED:.0%} of the events behind it, D = {diffusivity:.2g} {own}."
    chart = Chart("Distance from the nearest well", clock.label("time"), unit.label("distance"), series, note=note)
    return _figure(charts, "distance-time", chart)


def _onsets(run: RunReport, charts: Charts, slips: list[dict[str, Any]]) -> str:
    """When sections slipped and how far, of a run without a catalogue."""
    unit = run.unit(LENGTH, [e["slip"] for e in slips])
    clock = run.clock
    groups: dict[str, list[dict[str, Any]]] = {}
    for event in slips:
        groups.setdefault(event["fracture"], []).append(event)
    ranked = sorted(groups, key=lambda name: -max(abs(e["slip"]) for e in groups[name]))
    series = [
        Series(name, [e["start"] * clock.factor for e in groups[name]], [abs(e["slip"]) * unit.factor for e in groups[name]], "dots")
        for name in ranked[:8]
    ]
    chart = Chart("Slip of the sections, by when it begins", clock.label("time"), unit.label("slip"), series)
    rows = [
        (name, len(groups[name]), run.clock_text(min(e["start"] for e in groups[name])),
         run.shown(max(abs(e["slip"]) for e in groups[name]), LENGTH, 3),
         run.shown(max(e["peak_slip_rate"] for e in groups[name]), VELOCITY, 3))
        for name in ranked
    ]  # fmt: skip
    heads = ("fracture", "slips of its sections", "the first begins", "largest slip", "fastest")
    why = "<p>The catalogue of whole events, with magnitudes, belongs to stages of kind auto.</p>"
    return f"{_figure(charts, 'onsets', chart)}{table(heads, rows, 'long')}{why}"


def _energy(run: RunReport, charts: Charts) -> str:
    entries = {key[7:]: values for key, values in run.history.items() if key.startswith("energy/")}
    entries = {name: values for name, values in entries.items() if values.ndim == 1 and len(values)}
    if not entries:
        return "<p>No state is on record yet.</p>"
    start = run.settled.start or 0
    changes = {name: entries[name] - entries[name][start] for name in (*STORED, *LOST) if name in entries}
    scale = max((float(np.nanmax(np.abs(values[start:]))) for values in changes.values()), default=0.0)
    lines = {name.replace("_", " "): v for name, v in changes.items() if np.nanmax(np.abs(v[start:])) > 1e-3 * scale}
    work = sum(values for name, values in entries.items() if name.startswith("work_"))
    shown = {**lines, "all work": work - work[start]} if scale > 0.0 and not np.isscalar(work) else lines
    chart = run.over_time("Change of the entries, per thickness", "energy", ENERGY, shown, most=9)
    text = _figure(charts, "energy", chart)
    if (left := energy_left(run)) is not None:
        text += f"<p>Stored and lost energy differ from the work done by at most {left:.1e} of the largest entry.</p>"
    return text + energy_table(run)


def _steps(run: RunReport, charts: Charts) -> str:
    length = run.history.get("step/dt", np.zeros(0))
    if len(length) < 2:
        return ""
    number = np.arange(len(length))
    taken = np.where(length > 0.0, length, np.nan)
    if not np.isfinite(taken).any():
        return ""
    unit = run.unit(TIME, [float(np.nanmedian(taken))])
    chart = Chart("Length of the steps", "step", unit.label("length"), [Series("length", number, unit.factor * taken, "dots")], log_y=True)
    text = _figure(charts, "step-length", chart)
    series = [
        Series(word, number, run.history[f"step/{key}"])
        for key, word in (("slipping", "slipping"), ("open", "open"))
        if f"step/{key}" in run.history and np.any(run.history[f"step/{key}"])
    ]
    return text + _figure(charts, "step-status", Chart("Joint ends that slip or are open", "step", "number", series))


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
        text += f"<details><summary>log.txt, {len(run.log)} lines</summary><pre>{safe_lines(chr(10).join(shown))}</pre></details>"
    return text


def safe_lines(text: str) -> str:
    """Lines of a text from outside as HTML."""
    return "\n".join(safe(line) for line in text.splitlines())
