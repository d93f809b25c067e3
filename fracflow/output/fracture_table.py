"""A table of a run by fracture: how long it is, how wide, at what pressure, and how it slipped, in the last fields."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.output.events import read_events
from fracflow.output.reader import FractureFields, load_fractures, without_round_off
from fracflow.scene.units import ENERGY, LENGTH, STRESS, TIME

Floats = NDArray[np.float64]

COLUMNS = {
    "length": LENGTH, "mean_aperture": LENGTH, "largest_aperture": LENGTH, "mean_pressure": STRESS,
    "largest_pressure": STRESS, "largest_slip": LENGTH, "moment": ENERGY, "first_slip": TIME,
}  # fmt: skip
"""Column -> dimension; slip is plastic slip, moment G slip length per thickness, first_slip when its first section slid."""
STATES = ("sticks", "has slipped", "slips", "open")


@dataclass(frozen=True)
class FractureTable:
    """Values of the fractures (n,) at a time.

    columns  those of COLUMNS, NaN where the run has none
    state    sticks, has slipped, slips or open: the farthest of its sections
    """

    time: float
    names: list[str]
    columns: dict[str, Floats] = field(default_factory=dict)
    state: list[str] = field(default_factory=list)


def fracture_table(folder: Path) -> FractureTable | None:
    """The table of a run folder, None where it has no fields of fractures. Raises InputError for damaged files."""
    fields = load_fractures(folder, np.inf)
    if fields is None or not len(fields.cells):
        return None
    ends = np.linalg.norm(np.diff(fields.segments, axis=1)[:, 0], axis=1)[:, None] * np.array([0.5, 0.5])
    slip = without_round_off(_at_ends(fields, "plastic_slip"), fields.points)
    is_open, slides = (np.nan_to_num(_at_ends(fields, key)) > 0.0 for key in ("open", "sliding"))
    moments = ends * _moduli(folder, fields) * slip
    state = np.where(is_open, 3, np.where(slides, 2, np.where(slip > 0.0, 1, 0)))
    firsts = _first_slips(folder)
    found: dict[str, list[float]] = {name: [] for name in COLUMNS}
    states = []
    for number, name in enumerate(fields.names):
        here = fields.fracture == number
        for key in ("aperture", "pressure"):
            values = _at_ends(fields, key)[here]
            found[f"mean_{key}"].append(_mean(values, ends[here]))
            found[f"largest_{key}"].append(_largest(values))
        found["length"].append(float(ends[here].sum()))
        found["largest_slip"].append(_largest(slip[here]))
        found["moment"].append(float(np.nansum(moments[here])) if np.isfinite(moments[here]).any() else np.nan)
        found["first_slip"].append(firsts.get(name, np.nan))
        states.append(STATES[int(state[here].max(initial=0))])
    return FractureTable(fields.time, fields.names, {key: np.array(values) for key, values in found.items()}, states)


def _at_ends(fields: FractureFields, key: str) -> Floats:
    """A scalar field (m, 2) at both ends of the pieces; NaN if it was not written."""
    if not fields.has(key):
        return np.full(fields.cells.shape, np.nan)
    return np.asarray(fields.after[key].reshape(len(fields.points), -1)[:, 0][fields.cells], dtype=float)


def _mean(values: Floats, weights: Floats) -> float:
    known = np.isfinite(values)
    return float((values * weights)[known].sum() / weights[known].sum()) if known.any() else np.nan


def _largest(values: Floats) -> float:
    return float(values[np.isfinite(values)].max()) if np.isfinite(values).any() else np.nan


def _moduli(folder: Path, fields: FractureFields) -> Floats:
    """Shear moduli (m, 2) at the ends of the pieces, NaN where scene and mesh do not say, or where the walls are one."""
    unknown = np.full(fields.cells.shape, np.nan)
    try:  # a run is read without PETSc too
        from fracflow.mesh.store import load_mesh
        from fracflow.output.catalogue import fault_ends
        from fracflow.scene.scene import load

        mesh = load_mesh(folder / "mesh.h5")
        found = fault_ends(load(folder / "scene.toml"), mesh, np.zeros(0, dtype=np.int64))
    except (InputError, ImportError):
        return unknown
    if found.modulus.size != unknown.size:
        return unknown
    return np.where((found.length > 0.0) & np.isfinite(found.modulus), found.modulus, np.nan).reshape(unknown.shape)


def _first_slips(folder: Path) -> dict[str, float]:
    """When each fracture first slipped."""
    found: dict[str, float] = {}
    rows = read_events(folder / "events.csv") if (folder / "events.csv").exists() else []
    for row in rows:
        if row["kind"] == "slip":
            found[row["fracture"]] = min(row["start"], found.get(row["fracture"], np.inf))
    return found
