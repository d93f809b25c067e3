"""The tables of a scene that say what the rock, the fractures and the fluid are, and how they start."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StrictBool, create_model, model_validator

from fracflow.laws import JOINT_LAWS, elastic
from fracflow.scene import units
from fracflow.scene.laws import (
    Property,
    check,
    check_dilation,
    check_order,
    defaults,
    describe_laws,
    known_law,
    law_fields,
)
from fracflow.scene.method import Size, Stress, Table
from fracflow.scene.profiles import Along, AlongInTime, Pressures, Profile
from fracflow.scene.units import Quantity, fault

Position = Annotated[float, Quantity(units.LENGTH)]
Number = Annotated[float, Quantity()]
Speed = Annotated[float, Quantity(units.VELOCITY)]
Rate = Annotated[float, Quantity(units.RATE)]


def _along(dimension: str = "1", **limits: float) -> Along:
    return Along(Quantity(dimension, **limits))


class Rock(Table):
    """[rock.NAME] An elastic rock in plane strain, or a rigid body."""

    youngs_modulus: Annotated[float, Quantity(units.STRESS, above=0.0)] | None = None
    """E [force/length**2]; required unless rigid"""
    poissons_ratio: Annotated[float, Quantity(above=-1.0, below=0.5)] | None = None
    """nu [1]; required unless rigid"""
    density: Annotated[float, Quantity(units.DENSITY, above=0.0)] | None = None
    """rho [force*time**2/length**4]; required by dynamic stages"""
    rigid: StrictBool = False
    """true: each connected part moves as a rigid body"""

    @model_validator(mode="after")
    def _complete(self) -> Rock:
        for key in () if self.rigid else ("youngs_modulus", "poissons_ratio"):
            if getattr(self, key) is None:
                raise fault("missing; a rock needs it unless rigid = true", key=key)
        return self

    @property
    def shear_modulus(self) -> float:
        """G of (2.13), infinite of a rigid rock [stress]."""
        return elastic.shear_modulus(*self._constants())

    @property
    def p_wave_modulus(self) -> float:
        """P-wave modulus of (2.13), infinite of a rigid rock [stress]."""
        return elastic.p_wave_modulus(*self._constants())

    @property
    def plane_strain_modulus(self) -> float:
        """E' of (2.13), infinite of a rigid rock [stress]."""
        return elastic.plane_strain_modulus(*self._constants())

    @property
    def p_speed(self) -> float:
        """c_p [length/time]; 0 of rigid rock, and of one without a density, in which no wave travels."""
        return 0.0 if self.rigid or not self.density else math.sqrt(self.p_wave_modulus / self.density)

    @property
    def s_speed(self) -> float:
        """c_s [length/time]; 0 of rigid rock, and of one without a density, in which no wave travels."""
        return 0.0 if self.rigid or not self.density else math.sqrt(self.shear_modulus / self.density)

    def _constants(self) -> tuple[float, float]:
        """E and nu; a rigid rock is infinitely stiff, and does not widen."""
        if self.rigid:
            return math.inf, 0.0
        assert self.youngs_modulus is not None and self.poissons_ratio is not None
        return self.youngs_modulus, self.poissons_ratio


class StressGradient(Table):
    """[initial_stress.gradient] Change of the initial stress with depth, which grows towards -y."""

    xx: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """d sigma_xx / d depth [force/length**3]"""
    yy: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """d sigma_yy / d depth [force/length**3]"""
    zz: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """d sigma_zz / d depth [force/length**3]"""
    xy: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """d sigma_xy / d depth [force/length**3]"""


class InitialStress(Table):
    """[initial_stress] Stress at the start, tension positive; joint tractions follow by (2.14)."""

    xx: Stress = 0.0
    """sigma_xx [force/length**2]"""
    yy: Stress = 0.0
    """sigma_yy [force/length**2]"""
    zz: Stress = 0.0
    """sigma_zz, out of plane [force/length**2]"""
    xy: Stress = 0.0
    """sigma_xy [force/length**2]"""
    gradient: StressGradient = Field(default_factory=StressGradient)
    """change with depth"""
    datum: Position = 0.0
    """y at which the values above hold; the depth is datum - y [length]"""
    unbalanced: Literal["refuse", "carried"] = "refuse"
    """initial tractions of fractures that are not those of the stress: refuse them, or let the rock carry the
    difference in a stress that balances them, as in benchmarks of rupture; what is past its strength slips at once"""


class BodyForce(Table):
    """[body_force] A force on the volume of the rock, from the first instant."""

    x: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """along x [force/length**3]"""
    y: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """along y [force/length**3]"""
    gravity: Annotated[float, Quantity(units.ACCELERATION)] = 0.0
    """acceleration towards -y; acts on the density of each rock [length/time**2]"""


