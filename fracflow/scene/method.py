"""The tables of a scene that say where it happens, how to compute, and what to write."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    create_model,
)

from fracflow.integrators import flow_integrators, keys_of, with_inertia
from fracflow.laws import FLOW_LAWS
from fracflow.scene.laws import OTHERWISE, foreign_keys
from fracflow.scene.meanings import meanings
from fracflow.scene.units import LENGTH, LINE_FORCE, STRESS, TIME_UNITS, Quantity, UnitSystem, fault, time_unit
from fracflow.scene.values import Domain, Polyline
from fracflow.storage.files import PLAIN_TEXT

Points = tuple[tuple[float, float], ...]
Count = Annotated[int, Field(strict=True, ge=1, le=10**12)]  # of steps: less than floats count exactly
LONGEST_NAME, LONGEST_PATH = 250, 4000
Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=f"^{PLAIN_TEXT}$")]
FileName = Annotated[str, Field(min_length=1, max_length=LONGEST_PATH, pattern=f"^{PLAIN_TEXT}$")]
Line = Annotated[str, Field(max_length=1000, pattern=f"^({PLAIN_TEXT})?$")]
Fraction = Annotated[float, Quantity(above=0.0, below=1.0)]
Stress = Annotated[float, Quantity(STRESS)]
Size = Annotated[float, Quantity(LENGTH, above=0.0)]
MOST_REFINED = 12
Refine = Annotated[int, Field(strict=True, ge=0, le=MOST_REFINED)]
REFINED = "times that every cell of the mesh is cut in four like ones, which leaves its nodes where they are"
MULTIPOLES_FROM = 500  # joints of unmeshed rock from which on near entries and series take less than all entries


def _option(value: object) -> object:
    if not isinstance(value, bool | int | float | str):
        raise fault("must be a string, a number, or true or false")
    return value


Option = Annotated[StrictBool | StrictInt | StrictFloat | StrictStr, BeforeValidator(_option)]


def _with_meanings(schema: dict[str, Any], table: type[BaseModel]) -> None:
    """Put the meanings of keys into the schema of a table."""
    for key, text in meanings(table).items():
        schema["properties"][key]["description"] = text


class Table(BaseModel):
    """A table of a scene: frozen, and refuses keys it does not know; the docstring of a key is its meaning."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra=_with_meanings, defer_build=True)

    def _refuse(self, why: str, *keys: str) -> None:
        """Raise the fault of the first of some keys that is given."""
        for key in keys:
            if getattr(self, key) is not None:
                raise fault(why, key=key)


if TYPE_CHECKING:
    InertiaStepper: TypeAlias = str
    FlowStepper: TypeAlias = str
    Conductance: TypeAlias = str
    TimeUnit: TypeAlias = str
    StepperKeys: Any = Table
else:
    InertiaStepper, FlowStepper = Literal[tuple(with_inertia())], Literal[tuple(flow_integrators())]
    Conductance, TimeUnit = Literal[tuple(FLOW_LAWS)], Literal[tuple(TIME_UNITS)]
    StepperKeys = create_model(
        "StepperKeys",
        __base__=Table,
        **{
            key: (Annotated[float, Quantity(**limits)], Field(default=default, description=meaning))
            for key, (default, meaning, limits) in keys_of(with_inertia()).items()
        },
    )


