"""Quantities that are available at a place in the rock or on a fracture."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import SplitMesh
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model import stress as rock
from fracflow.scene.quantities import OutputQuantity, probed
from fracflow.scene.scene import Scene

ProbePlace = FracturePlace | RockPlace


def available(scene: Scene, mesh: SplitMesh, place: ProbePlace, default: bool = False) -> tuple[str, ...]:
    """Names of the quantities that a place has; only those of a probe that names none, if ``default``."""
    rows = probed().values()
    return tuple(row.name for row in rows if (row.default or not default) and not _why_not(scene, mesh, place, row))


def refuse_missing(scene: Scene, mesh: SplitMesh, places: Mapping[str, ProbePlace]) -> None:
    """Raise InputError for the first quantity that a probe asks for and its place does not have."""
    for probe in scene.probe:
        place = places[probe.name]
        for name in probe.quantities or ():
            if why := _why_not(scene, mesh, place, probed()[name]):
                has = ", ".join(available(scene, mesh, place))
                raise InputError(f"probe.{probe.name}.quantities: {name}: {why}; {_where(mesh, place)} has {has}")


def _where(mesh: SplitMesh, place: ProbePlace) -> str:
    if isinstance(place, RockPlace):
        return f"the rock {mesh.rocks[mesh.cell_rock[place.cells[0]]]} there"
    return f"the fracture {mesh.fractures[mesh.joint_fracture[place.joints[0]]]} there"


def _why_not(scene: Scene, mesh: SplitMesh, place: ProbePlace, row: OutputQuantity) -> str:
    """Why a place has no such quantity; empty where it has."""
    where = _where(mesh, place)
    if isinstance(place, RockPlace):
        if row.home not in ("node", "cell"):
            return f"belongs to a fracture, and the probe sits in {where}"
        is_rigid = row.home == "cell" and not rock.deforms(mesh, scene)[place.cells].any()
        return f"{where} is rigid" if is_rigid else row.missing(scene, ()).format(where=where)
    if row.home == "cell":
        return f"belongs to the rock, and the probe sits on {where}"
    fractures = [scene.fracture_named(mesh.fractures[f]) for f in np.unique(mesh.joint_fracture[place.joints])]
    return row.missing(scene, fractures).format(where=where)
