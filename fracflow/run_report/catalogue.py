"""The events of a run on its page: magnitudes, Gutenberg and Richter's law, moment against volume, distance from wells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.run_report.data import Chart, RunReport, Series, number
from fracflow.run_report.statistics import COVERED, FEWEST, front_diffusivity, gutenberg_richter, largest_moment
from fracflow.run_report.words import event_table, of_columns, safe
from fracflow.scene.units import LENGTH, STRESS, TIME, VELOCITY, VOLUME

Charts = dict[str, Chart]
MOST_LISTED = 12  # events in the table


def figure(charts: Charts, key: str, chart: Chart) -> str:
    """A chart's place on the page; empty where it has no point."""
    if not chart.has_data:
        return ""
    charts[key] = chart
    note = f"<p>{safe(chart.note)}</p>" if chart.note else ""
    return f'<figure class="chart" data-chart="{key}"><figcaption>{safe(chart.title)}</figcaption><div></div>{note}</figure>'


def events_of(run: RunReport, charts: Charts) -> str:
    """The events: catalogue, frequency, moment and distance; without a catalogue the slip of sections."""
    slips = [event for event in run.events if event["kind"] == "slip"]
    if not run.catalogue:
        if not slips:
            return "<p>Nothing slipped.</p>" if run.events else "<p>Nothing slipped or opened.</p>"
        return _onsets(run, charts, slips)
    events = sorted(run.catalogue, key=lambda event: event["start"])
    time = np.array([event["start"] for event in events]) * run.clock.factor
    sizes = np.array([np.nan if event["magnitude"] is None else event["magnitude"] for event in events])
    clock = run.clock.label("time")
    text = f"<p>{len(events)} event{'s' * (len(events) != 1)}, from the first section that slides to the last that sticks.</p>"
    if np.isfinite(sizes).any():
        text += figure(
            charts,
            "magnitude-time",
            Chart("Magnitude", clock, "magnitude", [Series("events", time, sizes, "dots")], span=run.span),
        )
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
        if len(sizes) == 1:  # a point alone shows no frequency
            return f"<p>A b-value needs {FEWEST} events.</p>"
    else:
        ends = np.array([fit.completeness, ranked[-1]])
        series.append(Series(f"b = {fit.b:.2f} ± {fit.error:.2f}", ends, [fit.number(m) for m in ends], "dash"))
        note = (
            f"b = {fit.b:.2f} ± {fit.error:.2f} (Aki and Utsu; error of Shi and Bolt), from {fit.count} events of magnitude"
            f" {fit.completeness:.1f} and above, which maximum curvature gives as complete."
        )
        note += " With fewer than 50 events it is a first guess." if fit.count < 50 else ""
    chart = Chart(
        "Gutenberg and Richter: events of at least a magnitude", "magnitude", "number", series, log_y=True, note=note
    )
    return figure(charts, "gutenberg-richter", chart)


def _moments(run: RunReport, charts: Charts, events: list[dict[str, Any]]) -> str:
    """Sum of the moments against the net volume that wells had brought, beside McGarr's bound."""
    depth = run.scene.output.event_length if run.scene is not None else None
    known = [e for e in events if e["moment"] is not None and e["injected"] is not None]
    if depth is None or not known:
        return ""
    volume, moment = np.array([e["injected"] for e in known]), np.cumsum([e["moment"] * depth for e in known])
    unit = run.unit(VOLUME, volume)
    each = np.array([e["moment"] * depth for e in known])
    series = [
        Series("sum", unit.factor * volume, moment, "line"),
        Series("each event", unit.factor * volume, each, "dots"),
    ]
    note = "Moments are those of the plane model times output.event_length."
    if run.scene is not None and (modulus := _shear_modulus(run)) is not None and volume.max() > 0.0:
        reach, share = np.linspace(0.0, volume.max(), 60)[1:], depth / run.scene.flow_depth
        series.append(Series("G ΔV", unit.factor * reach, largest_moment(modulus, share * reach), "dash"))
        note += f" Dashed: McGarr's bound of the largest moment, G ΔV with G = {run.shown(modulus, STRESS, 3)}"
        if share != 1.0:
            note += f" and ΔV = {number(share, 3)} times the volume shown, which is that of fluid.flow_depth"
        note += "."
    name = (
        "N m"
        if run.units.get("force") == "N"
        else f"{run.units.get('force', '')} {run.units.get('length', '')}".strip()
    )
    label = f"moment [{name}]" if name else "moment"
    chart = Chart(
        "Moment against injected volume", unit.label("net injected volume"), label, series, log_y=True, note=note
    )
    return figure(charts, "moment-volume", chart)


def _shear_modulus(run: RunReport) -> float | None:
    """The largest of the rocks."""
    rocks = run.scene.rock.values() if run.scene is not None else ()
    return max((rock.shear_modulus for rock in rocks if not rock.rigid), default=None)


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
    note = note if len(events) > 1 else "No front is drawn through one event."
    if diffusivity is not None:
        reach = np.linspace(0.0, since.max(), 100)
        front = np.sqrt(4.0 * math.pi * diffusivity * reach)
        series.append(Series("√(4πDt)", clock.factor * (reach + run.times[0]), unit.factor * front, "dash"))
        own = f"{run.units.get('length', '')}²/{run.units.get('time', '')}" if run.units.get("length") else ""
        behind = f"{COVERED:.0%} of the events behind it"
        note = f"Dashed: for reference, the front √(4πDt) with {behind}, D = {number(diffusivity, 2)} {own}."
    chart = Chart(
        "Distance from the nearest well", clock.label("time"), unit.label("distance"), series, note=note, span=run.span
    )
    return figure(charts, "distance-time", chart)


def _onsets(run: RunReport, charts: Charts, slips: list[dict[str, Any]]) -> str:
    """When sections slipped and how far, of a run without a catalogue."""
    unit = run.unit(LENGTH, [e["slip"] for e in slips])
    clock = run.clock
    groups: dict[str, list[dict[str, Any]]] = {}
    for event in slips:
        groups.setdefault(event["fracture"], []).append(event)
    ranked = sorted(groups, key=lambda name: -max(abs(e["slip"]) for e in groups[name]))
    series = [
        Series(
            name,
            [e["start"] * clock.factor for e in groups[name]],
            [abs(e["slip"]) * unit.factor for e in groups[name]],
            "dots",
        )
        for name in ranked[:8]
    ]
    chart = Chart(
        "Slip of the sections, by when it begins", clock.label("time"), unit.label("slip"), series, span=run.span
    )
    slips_of = [groups[name] for name in ranked]
    columns: list[tuple[str, Sequence[object]]] = [
        ("fracture", ranked),
        ("slips of its sections", [len(rows) for rows in slips_of]),
        run.column("the first begins", TIME, [min(e["start"] for e in rows) for rows in slips_of], unit=clock),
        run.column("largest slip", LENGTH, [max(abs(e["slip"]) for e in rows) for rows in slips_of], 3),
        run.column("fastest", VELOCITY, [max(e["peak_slip_rate"] for e in rows) for rows in slips_of], 3),
    ]
    why = (
        "<p>No slip ran away: there is no event with a magnitude.</p>"
        if run.scene is not None and any(stage.kind == "auto" for stage in run.scene.stage)
        else "<p>The catalogue of whole events, with magnitudes, belongs to stages of kind auto.</p>"
    )
    return f"{figure(charts, 'onsets', chart)}{of_columns(columns)}{why}"