class Method(StepperKeys):
    """[method] How the equations are discretised and solved; defaults follow from ``model``."""

    quadrature: Literal["nodal", "gauss2", "one-point"] = "nodal"
    """points where a joint keeps its state: its ends (2.30), two Gauss points, its middle"""
    storage: Literal["lumped", "consistent", "averaging", "report", "consistent-lumped"] = "lumped"
    """matrices of pressure force and fracture storage; lumped, consistent (2.37) and averaging (3.16) use one for both;
    report is (2.37) with (3.16), consistent-lumped (2.37) with lumped: the balance has their spurious work"""
    conductance: Conductance = "front"
    """mean of the cubed aperture over a tapered element: exact two-node mean; front adds to it what a front of opening lets
    through, where ends part by more than the aperture at rest; report is (3.14f)"""
    mass: Literal["lumped", "consistent"] = "lumped"
    """mass matrix of the rock"""
    tips: Literal["plain", "corrected"] = "plain"
    """energy of meshed rock at ends of fractures inside it, in the plane. Plain: as the cells have it; openings and slips are
    too small by about 0.4 joint over half length. Corrected: less what cells have too much of a crack's end, counted as tips in
    the energy balance; about a tenth of it is left where fractures open or slide, more where joints hold the walls. Cells that
    grow away from fractures leave their own. Ends beside other fractures or sides stay plain, and the log counts them. The
    default in an unbounded domain, whose events are meshed, is corrected"""
    contact: Literal["redistributed", "lumped"] = "redistributed"
    """inertia of fracture walls along their normal in dynamic stages: carried by the nodes next to them inside the
    rock, so that walls do not bounce on joints, or by the walls; lumped is the default of scenes with a fluid, which
    damps them, of explicit steps, and of model = "report"
    """
    flow_integrator: FlowStepper = "backward-euler"
    """time integrator of quasi-static stages: first order and monotone, or second order (bdf2), the default of scenes
    that state accuracy.tolerance; trapezoid rings for time steps above two drainage times; the first step of a stage is
    one of backward Euler"""
    stepper: InertiaStepper = "newmark"
    """time integrator of dynamic stages: newmark (4.1)-(4.3); hht and generalised-alpha, which damp what the time step
    does not resolve and are of second order; implicit-euler, of first order, which damps all; explicit, central
    differences of the rock with joints and flow solved at the end of each step, in stable substeps"""
    fault_damping: Literal["auto"] | Annotated[float, Quantity(at_least=0.0)] = "auto"
    """damping of the fastest vibration of the cells at fractures that can slide, over the critical one, in explicit
    steps: what the mesh cannot carry would ring in their normal traction, and drive slip; auto: 0.45 where a prescribed
    pressure takes strength away at once, else 0.25 where the walls are not meshed as mirror images; 0 is none, and the
    default of model = "report"; it begins with the first section that slides or opens; counted as damping in the energy
    balance [1]"""
    radiation_damping: Literal["auto", "none"] = "auto"
    """energy that slip sends off as waves in stages without inertia: auto takes the traction G/(2 c_s) times the rate of slip
    from what friction carries, on fractures of law = "rate-and-state", G and c_s of the rocks beside; where inertia comes in
    the rock itself carries the waves; counted as radiated in the energy balance"""
    coupling: Literal["auto", "monolithic", "fixed-point", "whole-lu", "condensed"] = "auto"
    """how rock and fluid are solved together: at once, by iterations over both parts (monolithic), by one direct solve
    (whole-lu); by turns (4.5); on the fractures alone, with the rock condensed to them once for each length of time
    step; or by auto: condensed where enough steps are planned for it to pay, else whole-lu, but monolithic with multigrid,
    where options are given to it, and where the direct solve does not converge"""
    rock_solver: Literal["auto", "direct", "multigrid", "multipoles"] = "auto"
    """how the rock of a coupled step is solved: by a factorisation; or by multigrid with strips along the fractures, whose
    iterations do not grow as joints slide or open. Auto takes the faster one by an estimate: multigrid from 4e5
    displacements on, and where factors would not fit into memory. Rock that is not meshed has an entry for each two of its
    joints with direct; multipoles, which auto takes from 500 joints on, has series for joints far from each other, equal to
    1e-10, and iterations with factors of near entries"""
    fixed_point: Literal["plain", "aitken", "anderson", "added-storage"] = "plain"
    """how the pressures of the fixed point (4.5) go on: as the flow gives them, relaxed by Aitken or Anderson, or with
    storage added to the flow"""
    on_divergence: Literal["refuse", "monolithic"] = "refuse"
    """what to do with a step whose fixed point (4.5) diverges, by prediction or by measurement"""
    events: Literal["auto", "located", "at-step-ends"] = "auto"
    """changes of friction, opening and closing in dynamic stages: each ends a substep (located), or is taken as the end
    of a step finds it; auto: located where no rock deforms, and while fewer than 16 sections slide, twice as many for
    each refine"""
    newton: Literal["newton", "modified", "secant"] = "newton"
    """stiffness that an iteration corrects by: the tangent (4.7), that of the step's start (4.10), the secant"""
    factors: Literal["kept", "new"] = "kept"
    """factors of a matrix that joints have changed since: they precondition GMRES as long as that is cheaper, or new
    ones are made in every iteration, as in model = "full" and "report"
    """
    overshoot: Literal["hold", "one-change"] = "hold"
    """when joints may change between sticking and sliding: once the balances hold with the statuses there were, or in
    every iteration, but each section once only (5.1): an overshoot may then end in a sliding state where an elastic one
    exists"""
    line_search: Literal["none", "residual", "energy"] = "energy"
    """measure that shortens a step of Newton once joints open and close in cycles, or whole steps do not converge:
    nothing, the size of the residual, or the work that the unbalanced forces do along the step"""
    newton_test: Literal["residual", "out-of-balance", "displacement"] = "residual"
    """when Newton stops: scaled residuals, (4.9a), or (4.9b)"""
    tangent: Literal["consistent", "decoupled"] = "consistent"
    """joint tangent with d f_s/d opening, or k_s and k_n alone"""
    open_strength: Literal["none", "cohesion"] = "none"
    """shear strength of an open joint: none, or the cohesion (2.12)"""

    PRESETS: ClassVar[dict[str, dict[str, str | float]]] = {
        "default": {},
        "full": {"events": "located", "factors": "new"},
        "report": {
            "factors": "new",
            "storage": "report",
            "conductance": "report",
            "events": "at-step-ends",
            "contact": "lumped",
            "fault_damping": 0.0,
            "newton_test": "out-of-balance",
            "tangent": "decoupled",
            "open_strength": "cohesion",
        },
    }


