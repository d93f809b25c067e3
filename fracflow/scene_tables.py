"""The tables of a scene that say what the rock, the fractures and the fluid are, and how to compute."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    model_validator,
)

from fracflow.tables import Domain, Polyline
from fracflow.units import (
    ANGLE,
    DENSITY,
    LENGTH,
    LINE_FORCE,
    STIFFNESS,
    STRESS,
    VISCOSITY,
    WEIGHT,
    Quantity,
    fault,
)

Points = tuple[tuple[float, float], ...]
Count = Annotated[int, Field(strict=True, ge=1)]
Name = Annotated[str, Field(min_length=1)]
Fraction = Annotated[float, Quantity(above=0.0, below=1.0)]
Stress = Annotated[float, Quantity(STRESS)]
Stiffness = Annotated[float, Quantity(STIFFNESS, above=0.0)]
Size = Annotated[float, Quantity(LENGTH, above=0.0)]


def _option(value: object) -> object:
    if not isinstance(value, bool | int | float | str):
        raise fault("must be a string, a number, or true or false")
    return value


Option = Annotated[StrictBool | StrictInt | StrictFloat | StrictStr, BeforeValidator(_option)]


class Part(BaseModel):
    """A table of a scene: frozen, and refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Method(Part):
    """[method] How the equations are discretised and solved; defaults follow from ``model``."""

    quadrature: Literal["nodal", "gauss2", "one-point"] = Field(
        default="nodal",
        description="points where a joint keeps its state: its ends (2.30), two Gauss points, its middle",
    )
    storage: Literal["lumped", "report", "consistent"] = Field(
        default="lumped",
        description="matrices of pressure force and film storage; report: (2.37) with (3.16)",
    )
    conductance: Literal["exact", "report"] = Field(
        default="exact",
        description="mean of the cubed aperture over a tapered element: exact two-node mean, or (3.14f)",
    )
    mass: Literal["lumped", "consistent"] = Field(default="lumped", description="mass matrix of the rock")
    stepper: Literal["newmark"] = Field(default="newmark", description="time integrator of dynamic stages (4.1)-(4.3)")
    newmark_beta: Annotated[float, Quantity(above=0.0, at_most=0.5)] = Field(
        default=0.25, description="beta of (4.1) [1]; 1/4 is the trapezoidal rule"
    )
    newmark_gamma: Annotated[float, Quantity(at_least=0.5, at_most=1.0)] = Field(
        default=0.5, description="gamma of (4.1) [1]; above 1/2 damps"
    )
    coupling: Literal["monolithic", "fixed-point", "whole-lu"] = Field(
        default="monolithic",
        description="how rock and fluid are solved together: at once, by turns (4.5), one direct solve",
    )
    newton_test: Literal["residual", "out-of-balance", "displacement"] = Field(
        default="residual", description="when Newton stops: scaled residuals, (4.9a), or (4.9b)"
    )
    tangent: Literal["consistent", "decoupled"] = Field(
        default="consistent", description="joint tangent with d f_s/d opening, or k_s and k_n alone"
    )
    open_strength: Literal["none", "cohesion"] = Field(
        default="none", description="shear strength of an open joint: none, or the cohesion (2.12)"
    )

    PRESETS: ClassVar[dict[str, dict[str, str]]] = {
        "default": {},
        "full": {},
        "report": {
            "storage": "report",
            "conductance": "report",
            "newton_test": "out-of-balance",
            "tangent": "decoupled",
            "open_strength": "cohesion",
        },
    }


class Accuracy(Part):
    """[accuracy] When an iteration has converged, and when it is given up."""

    residual: Fraction = Field(
        default=1e-11, description="largest residual relative to what drives it (default test) [1]"
    )
    out_of_balance: Annotated[float, Quantity(LINE_FORCE, above=0.0)] | None = Field(
        default=None,
        description="epsilon_S of (4.9a), absolute, per unit thickness [force/length]; derived if not given",
    )
    displacement: Fraction = Field(default=1e-12, description="relative change of displacement of (4.9b) [1]")
    pressure: Fraction = Field(default=1e-10, description="epsilon_F of the fixed point (4.5), relative [1]")
    max_iterations: Count = Field(default=50, description="Newton iterations of a step before it is halved or given up")
    max_cycles: Count = Field(default=50, description="cycles of the fixed point (4.5) before it is given up")


class Output(Part):
    """[output] What a run writes beside its histories."""

    fields_every: Annotated[int, Field(strict=True, ge=0)] = Field(
        default=0,
        description="write whole fields every so many steps; 0 writes the first and the last state only",
    )
    pictures: StrictBool = Field(default=True, description="draw pictures for the report page")


class Trace(Part):
    """[[geometry.fracture]] A fracture as a polyline."""

    name: Name = Field(description="name that [fracture.NAME] refers to")
    points: Annotated[Points, Polyline()] = Field(description="[[x, y], ...] from its start to its end [length]")


class Geometry(Part):
    """[geometry] A domain with fracture traces, meshed by the program; its rock is called "rock"."""

    domain: Annotated[Points, Domain()] = Field(
        description="[xmin, ymin, xmax, ymax] or the corners [[x, y], ...] [length]"
    )
    fracture: tuple[Trace, ...] = Field(
        default=(), description="fracture traces; they may cross, and reach the boundary"
    )
    fractures_csv: Name | None = Field(default=None, description="file of more traces, relative to the scene")
    size: Size = Field(description="mesh size away from fractures [length]")
    size_at_fractures: Size | None = Field(
        default=None, description="mesh size at fractures [length]; as size if not given"
    )
    cells: Literal["triangles", "quads"] = Field(default="triangles", description="shape of the cells")


