"""Quantities that a place in the rock or on a fracture has."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import SplitMesh
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model import stress as rock
from fracflow.scene.scene import Scene

Place = FracturePlace | RockPlace
MOTION = ("displacement", "velocity", "acceleration")
JOINT = ("slip", "opening", "slip_rate", "shear_traction", "normal_traction", "plastic_slip", "strength")
FLUID = ("pressure", "flow_rate")
SOLID = ("strain", "stress")


def available(scene: Scene, mesh: SplitMesh, place: Place) -> tuple[str, ...]:
    """Quantities that a place has."""
    if isinstance(place, RockPlace):
        return MOTION + (SOLID if rock.deforms(mesh, scene)[place.cells].any() else ())
    tables = [scene.fracture_named(mesh.fractures[f]) for f in np.unique(mesh.joint_fracture[place.joints])]
    aperture = ("aperture",) if all(table.aperture is not None for table in tables) else ()
    weight = scene.fluid.specific_weight if scene.fluid is not None else None
    fluid = (*FLUID, *(("head",) if weight else ())) if scene.has_flow else ()
    return (*MOTION, "displacement_bottom", *JOINT, *aperture, *fluid)


def refuse_missing(scene: Scene, mesh: SplitMesh, places: Mapping[str, Place]) -> None:
    """Raise InputError for the first quantity that a probe asks for and its place does not have."""
    for probe in scene.probe:
        has = available(scene, mesh, places[probe.name])
        for quantity in probe.quantities or ():
            if quantity not in has:
                where = _where(mesh, places[probe.name])
                raise InputError(
                    f"probe.{probe.name}.quantities: {quantity}: {_why(scene, mesh, places[probe.name], quantity)};"
                    f" {where} has {', '.join(has)}"
                )


def _where(mesh: SplitMesh, place: Place) -> str:
    if isinstance(place, RockPlace):
        return f"the rock {mesh.rocks[mesh.cell_rock[place.cells[0]]]} there"
    return f"the fracture {mesh.fractures[mesh.joint_fracture[place.joints[0]]]} there"


def _why(scene: Scene, mesh: SplitMesh, place: Place, quantity: str) -> str:
    where = _where(mesh, place)
    if isinstance(place, RockPlace):
        return f"{where} is rigid" if quantity in SOLID else f"belongs to a fracture, and the probe sits in {where}"
    if quantity in SOLID:
        return f"belongs to the rock, and the probe sits on {where}"
    if quantity == "aperture":
        return f"{where} is given none"
    return "needs [fluid] with specific_weight" if scene.has_flow else "the scene models no flow: it needs a [fluid]"