class Output(Table):
    """[output] Files that a run writes beside its histories."""

    fields_every: Annotated[int, Field(strict=True, ge=0)] = 0
    """write whole fields every so many steps; 0 writes the first and the last state only"""
    checkpoint_every: Annotated[int, Field(strict=True, ge=0)] = 0
    """save the state every so many steps; 0 leaves it to the clock, to signals and to failures"""
    checkpoint_seconds: Annotated[float, Quantity(above=0.0)] = 60.0
    """save the state when so many seconds of wall clock have passed [s]"""
    event_length: Size | None = None
    """width of events of a stage auto across the plane, for magnitudes [length]"""
    time_unit: TimeUnit | None = None
    """unit of times in pictures and tables; by default that of the last end, or else time_step, which the
    stages give with a unit"""
    pictures: StrictBool = True
    """draw pictures for the report page"""
    vtkhdf: StrictBool = True
    """write fields.vtkhdf beside the XDMF files, all fields in one file for ParaView 5.12 or later"""


class Trace(Table):
    """[[geometry.fracture]] A fracture as a polyline."""

    name: Name
    """name that [fracture.NAME] refers to"""
    points: Annotated[Points, Polyline()]
    """[[x, y], ...] from its start to its end [length]"""


class Geometry(Table):
    """[geometry] A domain with fracture traces, meshed by the program; its rock is called "rock"."""

    domain: Annotated[Points | str, Domain("unbounded")]
    """[xmin, ymin, xmax, ymax] or the corners [[x, y], ...] [length]; or "unbounded": rock without sides, not meshed"""
    fracture: tuple[Trace, ...] = ()
    """fracture traces; they may cross, and reach the boundary"""
    fractures_csv: FileName | None = None
    """file of more traces and their properties, relative to the scene, a table or a map.geojson; a loaded scene has them in its
    place"""
    size: Size | None = None
    """mesh size away from fractures [length]; if not given, both sizes follow from the lengths of the scene"""
    size_at_fractures: Size | None = None
    """mesh size at fractures [length]; as size if only that is given"""
    size_at_tips: Size | None = None
    """mesh size at ends of fractures inside the rock, in an unbounded domain also where they meet [length]; as
    size_at_fractures if not given. An end of one that meets another at under 15 degrees has at most 1/16 of their
    distance there"""
    growth: Annotated[float, Quantity(above=0.0, at_most=1.0)] | None = None
    """growth of the mesh size per length away from the fractures; if not given, 1.6 (joint/fracture length)^(1/2), at most 0.3,
    or 0.1 where these weaken with slip [1]"""
    snap: Size | None = None
    """longest miss that is closed [length]: points of traces within it become one; an end or bend within it of a trace or
    side moves onto it; an end no farther beyond what it crosses is taken back. A crossing moves to points alone. Larger misses
    stay, and fracflow check lists those of up to five times this with their distance: a larger snap lists farther ones. Cells
    between near traces are never under twice as long. If not given, 0.4 % of the median length of traces, whatever the mesh"""
    cells: Literal["triangles", "quads"] = "triangles"
    """shape of the cells"""
    event_margin: Size | None = None
    """of an unbounded domain with a stage auto: rock around the fractures that is meshed once an event needs inertia, up to
    absorbing sides [length]; if not given, twice the larger extent of the fractures"""
    refine: Refine = Field(default=0, description=REFINED)

    @property
    def is_unbounded(self) -> bool:
        """Whether the rock has no sides."""
        return isinstance(self.domain, str)

    @property
    def outline(self) -> Points:
        """The corners of the domain, or of a box around the traces of an unbounded one, twice as wide [length]."""
        if not isinstance(self.domain, str):
            return self.domain
        x, y = zip(*(point for trace in self.fracture for point in trace.points), strict=True)
        more = 0.5 * max(max(x) - min(x), max(y) - min(y))
        left, bottom, right, top = min(x) - more, min(y) - more, max(x) + more, max(y) + more
        return (left, bottom), (right, bottom), (right, top), (left, top)


