"""Quantities that a run writes: one row each, with name, dimension, place, formula and meaning.

Probes, histories, fields, heads of CSV columns, labels of pictures and the reference derive from these rows; a scene names
them, so the table lies here. Published history variables of joint laws are rows too. A formula takes an object ``at``:

home     the formula takes                                                                    and gives
node     at.displacement, at.velocity, at.acceleration, of nodes of the rock, on a fracture   (n, dim)
         of its top wall
wall     at.bottom, displacement of the bottom wall at a probe on a fracture                  (dim,)
cell     at.strain, at.stress (m, 4), xx, yy, zz, xy; at.strain_energy, at.kinetic_energy     (m,), (m, 4)
         (m,), per volume of rock
section  at the ends of joints: at.sections, a ``model.state.Sections`` of arrays (j, 2,      (j, 2), (j, 2, dim-1),
         ...); at.rate (j, 2, dim) of its strain; at.friction (j, 2); at.history(NAME)        (j, 2, dim)
flow     there too: at.pressure, at.aperture, at.flow_rate (j, 2); at.specific_weight         (j, 2)
well     at.pressure, at.rate, at.volume, at.injectivity, of one well                         a number
network  at.volumes, a ``model.state.FluidVolumes``; at.unaccounted                           a number
run      at.step, an ``advance.step.Step``; at.snapshot, of all joint ends; at.kind           a number
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter as of
from typing import Any, Literal

import numpy as np
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from fracflow.laws import JOINT_LAWS, published_history
from fracflow.scene.units import (
    ACCELERATION,
    ENERGY,
    ENERGY_DENSITY,
    FLOW_RATE,
    INJECTIVITY,
    LENGTH,
    PLAIN,
    STRESS,
    SURFACE_ENERGY,
    TIME,
    VELOCITY,
    VOLUME,
)

Home = Literal["node", "wall", "cell", "section", "flow", "well", "network", "run"]
Kind = Literal["scalar", "shear", "vector", "tensor"]
Missing = Callable[[Any, Sequence[Any]], str]

TENSOR = {4: ("xx", "yy", "zz", "xy"), 6: ("xx", "yy", "zz", "xy", "yz", "xz")}
REGIMES = ("steady", "quasi-static", "dynamic", "equilibrate")
"""Names of the numbers of ``step/kind``."""


def _everywhere(scene: Any, fractures: Sequence[Any]) -> str:
    return ""


def _flow(scene: Any, fractures: Sequence[Any]) -> str:
    return "" if scene.has_flow else "the scene models no flow: it needs a [fluid]"


def _weight(scene: Any, fractures: Sequence[Any]) -> str:
    known = scene.fluid is not None and scene.fluid.specific_weight
    return _flow(scene, fractures) or ("" if known else "needs [fluid] with specific_weight")


def _aperture(scene: Any, fractures: Sequence[Any]) -> str:
    given = fractures and all(table.aperture is not None for table in fractures)
    return "" if scene.has_flow or given else "{where} is given none"


def _dilation(scene: Any, fractures: Sequence[Any]) -> str:
    return "" if any(table.dilates for table in fractures) else "{where} has no dilation_angle_deg"


def _history(name: str) -> Missing:
    def missing(scene: Any, fractures: Sequence[Any]) -> str:
        known = fractures and all(name in JOINT_LAWS[table.law].history for table in fractures)
        return "" if known else "{where} has a law without it"

    return missing


@dataclass(frozen=True)
class OutputQuantity:
    """A row of the table.

    name       key in histories and fields; of the whole run its path in history.h5
    formula    gives its values from what is known at its home
    kind       "scalar"; "shear" (..., dim-1), along the fracture; "vector" (..., dim); "tensor" (..., 4)
    default    whether a probe that names no quantities writes it
    field      whether it is among the fields
    drawn      whether probes.png has a panel of it
    label      on the axes of pictures; the name if it is not given
    of_slopes  whether it derives from slopes of displacement or pressure, and so converges an order later
    missing    (scene, tables of the fractures at a place) -> why it is not there; empty where it is
    """

    name: str
    dimension: str
    home: Home
    formula: Callable[[Any], Any]
    meaning: str
    kind: Kind = "scalar"
    default: bool = True
    field: bool = True
    drawn: bool = True
    label: str = ""
    of_slopes: bool = False
    missing: Missing = _everywhere

    @property
    def axis(self) -> str:
        """Its label on an axis of a picture."""
        return self.label or self.name.replace("_", " ")

    @property
    def is_rate(self) -> bool:
        """Whether it is a change in time: of a vibration, however small, most of it."""
        return "/time" in self.dimension

    def width(self, dim: int) -> int:
        """Number of its components in ``dim`` dimensions."""
        return {"scalar": 1, "shear": dim - 1, "vector": dim, "tensor": 4}[self.kind]


def magnitude(vectors: Any) -> Any:
    """Lengths (...) of vectors (..., t); of one component exactly its size."""
    return np.abs(np.hypot.reduce(np.asarray(vectors), axis=-1))


Q = OutputQuantity
_ROWS = (
    Q("displacement", LENGTH, "node", of("displacement"), "of the rock; on a fracture, of its top wall, the left of the trace",
      "vector", label="displacement along its main direction"),
    Q("displacement_bottom", LENGTH, "wall", of("bottom"), "of the bottom wall, the right of the trace", "vector", drawn=False),
    Q("velocity", VELOCITY, "node", of("velocity"), "of the rock; on a fracture, of its top wall", "vector", drawn=False),
    Q("acceleration", ACCELERATION, "node", of("acceleration"), "of the rock; on a fracture, of its top wall", "vector",
      field=False, drawn=False),
    Q("slip", LENGTH, "section", lambda at: at.sections.strain[..., :-1], "tangential jump, top minus bottom", "shear"),
    Q("dilation", LENGTH, "section", lambda at: at.sections.inelastic[..., -1], "part of the opening that slip has brought",
      missing=_dilation),
    Q("plastic_slip", LENGTH, "section", lambda at: at.sections.inelastic[..., :-1], "slip less its elastic part", "shear"),
    Q("slip_rate", VELOCITY, "section", lambda at: at.rate[..., :-1], "rate of the slip at the instant", "shear"),
    Q("opening", LENGTH, "section", lambda at: at.sections.strain[..., -1], "normal jump, positive apart"),
    Q("aperture", LENGTH, "flow", of("aperture"), "(3.1b) initial aperture and opening", missing=_aperture),
    Q("shear_traction", STRESS, "section", lambda at: at.sections.traction[..., :-1], "of the joint", "shear", of_slopes=True),
    Q("normal_traction", STRESS, "section", lambda at: at.sections.traction[..., -1], "effective, tension positive",
      of_slopes=True),
    Q("strength", STRESS, "section", of("sections.strength"), "(2.12) peak shear strength at the present normal traction",
      drawn=False, of_slopes=True),
    Q("utilisation", PLAIN, "section", of("sections.utilisation"), "shear traction over strength, 0 where open", default=False),
    Q("sliding", PLAIN, "section", of("sections.is_sliding"), "1 where the section slides, else 0", default=False, drawn=False),
    Q("open", PLAIN, "section", of("sections.is_open"), "1 where the walls are apart, else 0", default=False, drawn=False),
    Q("margin", PLAIN, "section", of("sections.margin"), "distance of the status from its threshold, over the strength",
      default=False, field=False, drawn=False),
    Q("stored_energy", SURFACE_ENERGY, "section", of("sections.stored"), "stored since the start", default=False),
    Q("friction_energy", SURFACE_ENERGY, "section", of("friction"), "(2.27b) dissipated by friction since the start",
      default=False),
    Q("pressure", STRESS, "flow", of("pressure"), "of the fluid, positive in compression", missing=_flow),
    Q("head", LENGTH, "flow", lambda at: at.pressure / at.specific_weight, "(3.5) pressure over specific weight", drawn=False,
      missing=_weight),
    Q("flow_rate", FLOW_RATE, "flow", of("flow_rate"), "along the fracture, over the whole flow_depth", of_slopes=True,
      missing=_flow),
    Q("stress", STRESS, "cell", of("stress"), "total, tension positive", "tensor", drawn=False, of_slopes=True),
    Q("strain", PLAIN, "cell", of("strain"), "since the start; xy is half the engineering shear", "tensor", drawn=False,
      of_slopes=True),
    Q("strain_energy_density", ENERGY_DENSITY, "cell", of("strain_energy"), "stored since the start", default=False),
    Q("kinetic_energy_density", ENERGY_DENSITY, "cell", of("kinetic_energy"), "of the rock", default=False),
    Q("well/pressure", STRESS, "well", of("pressure"), "at a well; of a side, the mean of its fracture ends"),
    Q("well/rate", FLOW_RATE, "well", of("rate"), "that a well brings, mean over the step; negative where it draws"),
    Q("well/volume", VOLUME, "well", of("volume"), "that it has brought since the start, the sum of rate times dt"),
    Q("well/injectivity", INJECTIVITY, "well", of("injectivity"), "rate over pressure less initial pressure"),
    Q("well/limit", PLAIN, "well", of("limit"),
      "of a well with one: 0 it brings its flow rate, 1 its pressure is kept at a limit, 2 it is shut", drawn=False),
    Q("volume/injected", VOLUME, "network", of("volumes.into"), "what wells have brought, over the whole flow_depth"),
    Q("volume/withdrawn", VOLUME, "network", of("volumes.out_of"), "what they have drawn"),
    Q("volume/stored", VOLUME, "network", of("volumes.stored"), "what fractures have taken up, but for steady stages"),
    Q("volume/by_fracture_pressures", VOLUME, "network", of("volumes.by_fractures"),
      "what prescribed pressures of fractures have brought"),
    Q("volume/unaccounted", VOLUME, "network", of("unaccounted_volume"),
      "injected less withdrawn, stored and what left by terms, with that of fracture pressures: round-off"),
    Q("time", TIME, "run", of("step.state.time"), "of the state"),
    Q("step/dt", TIME, "run", of("step.dt"), "length of the step"),
    Q("step/stage", PLAIN, "run", of("step.stage"), "number of the stage, from 0"),
    Q("step/kind", PLAIN, "run", of("kind"), ", ".join(f"{n} {name}" for n, name in enumerate(REGIMES))),
    Q("step/newton", PLAIN, "run", of("step.report.newton"), "Newton iterations"),
    Q("step/krylov", PLAIN, "run", of("step.report.krylov"), "iterations of linear solvers"),
    Q("step/coupling", PLAIN, "run", of("step.report.cycles"), "cycles between rock and flow"),
    Q("step/factorisations", PLAIN, "run", of("step.report.factorisations"), "of matrices"),
    Q("step/predicted_factor", PLAIN, "run", of("step.report.predicted"), "of the error in a cycle of the fixed point"),
    Q("step/measured_factor", PLAIN, "run", of("step.report.measured"), "of the error in its last two cycles"),
    Q("step/handed_over", PLAIN, "run", lambda at: int(bool(at.step.report.handed_over)),
      "1 where the fixed point left the step to the monolithic solver"),
    Q("step/solid_residual", PLAIN, "run", of("step.report.solid_residual"), "of the balance of forces, relative"),
    Q("step/round_off", PLAIN, "run", of("step.report.round_off"), "that displacements of finite digits leave of it"),
    Q("step/flow_residual", PLAIN, "run", of("step.report.flow_residual"), "of the balance of volumes, relative"),
    Q("step/slipping", PLAIN, "run", lambda at: int(at.snapshot.flag("sliding").sum()), "joint ends that slide"),
    Q("step/open", PLAIN, "run", lambda at: int(at.snapshot.flag("open").sum()), "joint ends that are open"),
    Q("step/slip_margin", PLAIN, "run", of("snapshot.margin"), "smallest margin of a joint end"),
    Q("step/minimum_aperture", PLAIN, "run", lambda at: at.snapshot.least[0],
      "joint ends that conduct by their minimum aperture"),
    Q("step/minimum_aperture_flow", PLAIN, "run", lambda at: at.snapshot.least[1],
      "most flow through one of them [length**3/time]"),
    Q("step/digits", PLAIN, "run", of("step.report.digits"),
      "fewest digits that round-off leaves of the tractions of a fracture"),
    Q("step/located", PLAIN, "run", of("step.report.located"), "sections whose friction changes at the end of the step"),
    Q("step/rejected", PLAIN, "run", of("step.report.rejected"), "trials thrown away on the way to the step"),
    Q("step/wasted", PLAIN, "run", of("step.report.wasted"), "Newton iterations spent on those"),
    Q("step/widening", PLAIN, "run", of("step.report.grown"), "largest factor by which an aperture grew"),
)  # fmt: skip
QUANTITIES: dict[str, OutputQuantity] = {row.name: row for row in _ROWS}
"""The table by name; a row that is put in from outside is everywhere that the others are."""


def quantities(*homes: Home) -> dict[str, OutputQuantity]:
    """Rows by name, those of the named homes or all, with the published history variables of joint laws."""
    rows = dict(QUANTITIES)
    for name, variable in published_history(JOINT_LAWS.values()).items():
        rows.setdefault(name, _of_history(name, variable.dimension, variable.meaning, variable.kind))
    return {name: row for name, row in rows.items() if row.home in homes or not homes}


def _of_history(name: str, dimension: str, meaning: str, kind: Kind) -> OutputQuantity:
    return Q(name, dimension, "section", lambda at: at.history(name), meaning, kind, missing=_history(name))


def probed() -> dict[str, OutputQuantity]:
    """Rows that a probe may name."""
    return quantities("node", "wall", "cell", "section", "flow")


def row_of(key: str) -> OutputQuantity | None:
    """The row behind a key of history.h5; None for energies, controls and keys that no row has."""
    if key.startswith("well/"):
        return quantities("well").get(f"well/{key.rpartition('/')[2]}")
    return quantities().get(key.rpartition("/")[2] if key.startswith("probe/") else key)


def dimension_of(key: str) -> str:
    """Dimension of a key of history.h5; "1" where no row has it."""
    row = row_of(key)
    if row is None and key.startswith("volume/"):
        return VOLUME
    return ENERGY if key.startswith("energy/") else PLAIN if row is None else row.dimension


def component_names(name: str, kind: Kind | None, count: int) -> list[str]:
    """Heads of the columns of a quantity with ``count`` components: slip, or slip_1, slip_2; None for an unknown kind."""
    if kind == "scalar" or (kind == "shear" and count == 1):
        return [name]
    along = tuple("123"[:count])
    parts = along if kind == "shear" else ("x", "y", "z")[:count] if count < 4 else TENSOR.get(count, range(count))
    return [f"{name}_{part}" for part in parts]


def with_components(name: str, vector: Any) -> dict[str, float]:
    """The components (t,) of a vector along a fracture by the heads of their columns."""
    return dict(zip(component_names(name, "shear", len(vector)), np.asarray(vector).tolist(), strict=True))


def one_less(values: Any) -> Any:
    """Values (..., 1) as a plane scene has them on disk, (...); others as they are."""
    array = np.asarray(values)
    return array[..., 0] if array.ndim and array.shape[-1] == 1 else array


class MeasuredName:
    """Annotation of a scene value that names a quantity of a probe."""

    @staticmethod
    def read(name: str) -> str:
        """The name, if a probe may measure it. Raises PydanticKnownError for another."""
        if name in probed():
            return name
        raise PydanticKnownError("literal_error", {"expected": ", ".join(f"'{each}'" for each in probed())})

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let pydantic read the name with ``read``."""
        return core_schema.no_info_after_validator_function(self.read, core_schema.str_schema())

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """List the names for ``fracflow schema``, each with its dimension and meaning."""
        meanings = {name: (row.dimension, row.meaning) for name, row in probed().items()}
        return {"type": "string", "enum": list(meanings), "quantities": meanings}
