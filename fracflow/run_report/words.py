"""The words and tables of a run's report, as HTML; every text from outside is escaped."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from fracflow.mesh.cut_mesh import sizes_of
from fracflow.mesh.data import is_unmeshed
from fracflow.output.history import last_of
from fracflow.output.remarks import MESH_OF_EVENTS, alike, part_of, saved
from fracflow.output.status import CUT_OFF, ENDED, FAILED, RUNNING, STOPPED
from fracflow.remarks import has_mark, parted
from fracflow.run_report.data import RunReport, number
from fracflow.run_report.map import Frames
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import (
    AREA,
    COMPRESSIBILITY,
    DENSITY,
    ENERGY,
    FLOW_RATE,
    LENGTH,
    STIFFNESS,
    STRESS,
    TIME,
    VELOCITY,
    VISCOSITY,
    VOLUME,
)
from fracflow.storage.files import shown_plain

OPEN = 1e-6  # of the largest entry of the energy balance, as the report on the terminal has it
STORED = ("kinetic", "rock_strain", "tips", "joint_normal", "joint_shear", "fluid_storage", "change_of_rock")
LOST = ("friction", "viscous", "radiated", "leak_off", "damping", "scheme", "spurious", "dropped")
LONGEST_HEAD = 60  # letters that stand before the colon of a line
MOST_SEEN = 12  # rows of a long table that are seen at once


def safe(text: object) -> str:
    """A text from outside as HTML."""
    return escape(shown_plain(str(text)))


def table(heads: Sequence[str], rows: Iterable[Sequence[object]], kind: str = "") -> str:
    """A table of texts; on a narrow screen each row stands as a block with its heads."""
    body = "".join(
        "<tr>"
        + "".join(f'<td data-head="{safe(head)}">{safe(cell)}</td>' for head, cell in zip(heads, row, strict=True))
        + "</tr>"
        for row in rows
    )
    top = "".join(f"<th>{safe(head)}</th>" for head in heads)
    return f'<div class="rows {kind}"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def of_columns(columns: Iterable[tuple[str, Sequence[object]]], kind: str = "") -> str:
    """A table of columns, each a head and its cells; a long one scrolls."""
    heads, cells = zip(*columns, strict=True)
    rows = [*zip(*cells, strict=True)]
    return table(heads, rows, f"{kind} long" if len(rows) > MOST_SEEN else kind)


def items(lines: Iterable[str]) -> str:
    """A list of texts."""
    return "<ul>" + "".join(f"<li>{safe(line)}</li>" for line in lines) + "</ul>"


def state_of(run: RunReport) -> str:
    """How the run stands, in a sentence."""
    reached = run.shown(float(run.times[-1]), TIME) if len(run.times) else "before its first state"
    where = f"at {reached}" if len(run.times) else reached
    words = {
        RUNNING: f"Under way, {where} so far. Write the page again to see more.",
        ENDED: f"Ended {where}.",
        STOPPED: f"Stopped {where}. fracflow resume goes on.",
        FAILED: f"Failed {where}: no state beyond it was found.",
        CUT_OFF: f"Cut off {where}: the program was killed. fracflow resume goes on.",
    }
    return words.get(run.status.word, f"Histories reach {reached}." if len(run.times) else "No state is on record yet.")


def key_numbers(run: RunReport, frames: Frames | None) -> list[tuple[str, str]]:
    """The numbers that a reader looks for first: word and value."""
    found = [("time simulated", run.shown(float(np.ptp(run.times)), TIME, 3))] if len(run.times) else []
    found.append(("states on record", str(len(run.times))))
    if frames is not None:
        found.append(("fractures", str(len(frames.names))))
        for name, word, dimension in (
            ("pressure", "highest pressure at any time", STRESS),
            ("plastic_slip", "largest slip at any time", LENGTH),
        ):
            if name in frames.fields:
                found.append((word, run.shown(float(np.nanmax(frames.fields[name])), dimension, 3)))
    if any(stage.kind == "auto" for stage in run.scene.stage) if run.scene else run.catalogue:
        sizes = [event["magnitude"] for event in run.catalogue if event["magnitude"] is not None]
        found.append(("events", str(len(run.catalogue))))
        found += [("largest magnitude", f"{max(sizes):.2f}".replace("-", "−"))] if sizes else []
    return found


def warnings_of(run: RunReport) -> Iterator[tuple[str, str]]:
    """Heading and text of everything that may make a result wrong."""
    if run.status.word in (FAILED, CUT_OFF, STOPPED) and run.status.line:
        yield "how it ended", run.status.line
    for line in run.faults:
        yield "missing or damaged", line
    for each in run.checks:
        if each.get("out_of_range"):
            value, limit = each.get("value_text", ""), each.get("limit_text", "")
            head = f"check of {each.get('name', '')}"
            yield head, f"{each.get('where', '')}: {value}, limit {limit or 'none'}; {each.get('remedy', '')}"
    left = energy_left(run)
    if left is not None and left > OPEN:
        yield (
            "energy balance",
            f"{number(left, 2)} of its largest entry is left over; results are not known better than that",
        )
    yield from log_lines(run.log, of_notes=False)


def notes_of(run: RunReport) -> Iterator[tuple[str, str]]:
    """Heading and text of what was done in the run, about which nothing is to be done."""
    for each in run.plan:
        if each.get("undone"):
            yield (
                f"plan, {each.get('part', '')}",
                f"taken back during the run, which began anew with it: {each['undone']}",
            )
    yield from log_lines(run.log, of_notes=True)


def log_lines(lines: Sequence[str], of_notes: bool) -> Iterator[tuple[str, str]]:
    """Heading and text of the warnings, or of the notes, among the lines of the log, those alike once."""
    for line in alike(parted(filter(has_mark, lines))[of_notes]):
        head, _, text = line.partition(": ")
        yield (head, text) if text and len(head) <= LONGEST_HEAD else ("log", line)


def energy_left(run: RunReport) -> float | None:
    """Largest residual of the energy balance over its largest entry."""
    entries = [np.abs(run.history[f"energy/{n}"]) for n in (*STORED, *LOST) if f"energy/{n}" in run.history]
    entries += [np.abs(values) for key, values in run.history.items() if key.startswith("energy/work_")]
    most = max((float(np.nanmax(values)) for values in entries if np.isfinite(values).any()), default=0.0)
    residual = run.history.get("energy/residual", np.zeros(0))
    if not len(residual) or most <= energy_noise(run) or not np.isfinite(residual).any():
        return None
    return float(np.nanmax(np.abs(residual))) / most


def energy_noise(run: RunReport) -> float:
    """Round-off of the entries of the energy balance; 0 of a run that does not know it [energy per thickness]."""
    noise = run.notes.get("energy_noise", 0.0)
    return float(noise) * len(run.times) if isinstance(noise, int | float) else 0.0


def energy_table(run: RunReport) -> str:
    """The entries of the energy balance that are more than round-off, in groups, and the residual."""
    groups: list[tuple[str, list[str]]] = [("stored", [*STORED]), ("lost", [*LOST])]
    groups.append(("work", sorted(key[7:] for key in run.history if key.startswith("energy/work_"))))
    groups.append(("left over", ["residual", "residual_closed"]))
    found: list[tuple[str, str, float, float]] = []
    for group, names in groups:
        for name in names:
            values = run.history.get(f"energy/{name}", np.zeros(0))
            most = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
            if len(values) and (group == "left over" or most > energy_noise(run)):
                found.append((group, name.removeprefix("work_").replace("_", " "), float(values[-1]), most))
    if not found:
        return ""
    kinds = [each[0] if not k or each[0] != found[k - 1][0] else "" for k, each in enumerate(found)]
    unit = run.unit(ENERGY, [each[3] for each in found])
    at_end = run.column("at the end", ENERGY, [each[2] for each in found], unit=unit)
    largest = run.column("largest", ENERGY, [each[3] for each in found], unit=unit)
    return of_columns([("", kinds), ("entry", [each[1] for each in found]), at_end, largest], "small")


def fluid_sums(run: RunReport) -> str:
    """Volumes of the network at the end, all in one unit; nothing where no fluid moved."""
    volumes = {key[7:]: values for key, values in run.history.items() if key.startswith("volume/")}
    ends = {key.replace("_", " "): last_of(values) for key, values in volumes.items() if np.any(values)}
    unit = run.unit(VOLUME, [*ends.values()])
    return ", ".join(f"{word} {number(unit.factor * value)} {unit.name}".rstrip() for word, value in ends.items())


def scene_in_words(run: RunReport) -> list[str]:
    """The scene as sentences."""
    scene = run.scene
    if scene is None:
        return []
    shown = run.shown
    lines = [_domain(run, scene)]
    for name, rock in scene.rock.items():
        if rock.rigid:
            lines.append(f'Rock "{name}": rigid.')
            continue
        parts = [f"Young's modulus {shown(rock.youngs_modulus, STRESS)}", f"Poisson's ratio {rock.poissons_ratio:g}"]
        parts += [f"density {run.shown(_number(rock.density), DENSITY)}"] if rock.density is not None else []
        lines.append(f'Rock "{name}": {", ".join(parts)}.')
    if scene.initial_stress is not None:
        parts = [
            f"σ{axis} = {shown(_number(getattr(scene.initial_stress, axis, None)), STRESS)}"
            for axis in ("xx", "yy", "zz", "xy")
        ]
        lines.append(f"Stress in the rock at the start: {', '.join(parts)} (compression is negative).")
    if scene.fluid is not None:
        fluid = scene.fluid
        parts = [f"viscosity {run.shown(_number(fluid.viscosity), VISCOSITY)}"]
        if (pressure := _number(fluid.initial_pressure)) is not None:
            parts.append(f"pressure at the start {shown(pressure, STRESS)}")
        if fluid.compressibility:
            parts.append(f"compressibility {shown(_number(fluid.compressibility), COMPRESSIBILITY)}")
        parts.append(f"depth of the flow out of the plane {shown(_number(fluid.flow_depth), LENGTH)}")
        lines.append(f"Fluid: {', '.join(parts)}.")
    for name, kind in scene.fracture.items():
        who = "Fractures without a table of their own" if name == "default" else f'Fracture "{name}"'
        lines.append(f"{who}: {_fracture(run, kind)}.")
    lines += [f'Well "{well.name}": {_well(run, well)}.' for well in scene.well]
    for support in scene.support:
        lines.append(f"Held in {' and '.join(support.components)}: {', '.join(map(str, support.on))}.")
    for term in scene.terms:
        if term.absorbs:
            lines.append(f"Sides that absorb waves: {', '.join(map(str, term.on))}.")
    if scene.load:
        lines.append(f"Loads: {len(scene.load)}, in the scene file at the end of this page.")
    return [*lines, *(_stage(run, order, stage) for order, stage in enumerate(scene.stage, 1))]


def _number(value: Any) -> float | None:
    """A plain number of a scene, None for a profile or a table."""
    return float(value) if isinstance(value, int | float) else None


def _domain(run: RunReport, scene: Scene) -> str:
    if scene.geometry is None:
        file = scene.mesh_path.name if scene.mesh_path is not None else "a file"
        return f"The rock is the mesh of {file}, in plane strain."
    count = len(scene.geometry.fracture)
    made = next((str(each.get("value", "")) for each in run.plan if each.get("part") == MESH_OF_EVENTS), "")
    fractures = f"{count} fracture{'' if count == 1 else 's'}{made and f'. Its mesh for events has {made}'}"
    if scene.is_unbounded:
        until = " until an event needs inertia" if scene.has_dynamics else ""
        return f"Rock without sides, in plane strain and not meshed{until}, with {fractures}."
    corners = np.array(scene.geometry.outline, dtype=float)
    wide, high = (run.shown(float(size), LENGTH) for size in np.ptp(corners, axis=0))
    return f"A piece of rock {wide} wide and {high} high, in plane strain, with {fractures}."


def _fracture(run: RunReport, kind: Any) -> str:
    parts = [f"law {kind.law}"]
    rows = (
        ("normal_stiffness", "normal stiffness", STIFFNESS), ("shear_stiffness", "shear stiffness", STIFFNESS),
        ("aperture", "aperture", LENGTH), ("cohesion", "cohesion", STRESS),
        ("friction", "friction", "1"), ("dynamic_friction_coefficient", "friction once weakened", "1"),
        ("slip_weakening_distance", "weakens over a slip of", LENGTH),
        ("stick_slip_ratio", "strength left while slipping", "1"),
        ("reference_slip_rate", "that of slip at", VELOCITY), ("direct_effect", "direct effect", "1"),
        ("evolution_effect", "evolution effect", "1"), ("characteristic_slip", "characteristic slip", LENGTH),
        ("initial_slip_rate", "slip rate at the start", VELOCITY),
    )  # fmt: skip
    for key, word, dimension in rows:
        value = getattr(kind, key, None)
        if value is None or value == 0.0:
            continue
        one = _number(value)
        parts.append(f"{word} {'varies along it' if one is None else run.shown(one, dimension)}")
    if (rock := kind.leak_off) is not None:
        permeability, storage = run.shown(rock.permeability, AREA), run.shown(rock.storage, COMPRESSIBILITY)
        parts.append(f"leaks off into rock of permeability {permeability} and storage {storage}")
    return ", ".join(parts)


def _tabled(run: RunReport, value: Any, dimension: str) -> str:
    """A value of a well, constant or tabled over time."""
    if not isinstance(value, TimeTable):
        return str(value) if isinstance(value, str) else run.shown(_number(value), dimension)
    if len(value.times) == 1 or value.spread == 0.0:
        return run.shown(value.values[0], dimension)
    since = "from" if value.interpolation == "step" else "at"
    steps = [f"{run.shown(v, dimension)} {since} {run.clock_text(t)}"
             for t, v in zip(value.times[:8], value.values[:8], strict=True)]  # fmt: skip
    return ", ".join(steps) + (", and more" if len(value.times) > 8 else "")


def _well(run: RunReport, well: Any) -> str:
    parts = []
    if well.flow_rate is not None:
        parts.append(f"flow rate {_tabled(run, well.flow_rate, FLOW_RATE)}")
    if well.pressure is not None:
        initial = "that of the start" if well.pressure == "initial" else _tabled(run, well.pressure, STRESS)
        parts.append(f"pressure {initial}")
    if well.control:
        parts.append(f"times the control {well.control}")
    for key in ("maximum_pressure", "minimum_pressure"):
        if (limit := getattr(well, key)) is not None:
            parts.append(f"{key.replace('_', ' ')} {_tabled(run, limit, STRESS)}")
    return ", ".join(parts) or "no rate or pressure"


def _stage(run: RunReport, order: int, stage: Any) -> str:
    kinds = {
        "equilibrate": "finds the state at rest",
        "steady": "steady, without storage and inertia",
        "quasi-static": "without inertia",
        "dynamic": "with inertia",
        "auto": "without inertia, and with it while slip runs away",
    }
    parts = [kinds.get(stage.kind, stage.kind)]
    if stage.kind in ("quasi-static", "auto") and run.scene is not None and run.scene.radiates:
        parts.append("slip radiates G/(2 c_s) times its rate where there is no inertia")
    if stage.until:
        parts.append(f"raises {stage.control} until a section is about to slip")
    if stage.time_step:
        parts.append(f"steps of {'at most ' if stage.kind == 'auto' else ''}{run.shown(stage.time_step, TIME)}")
    if stage.dynamic_time_step:
        parts.append(f"of {run.shown(stage.dynamic_time_step, TIME)} with inertia")
    parts += [f"{stage.steps} steps"] if stage.steps else []
    parts += [f"until {run.shown(stage.end, TIME)}"] if stage.end else []
    return f"Stage {order}, {stage.title}: {'; '.join(parts)}."


def mesh_line(run: RunReport) -> str:
    """Sizes of the mesh, in a sentence."""
    mesh = run.mesh
    if mesh is None:
        return "No mesh is in the run folder."
    lengths = np.linalg.norm(np.diff(mesh.points[mesh.joint_bottom[:, :2]], axis=1)[:, 0], axis=-1)
    count, nodes = sizes_of(mesh)
    cells = "rock without cells" if is_unmeshed(mesh.cells) else f"{count} cells"
    text = f"{cells}, {nodes} nodes, {len(mesh.joint_bottom)} joint elements"
    if len(lengths):
        few, usual, most = (
            run.shown(float(size), LENGTH, 3) for size in (lengths.min(), np.median(lengths), lengths.max())
        )
        text += f" of {few}" if few == most else f" of {few} to {most}, median {usual}"
    return f"{text}."


def fracture_table(run: RunReport, frames: Frames | None) -> str:
    """A row for each fracture: its size, and the most that it reached; those of most slip first, then the longest."""
    if frames is None:
        return ""
    words = {
        "pressure": ("highest pressure", STRESS),
        "aperture": ("widest aperture", LENGTH),
        "plastic_slip": ("largest slip", LENGTH),
    }
    lengths = np.array([float(frames.along[part][-1]) for part in frames.ends])
    most = {
        key: np.array(
            [
                np.max(values[np.isfinite(values)], initial=-np.inf)
                for part in frames.ends
                for values in [table[:, part]]
            ]
        )
        for key, table in frames.fields.items()
    }
    slip = np.maximum(most["plastic_slip"], 0.0) if "plastic_slip" in most else np.zeros(len(lengths))
    order = np.lexsort([-lengths, -slip]).tolist()
    ways = [frames.points[part][-1] - frames.points[part][0] for part in frames.ends]
    columns: list[tuple[str, Sequence[object]]] = [
        ("fracture", [frames.names[i] for i in order]),
        run.column("length", LENGTH, lengths[order].tolist()),
        ("direction", [f"{math.degrees(math.atan2(ways[i][1], ways[i][0])) % 180.0:.0f}°" for i in order]),
        ("joints", [str(frames.ends[i].stop - frames.ends[i].start - 1) for i in order]),
        *(run.column(*words[key], values[order].tolist(), 3) for key, values in most.items()),
    ]
    note = (
        f"<p>{len(order)} fractures, those of most slip first; the table scrolls.</p>" if len(order) > MOST_SEEN else ""
    )
    return note + of_columns(columns)


def plan_table(run: RunReport) -> str:
    """The parts that are left out, and behind a line the others with the reason why."""

    def short(value: Any) -> str:
        return number(value, 3) if isinstance(value, float) else str(value)

    def rows(parts: Sequence[Mapping[str, Any]]) -> str:
        is_out = any(each.get("left_out") for each in parts)
        heads = ("part", "criterion", "value", "limit", "saves" if is_out else "why", "may err by")
        cells = (
            (part_of(each), each.get("criterion", ""), short(each.get("value", "")), short(each.get("limit", "")), saved(each),
             "" if each.get("verdict") == "kept" or each.get("error") == "none" else each.get("error", ""))
            for each in parts
        )  # fmt: skip
        filled = [*zip(heads, zip(*cells, strict=True), strict=True)]
        return of_columns([column for column in filled if any(column[1])], "wide")

    text = ""
    for verdict, word in (("left out", "Left out"), ("added", "Added"), ("not in the scene", "Not in the scene"),
                          ("kept", "Kept")):  # fmt: skip
        parts = [each for each in run.plan if each.get("verdict", "kept") == verdict]
        if parts and verdict == "left out":
            text += f"<h3>{word}</h3>{rows(parts)}"
        elif parts:
            names = "; ".join(map(part_of, parts))
            text += f"<details><summary>{word}: {safe(names)}</summary>{rows(parts)}</details>"
    return text


def check_table(run: RunReport) -> str:
    """The checks before the run."""
    rows = [
        ("out of range" if each.get("out_of_range") else "", f"{each.get('name', '')}, {each.get('formula', '')}",
         each.get("value_text") or "–", each.get("limit_text") or each.get("note", ""), each.get("where", ""))
        for each in run.checks
    ]  # fmt: skip
    return table(("", "number", "value", "limit", "where"), rows, "wide")


def event_table(run: RunReport, events: Sequence[Mapping[str, Any]]) -> str:
    """The largest events of a catalogue."""
    sizes = ["–" if event["magnitude"] is None else f"{event['magnitude']:.2f}".replace("-", "−") for event in events]
    lasted = [None if event["end"] is None else event["end"] - event["start"] for event in events]
    rows = (
        ("length", "length", LENGTH),
        ("mean slip", "mean_slip", LENGTH),
        ("stress drop", "stress_drop", STRESS),
        ("net volume before", "injected", VOLUME),
    )
    return of_columns([
        run.column("begins", TIME, [event["start"] for event in events], unit=run.clock), ("magnitude", sizes),
        ("begins on", [event["fracture"] for event in events]), run.column("lasts", TIME, lasted, 3),
        *(run.column(word, dimension, [event[key] for event in events], 3) for word, key, dimension in rows),
    ], "wide")  # fmt: skip