class InitialMotion(Table):
    """[initial.rock.NAME] Displacement and velocity of a rock at the start: a value at the origin and its gradient."""

    displacement: tuple[Position, Position] | None = None
    """[u_x, u_y] [length]"""
    displacement_gradient: tuple[tuple[Number, Number], tuple[Number, Number]] | None = None
    """[[du_x/dx, du_x/dy], [du_y/dx, du_y/dy]] [1]"""
    velocity: tuple[Speed, Speed] | None = None
    """[v_x, v_y] [length/time]"""
    velocity_gradient: tuple[tuple[Rate, Rate], tuple[Rate, Rate]] | None = None
    """[[dv_x/dx, dv_x/dy], [dv_y/dx, dv_y/dy]] [1/time]"""


class Initial(InitialMotion):
    """[initial] A start away from the state that initial_stress and fluid.initial_pressure describe."""

    pressure: Annotated[float, Quantity(units.STRESS)] | None = None
    """pressure in all fractures at the start [force/length**2], at fluid.datum where fluid.pressure_gradient lets it change
    with depth; else fluid.initial_pressure; the first step returns to that where no volume stores the difference: neither in
    moved walls nor by compressibility"""
    rock: dict[str, InitialMotion] = Field(default_factory=dict)
    """rocks that start otherwise, by name"""


class _Joint(Table):
    law: Annotated[str, AfterValidator(known_law)] = Field(
        default="hyperbolic-coulomb",
        description=describe_laws(),
        json_schema_extra={"enum": [name for name in JOINT_LAWS]},
    )
    normal_stiffness: Annotated[Property, _along(units.STIFFNESS, above=0.0)]
    """k_n0, at the initial state [force/length**3]"""
    shear_stiffness: Annotated[Property, _along(units.STIFFNESS, above=0.0)]
    """k_s0 [force/length**3]"""
    aperture: Annotated[Property | None, _along(units.LENGTH, above=0.0)] = None
    """d0, at the initial state [length]; a linear joint without flow needs none"""
    minimum_hydraulic_aperture: Annotated[Property, _along(units.LENGTH, at_least=0.0)] = 0.0
    """aperture below which the conductance falls no further [length]"""
    friction_angle_deg: Annotated[Property | None, _along(units.ANGLE, at_least=0.0, below=90.0)] = None
    """arctan of friction_coefficient, in place of it [degree]"""
    dilation_angle_deg: Annotated[Property, _along(units.ANGLE, at_least=0.0, below=90.0)] = 0.0
    """psi, by whose tangent walls that begin to slip ride up on each other; of a law with friction [degree]"""
    dilation_distance: Annotated[Property | None, _along(units.LENGTH, above=0.0)] = None
    """d, slip over which the tangent of that angle falls to zero, in proportion to the slip [length]"""


class LeakOff(Table):
    """[fracture.NAME.leak_off] Porous rock behind both walls, a half space each: it takes fluid and is not meshed."""

    permeability: Annotated[float, Quantity(units.AREA, at_least=0.0)]
    """k of the rock [length**2]"""
    storage: Annotated[float, Quantity(units.COMPRESSIBILITY, above=0.0)]
    """S, change of the fluid in a volume of the rock by pressure: porosity times the compressibility of the fluid, plus
    that of the pores [length**2/force]; the pressure diffuses by k/(mu S)"""


