"""The joint ends of a scene, for the catalogue of events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.model.state import State
from fracflow.output.catalogue import Catalogue, FaultEnds, Instant
from fracflow.output.sampling import Snapshot
from fracflow.scene.scene import Scene


def catalogue_of(scene: Scene, mesh: SplitMesh, place: Ints, notes: Mapping[str, Any] | None) -> Catalogue | None:
    """The catalogue of a scene with a stage auto, new or with what a checkpoint's ``notes`` kept; ``place`` as below."""
    if all(stage.kind != "auto" for stage in scene.stage):
        return None
    catalogue = Catalogue(fault_ends(scene, mesh, place))
    if notes is not None:
        catalogue.remember(notes["catalogue"])
    return catalogue


def fault_ends(scene: Scene, mesh: SplitMesh, place: Ints) -> FaultEnds:
    """The joint ends (joints * 2,) of a mesh; ``place`` is the row of each in the table of fracture nodes."""
    length = np.linalg.norm(np.diff(mesh.points[mesh.joint_bottom], axis=1)[:, 0], axis=-1)
    parts = mesh.joint_bottom != mesh.joint_top
    modulus = np.array([_shear_modulus(scene, name) for name in mesh.rocks])[mesh.cell_rock[mesh.joint_cells]]
    both: Floats = 2.0 / (1.0 / modulus).sum(axis=1) if len(modulus) else np.zeros(0)
    return FaultEnds(
        place,
        (0.5 * length[:, None] * parts).ravel(),
        np.repeat(both, 2),
        scene.output.event_length,
        None if scene.units == "none" else scene.unit_system.to_si("force*length"),
    )


def _shear_modulus(scene: Scene, name: str) -> float:
    rock = scene.rock[name]
    if rock.rigid or rock.youngs_modulus is None:
        return np.inf
    return rock.youngs_modulus / (2.0 * (1.0 + (rock.poissons_ratio or 0.0)))


def instant(state: State, snapshot: Snapshot, began: float) -> Instant:
    """The instant of a recorded state, for the catalogue; ``began`` as ``Instant`` has it."""
    slip, traction, rate = (snapshot.column(name).ravel() for name in ("plastic_slip", "shear_traction", "slip_rate"))
    sliding = snapshot.column("sliding").astype(bool).ravel()
    return Instant(state.time, slip, traction, rate, sliding, state.energy, state.injected, began)