class Mesh(Table):
    """[mesh] A Gmsh geometry or a mesh; its physical groups, or sets, name rocks, fractures, sides and points."""

    file: FileName
    """.geo or .msh file of Gmsh, or a mesh of another program: .inp (Abaqus), .vtu, .e or .exo (Exodus), .xdmf with its
    .h5 beside it; or a split mesh, the .h5 of fracflow mesh; relative to the scene"""
    refine: Refine = Field(default=0, description=REFINED)


def with_preset(data: dict[str, Any]) -> dict[str, Any]:
    """Fill the keys of [method] that a scene leaves open from its model, domain, stepper, fluid and accuracy."""
    preset, method = Method.PRESETS.get(str(data.get("model", "default")), {}), data.get("method", {})
    if not isinstance(method, dict):
        return data
    if "fluid" in data or method.get("stepper") == "explicit":  # both take velocities of walls from their mass
        preset = {**preset, "contact": "lumped"}
    geometry = data.get("geometry", {})
    if isinstance(geometry, dict) and geometry.get("domain") == "unbounded" and "version" not in data:
        preset = {**preset, "tips": "corrected"}  # as those of rock without a mesh are; runs of earlier versions go on
    accuracy = data.get("accuracy", {})
    if isinstance(accuracy, dict) and {"tolerance", "step_error"} & accuracy.keys() and data.get("model") != "report":
        preset = {**preset, "flow_integrator": "bdf2"}  # overshoots less than errors may be
    return {**data, "method": {**preset, **method}}


def with_time_unit(data: dict[str, Any]) -> dict[str, Any]:
    """Set ``output.time_unit``, where it is open, to the unit of the last end, or else time_step, written with one."""
    output, stages = data.get("output", {}), data.get("stage", ())
    if not isinstance(output, dict) or "time_unit" in output or not isinstance(stages, list | tuple):
        return data
    try:
        has_seconds = UnitSystem.parse(data.get("units", "SI")).time == "s"
    except ValueError:
        return data
    written = [stage.get(key) for key in ("end", "time_step") for stage in reversed(stages) if isinstance(stage, dict)]
    unit = time_unit(next((text for text in written if isinstance(text, str)), ""))
    return {**data, "output": {**output, "time_unit": unit}} if unit and has_seconds else data