class Fracture(create_model("_LawKeys", __base__=_Joint, **law_fields())):  # type: ignore[misc]
    """[fracture.NAME] Joint law and aperture of a fracture; "default" serves all, and fills what a table leaves open."""

    initial_normal_traction: Annotated[Property | None, _along(units.STRESS)] = None
    """f_n0, effective, compression negative [force/length**2]; else from initial_stress"""
    initial_shear_traction: Annotated[Property | None, _along(units.STRESS)] = None
    """f_s0 [force/length**2]; else from initial_stress (2.14)"""
    conductance: Annotated[Property | None, _along(units.CONDUCTANCE, above=0.0)] = None
    """flow per thickness and pressure gradient [length**5/(force*time)], in place of the cubic law"""
    hydraulic_aperture: Annotated[Property | None, _along(units.LENGTH, above=0.0)] = None
    """w_h0, aperture of the cubic law at the initial state; else aperture. Volumes are those of aperture [length]"""
    hydraulic_opening_ratio: Annotated[Property, _along(above=0.0)] = 1.0
    """f of w_h = w_h0 + f (w - w_0), hydraulic against mechanical opening [1]"""
    slip_conductance: Annotated[Property, _along(at_least=1.0)] = 1.0
    """m, conductance after much plastic slip s over that without: it is m - (m - 1) exp(-s/L) times as large. s is the net
    slip, which walls that slip back lose again [1]"""
    slip_conductance_distance: Annotated[Property | None, _along(units.LENGTH, above=0.0)] = None
    """L, slip over which the conductance grows to that [length]"""
    pressure: Annotated[Pressures | None, AlongInTime(units.STRESS)] = None
    """pressure prescribed in the whole fracture: a number, [[t, p], ...], {along, value} or {along, time, value}
    [force/length**2]"""

    leak_off: LeakOff | None = None
    """fluid that the fracture loses to porous rock behind its walls"""

    @model_validator(mode="after")
    def _consistent(self) -> Fracture:
        check(self.law, vars(self))
        ends = (_largest(self.dilation_angle_deg), -_largest(self.friction, -1.0))
        check_dilation(self.dilates, self.dilation_distance is not None, *ends)
        for name, value in defaults(self.law).items():
            if getattr(self, name) is None:
                self.__dict__[name] = value  # so that the table that is written back says it
        self._check_conduction()
        check_order(self.law, {**vars(self), "friction_coefficient": self.friction})
        return self

    def _check_conduction(self) -> None:
        """Raise the fault of keys of conduction that contradict each other, or miss one."""
        ratio = self.hydraulic_opening_ratio
        for key, given in (
            ("hydraulic_aperture", self.hydraulic_aperture is not None),
            ("hydraulic_opening_ratio", isinstance(ratio, Profile) or ratio != 1.0),
        ):
            if given and self.conductance is not None:
                raise fault("contradicts conductance, which is in place of the cubic law; remove one", key=key)
        if self.conducts_by_slip and self.slip_conductance_distance is None:
            raise fault("missing; slip_conductance needs it: give a slip", key="slip_conductance_distance")

    @property
    def hydraulic(self) -> Property | None:
        """The hydraulic aperture at the initial state, w_h0 [length]."""
        return self.aperture if self.hydraulic_aperture is None else self.hydraulic_aperture

    @property
    def conducts_by_slip(self) -> bool:
        """Whether slip changes its conductance anywhere."""
        return isinstance(self.slip_conductance, Profile) or self.slip_conductance != 1.0

    @property
    def is_rough(self) -> bool:
        """Whether it conducts otherwise than by its mechanical aperture alone."""
        ratio = self.hydraulic_opening_ratio
        is_ratio = isinstance(ratio, Profile) or ratio != 1.0
        return self.hydraulic_aperture is not None or is_ratio or self.conducts_by_slip

    @property
    def dilates(self) -> bool:
        """Whether slip opens it anywhere."""
        return _largest(self.dilation_angle_deg) > 0.0 and not JOINT_LAWS[self.law].passes_over

    @property
    def leak_permeability(self) -> float:
        """That of ``leak_off``; 0 without [length^2]."""
        return self.leak_off.permeability if self.leak_off is not None else 0.0

    @property
    def leak_storage(self) -> float:
        """That of ``leak_off``; 0 without [1/stress]."""
        return self.leak_off.storage if self.leak_off is not None else 0.0

    @property
    def friction(self) -> Property:
        """The coefficient of friction tan phi of (2.12); 0 where none is given."""
        if self.friction_coefficient is not None:
            return self.friction_coefficient
        angle = self.friction_angle_deg
        if isinstance(angle, Profile):
            return Profile(angle.along, tuple(math.tan(math.radians(each)) for each in angle.values))
        return math.tan(math.radians(angle or 0.0))


def _largest(given: Property, sign: float = 1.0) -> float:
    """The largest value of a property along its trace, of one sign or the other."""
    values = given.values if isinstance(given, Profile) else (given,)
    return max(sign * value for value in values)


class Fluid(Table):
    """[fluid] The fluid in the fractures; viscosity, specific weight or density zero: no flow is modelled."""

    viscosity: Annotated[float, Quantity(units.VISCOSITY, at_least=0.0)]
    """mu [force*time/length**2]; 0 leaves the flow out"""
    specific_weight: Annotated[float, Quantity(units.WEIGHT, at_least=0.0)] | None = None
    """gamma [force/length**3]; used by head = p/gamma only; 0 leaves the flow out"""
    density: Annotated[float, Quantity(units.DENSITY, at_least=0.0)] | None = None
    """density of the fluid [force*time**2/length**4]; 0 leaves the flow out"""
    compressibility: Annotated[float, Quantity(units.COMPRESSIBILITY, at_least=0.0)] = 0.0
    """c_f, relative change of volume by pressure [length**2/force]; 0: incompressible"""
    initial_pressure: Stress = 0.0
    """p0 [force/length**2]"""
    pressure_gradient: Annotated[float, Quantity(units.WEIGHT)] = 0.0
    """change of p0 with depth, at which the fluid is at rest: only what exceeds it makes it flow [force/length**3]"""
    datum: Position = 0.0
    """y at which p0 holds; the depth is datum - y [length]"""
    flow_depth: Size = 1.0
    """A, depth out of the plane that flow rates refer to [length]"""
