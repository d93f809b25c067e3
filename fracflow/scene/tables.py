"""The tables of a scene: their keys, and what follows from them."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, Field, PrivateAttr, model_validator
from typing_extensions import Self

from fracflow._version import __version__
from fracflow.errors import InputError
from fracflow.laws import JOINT_LAWS
from fracflow.scene.boundary import Control, Load, Probe, Stage, Support, Tie, Well
from fracflow.scene.materials import BodyForce, Fluid, Fracture, Initial, InitialStress, Rock
from fracflow.scene.messages import nearest
from fracflow.scene.method import (
    Accuracy,
    Geometry,
    Line,
    Mesh,
    Method,
    Option,
    Output,
    with_default_fracture,
    with_preset,
    with_time_unit,
)
from fracflow.scene.site import Site
from fracflow.scene.terms import Absorbing, TablesOfLaws, TermTable
from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import UnitSystem, stated_time, suited_time

_PLAIN_TIME = re.compile(r"\btime (-?\d[\d.]*(?:e[-+]\d+)?)(?=[:,]|$)")


class Tables(TablesOfLaws):
    """All tables of a scene, each by itself valid."""

    version: str = __version__
    """version of fracflow that wrote the file"""
    title: Line = ""
    """one line for reports"""
    units: str = "SI"
    """units of plain numbers: "SI", LENGTH-FORCE-TIME such as "ft-lbf-s", or "none"
    """
    model: Literal["default", "report", "full"] = "default"
    """report: the choices of the 1976 report; full: the plan leaves nothing out"""
    method: Method = Field(default_factory=Method)
    """how the equations are discretised and solved"""
    petsc: dict[str, Option] = Field(default_factory=dict)
    """PETSc options, without the leading dash: methods, tolerances, limits; others at the command line after --"""
    accuracy: Accuracy = Field(default_factory=Accuracy)
    """how accurate results are to be; when iterations have converged"""
    output: Output = Field(default_factory=Output)
    """files that a run writes beside its histories"""
    site: Site | None = None
    """where on Earth the scene lies, and when it begins"""
    geometry: Geometry | None = None
    """domain and fracture traces; or give mesh"""
    mesh: Mesh | None = None
    """Gmsh geometry or mesh; or give geometry"""
    rock: dict[str, Rock] = Field(default_factory=dict)
    """rocks by name"""
    initial_stress: InitialStress | None = None
    """stress before the first step"""
    body_force: BodyForce | None = None
    """forces on the volume of the rock"""
    initial: Initial | None = None
    """a start away from the initial equilibrium"""
    fracture: dict[str, Fracture] = Field(default_factory=dict)
    """fractures by name; "default" serves those without a table"""
    fluid: Fluid | None = None
    """the fluid in the fractures; without it no flow is modelled"""
    support: tuple[Support, ...] = ()
    """displacements that are held or given"""
    load: tuple[Load, ...] = ()
    """tractions on sides"""
    tie: tuple[Tie, ...] = ()
    """sides that move as one, or as each other"""
    absorbing: tuple[Absorbing, ...] = ()
    """sides that waves leave through"""
    well: tuple[Well, ...] = ()
    """where fluid is pumped, or its pressure kept"""
    control: dict[str, Control] = Field(default_factory=dict)
    """factors that wells and loads share"""
    probe: tuple[Probe, ...] = ()
    """places whose history is written"""
    stage: tuple[Stage, ...] = ()
    """the parts of the run, one after another"""

    _file: Path = PrivateAttr(default=Path("scene.toml"))
    _notes: tuple[str, ...] = PrivateAttr(default=())
    _trust: bool = PrivateAttr(default=False)

    @model_validator(mode="before")
    @classmethod
    def _resolve_method(cls, data: Any) -> Any:
        return with_default_fracture(with_preset(with_time_unit(data))) if isinstance(data, dict) else data

    @property
    def source(self) -> str:
        """The name of the scene file, as error messages give it."""
        return self._file.name

    @property
    def notes(self) -> tuple[str, ...]:
        """Why keys that its file leaves open have the values they have, a line each."""
        return self._notes

    @property
    def trust(self) -> bool:
        """Whether Gmsh may run the scene's .geo as it is; else only statements that make geometry are read."""
        return self._trust

    def with_trust(self) -> Self:
        """The scene as one whose .geo comes from an author who is trusted: Gmsh runs it as it is."""
        scene = self.model_copy()
        scene._trust = True
        return scene

    def with_geometry(self, keys: Mapping[str, float], notes: Sequence[str] = ()) -> Self:
        """The scene with keys of its [geometry] set, and why they are so."""
        if self.geometry is None or not keys:
            return self
        scene = self.model_copy(update={"geometry": self.geometry.model_copy(update=dict(keys))})
        scene._notes = (*self._notes, *notes)
        return scene

    @property
    def name(self) -> str:
        """The name of the scene's file without its ending, or of its folder where the file is called scene.toml."""
        stem = self._file.stem
        return stem if stem not in ("scene", "..") else self._file.resolve().parent.name

    @property
    def folder(self) -> Path:
        """The folder that file names in the scene are relative to."""
        return self._file.absolute().parent

    @property
    def mesh_path(self) -> Path | None:
        """The absolute path of the geometry or mesh file, None where the scene has [geometry]."""
        return None if self.mesh is None else Path(os.path.realpath(self.folder / self.mesh.file))

    @property
    def refine(self) -> int:
        """Times that every cell is cut in four."""
        table = self.mesh or self.geometry
        return 0 if table is None else table.refine

    @property
    def is_unbounded(self) -> bool:
        """Whether the rock has no sides, and no mesh."""
        return self.geometry is not None and self.geometry.is_unbounded

    @property
    def unit_system(self) -> UnitSystem:
        """The units of all numbers of the scene."""
        return UnitSystem.parse(self.units)

    @property
    def unit_names(self) -> dict[str, str]:
        """Names of the units of length, force and time, and as "shown_time" that of the author for times."""
        names = {part: str(getattr(self.unit_system, part)) for part in ("length", "force", "time")}
        return names | ({"shown_time": self.output.time_unit} if self.output.time_unit else {})

    def time_text(self, time: float, digits: int = 6) -> str:
        """A time [time] with the unit that the author uses, or else one that suits it."""
        factor, unit = stated_time(self.output.time_unit, time) or suited_time(self.unit_system.time, time)
        before = len(str(int(abs(factor * time)))) if abs(factor * time) < 1e15 else 0
        return f"{factor * time:.{max(digits, before)}g} {unit}".rstrip()

    def with_time_units(self, line: str) -> str:
        """A line for the log whose plain times, as in ``time 453600: ...``, have got the unit of ``time_text``."""

        def text(found: re.Match[str]) -> str:
            digits = len(re.sub(r"e.*|\D", "", found[1]))
            return f"time {self.time_text(float(found[1]), max(6, digits))}"

        return _PLAIN_TIME.sub(text, line)

    @property
    def has_flow(self) -> bool:
        """Whether flow is modelled: there is a fluid, and neither viscosity, weight nor density is zero."""
        fluid = self.fluid
        return fluid is not None and 0.0 not in (fluid.viscosity, fluid.specific_weight, fluid.density)

    @property
    def flow_depth(self) -> float:
        """Depth out of the plane that flow rates refer to [length]; 1 without a fluid."""
        return self.fluid.flow_depth if self.fluid is not None else 1.0

    @property
    def has_dynamics(self) -> bool:
        """Whether a stage has inertia, or may need it."""
        return any(stage.kind in ("dynamic", "auto") for stage in self.stage)

    @property
    def terms(self) -> tuple[TermTable, ...]:
        """All tables that add terms to the balances."""
        return tuple(entry for tables in self.term_tables.values() for entry in tables)

    @property
    def term_tables(self) -> Mapping[str, tuple[TermTable, ...]]:
        """The same by their keys."""
        given = {key: getattr(self, key) for key in type(self).model_fields}
        return {key: v for key, v in given.items() if isinstance(v, tuple) and v and isinstance(v[0], TermTable)}

    @property
    def leaks_off(self) -> bool:
        """Whether fractures lose fluid to porous rock."""
        return any(table.leak_off is not None for table in self.fracture.values())

    @property
    def creeps(self) -> bool:
        """Whether a fracture slips at any stress, at a rate that time steps follow."""
        return any(JOINT_LAWS[table.law].creeps for table in self.fracture.values())

    @property
    def radiates(self) -> bool:
        """Whether slip sends off energy in stages without inertia."""
        return self.creeps and self.method.radiation_damping == "auto"

    @property
    def is_drained(self) -> bool:
        """Whether fluid leaves fractures by terms."""
        return self.leaks_off or any(table.drains for table in self.terms)

    def drains(self, fracture: str) -> bool:
        """Whether fluid leaves this fracture by a term whose rate its pressure settles at any time."""
        return any(table.drains and fracture in table.on for table in self.terms)

    def loses(self, fracture: str) -> bool:
        """The same, or whether it loses fluid to porous rock."""
        return self.drains(fracture) or self.fracture_named(fracture).leak_off is not None

    @property
    def time_tables(self) -> tuple[TimeTable, ...]:
        """All tables in time, constants among them."""
        return tuple(_tables(self))

    @property
    def jump_times(self) -> tuple[float, ...]:
        """Instants, ascending, at which a table in time jumps [time]."""
        return tuple(sorted({float(time) for table in self.time_tables for time in table.jumps[0]}))

    @property
    def driving_tables(self) -> tuple[TimeTable, ...]:
        """Tables in time of what sends waves into the rock: loads, supports, waves that come in."""
        return tuple(_tables((self.load, self.support, self.terms)))

    @property
    def jumps_anywhere(self) -> bool:
        """Whether something prescribed may jump at other instants than ``jump_times``.

        A support that is moved has kinks in its table; a wave that jumps arrives later at nodes further on.
        """
        moved = any(len(table.times) > 1 for support in self.support for table in _tables(support))
        return moved or any(len(wave.jumps[0]) > 0 for each in self.terms for wave in each.waves)

    @property
    def carries_unbalanced(self) -> bool:
        """Whether the rock carries what initial tractions of fractures and its own stress differ by."""
        return self.initial_stress is not None and self.initial_stress.unbalanced == "carried"

    @property
    def equilibrates(self) -> bool:
        """Whether the run begins by finding its own equilibrium."""
        return bool(self.stage) and self.stage[0].kind == "equilibrate"

    def fracture_named(self, name: str) -> Fracture:
        """Find the table of a fracture, or the default one; raises InputError where there is neither."""
        found = self.fracture.get(name) or self.fracture.get("default")
        if found is None:
            raise InputError(f"{self.source}: fracture.{name}: missing; {nearest(name, self.fracture)}")
        return found

    def is_of(self, fracture: str, table: str) -> bool:
        """Whether [fracture.TABLE] is the table of a fracture: by its name, or as the default one."""
        return table == fracture or (table == "default" and fracture not in self.fracture)


def _tables(thing: Any) -> Iterator[TimeTable]:
    """All tables in time that a part of a scene holds."""
    if isinstance(thing, TimeTable):
        yield thing
    elif isinstance(thing, BaseModel):
        for name in type(thing).model_fields:
            yield from _tables(getattr(thing, name))
    elif isinstance(thing, (list, tuple, Mapping)):
        for each in thing.values() if isinstance(thing, Mapping) else thing:
            yield from _tables(each)