class Mesh(Part):
    """[mesh] A Gmsh geometry or a mesh; its physical groups name rocks, fractures, sides and points."""

    file: Name = Field(description=".geo or .msh file, relative to the scene")


class Rock(Part):
    """[rock.NAME] An elastic rock in plane strain, or a rigid body."""

    youngs_modulus: Annotated[float, Quantity(STRESS, above=0.0)] | None = Field(
        default=None, description="E [force/length**2]; required unless rigid"
    )
    poissons_ratio: Annotated[float, Quantity(above=-1.0, below=0.5)] | None = Field(
        default=None, description="nu [1]; required unless rigid"
    )
    density: Annotated[float, Quantity(DENSITY, above=0.0)] | None = Field(
        default=None, description="rho [force*time**2/length**4]; required by dynamic stages"
    )
    rigid: StrictBool = Field(default=False, description="true: each connected part moves as a rigid body")

    @model_validator(mode="after")
    def _complete(self) -> Rock:
        for key in () if self.rigid else ("youngs_modulus", "poissons_ratio"):
            if getattr(self, key) is None:
                raise fault("missing; a rock needs it unless rigid = true", key=key)
        return self


class InitialStress(Part):
    """[initial_stress] Uniform stress at the start, tension positive; joint tractions follow by (2.14)."""

    xx: Stress = Field(default=0.0, description="sigma_xx [force/length**2]")
    yy: Stress = Field(default=0.0, description="sigma_yy [force/length**2]")
    zz: Stress = Field(default=0.0, description="sigma_zz, out of plane [force/length**2]")
    xy: Stress = Field(default=0.0, description="sigma_xy [force/length**2]")


class Fracture(Part):
    """[fracture.NAME] Joint law and aperture of a fracture; NAME "default" serves all without a table."""

    law: Literal["hyperbolic-coulomb", "linear"] = Field(
        default="hyperbolic-coulomb",
        description="closure and friction of Figs. 3 and 4, or two linear springs",
    )
    normal_stiffness: Stiffness = Field(description="k_n0, at the initial state [force/length**3]")
    shear_stiffness: Stiffness = Field(description="k_s0 [force/length**3]")
    aperture: Size | None = Field(
        default=None, description="d0, at the initial state [length]; a linear joint without flow needs none"
    )
    minimum_hydraulic_aperture: Annotated[float, Quantity(LENGTH, at_least=0.0)] = Field(
        default=0.0, description="aperture below which the conductance falls no further [length]"
    )
    friction_angle_deg: Annotated[float, Quantity(ANGLE, at_least=0.0, below=90.0)] | None = Field(
        default=None, description="phi of (2.12) [degree]; or give friction_coefficient; not used by linear"
    )
    friction_coefficient: Annotated[float, Quantity(at_least=0.0)] | None = Field(
        default=None, description="tan phi of (2.12) [1]; or give friction_angle_deg; not used by linear"
    )
    cohesion: Annotated[float, Quantity(STRESS, at_least=0.0)] = Field(
        default=0.0, description="C of (2.12) [force/length**2]; not used by linear"
    )
    stick_slip_ratio: Annotated[float, Quantity(above=0.0, at_most=1.0)] = Field(
        default=1.0, description="alpha, strength while sliding over peak strength [1]; not used by linear"
    )
    initial_normal_traction: Stress | None = Field(
        default=None,
        description="f_n0, effective, compression negative [force/length**2]; else from initial_stress",
    )
    initial_shear_traction: Stress | None = Field(
        default=None, description="f_s0 [force/length**2]; else from initial_stress (2.14)"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Fracture:
        if self.friction_angle_deg is not None and self.friction_coefficient is not None:
            raise fault(
                f"contradicts friction_coefficient = {self.friction_coefficient:g}; give one of them",
                key="friction_angle_deg",
            )
        if self.law == "hyperbolic-coulomb":
            if self.friction_angle_deg is None and self.friction_coefficient is None:
                raise fault("missing; give it or friction_coefficient", key="friction_angle_deg")
            if self.aperture is None:
                raise fault("missing; the law hyperbolic-coulomb needs it", key="aperture")
        return self

    @property
    def friction(self) -> float:
        """The coefficient of friction tan phi of (2.12); 0 where none is given."""
        if self.friction_coefficient is not None:
            return self.friction_coefficient
        return math.tan(math.radians(self.friction_angle_deg or 0.0))


class Fluid(Part):
    """[fluid] The fluid in the fractures; viscosity, specific weight or density zero: no flow is modelled."""

    viscosity: Annotated[float, Quantity(VISCOSITY, at_least=0.0)] = Field(
        description="mu [force*time/length**2]; 0 leaves the flow out"
    )
    specific_weight: Annotated[float, Quantity(WEIGHT, at_least=0.0)] | None = Field(
        default=None,
        description="gamma [force/length**3]; used by head = p/gamma only; 0 leaves the flow out",
    )
    density: Annotated[float, Quantity(DENSITY, at_least=0.0)] | None = Field(
        default=None, description="density of the fluid [force*time**2/length**4]; 0 leaves the flow out"
    )
    initial_pressure: Stress = Field(default=0.0, description="p0, uniform [force/length**2]")
    flow_depth: Size = Field(default=1.0, description="A, depth out of the plane that flow rates refer to [length]")


def with_preset(data: dict[str, Any]) -> dict[str, Any]:
    """Fill the keys of [method] that a scene leaves open from its ``model``."""
    preset = Method.PRESETS.get(str(data.get("model", "default")), {})
    method = data.get("method", {})
    return {**data, "method": {**preset, **method}} if isinstance(method, dict) else data