ALTERNATIVES = tuple(OTHERWISE.items())


def with_default_fracture(data: dict[str, Any]) -> dict[str, Any]:
    """Fill the keys that a fracture's own table leaves open from [fracture.default]."""
    tables = data.get("fracture")
    default = tables.get("default") if isinstance(tables, dict) else None
    if not isinstance(tables, dict) or not isinstance(default, dict):
        return data

    def filled(table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        shut = {key for pair in ALTERNATIVES if set(pair) & set(table) for key in pair}
        shut |= foreign_keys(table.get("law"))
        return {key: value for key, value in default.items() if key not in shut} | table

    whole = {name: filled(table) for name, table in tables.items()}
    if _is_spare(data, tables, default):
        del whole["default"]
    return {**data, "fracture": whole}


def _is_spare(data: dict[str, Any], tables: dict[str, Any], default: dict[str, Any]) -> bool:
    """Whether [fracture.default] only fills: every trace has a table of its own with a key that it has not."""
    geometry = data.get("geometry")
    traces = geometry.get("fracture") if isinstance(geometry, dict) else None
    drawn = traces if isinstance(traces, list | tuple) else ()
    names = [trace.get("name") for trace in drawn if isinstance(trace, dict)]
    own = [tables.get(name) for name in names if isinstance(name, str)]
    more = [set(table) - set(default) for table in own if isinstance(table, dict)]
    return bool(names) and len(more) == len(names) and bool(set.intersection(*more))


class Accuracy(Table):
    """[accuracy] How accurate results are to be, when an iteration has converged, and when it is given up."""

    residual: Fraction = 1e-11
    """largest residual relative to what drives it (default test) [1]"""
    out_of_balance: Annotated[float, Quantity(LINE_FORCE, above=0.0)] | None = None
    """epsilon_S of (4.9a), absolute, per unit thickness [force/length]; without it the residuals decide"""
    displacement: Fraction = 1e-12
    """relative change of displacement of (4.9b) [1]"""
    pressure: Fraction = 1e-10
    """epsilon_F of the fixed point (4.5), relative [1]"""
    digits: Annotated[int, Field(strict=True, ge=0, le=15)] = 6
    """digits that round-off must leave of the joint tractions, and of what wells with a pressure draw, or the run
    stops; 0 lets it go on [1]"""
    max_iterations: Count = 50
    """Newton iterations of a step before it is halved or given up"""
    max_halvings: Annotated[int, Field(strict=True, ge=0, le=30)] | None = None
    """times that a step which does not converge is halved before the run stops; if not given 6, but 12 in a stage
    quasi-static that fills fractures without a step_error and without strength that falls with slip"""
    tolerance: Fraction | None = None
    """error of results that time steps may make in a stage, over its largest change since it began: steps are cut in
    substeps whose estimated errors add up to no more; with inertia of displacements, without it of the volume stored in
    fractures; if not given, every step is of length time_step [1]"""
    step_error: Fraction | None = None
    """largest error of displacement that a step may add, over the largest displacement so far: longer steps are halved,
    at most max_halvings times; takes the place of tolerance [1]"""
    slip_share: Fraction = 0.1
    """slip of a step without inertia over characteristic_slip, at most, on fractures of law = "rate-and-state": dt is at most
    that share of D_c/V; where slip slows down, V dt/D_c (ln V/V_old)^2 is at most its cube; with a tolerance steps are also
    so short that the error of their slip is below that share of it [1]"""
    dynamic_slip_share: Fraction | None = None
    """the same bound, V dt/D_c, of steps with inertia: these are halved until V dt/D_c is below it; if not given, their
    length is that of the scene, and the log has a line where they slip over characteristic_slip; not for stepper =
    "explicit" [1]"""
    max_events: Annotated[int, Field(strict=True, ge=0)] = 20
    """events of joints in a step that parts of it end at; later ones are taken as they fall"""
    max_cycles: Count = 50
    """cycles of the fixed point (4.5) before it is given up"""
