"""The history of a run as CSV: a table each for steps, energies and every probe, or all in one."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.output.folder import write_atomic
from fracflow.output.history import read_history, read_units

Columns = dict[str, NDArray[Any]]

# Last word of a key of the history -> kind of its unit; what is not here is a count or a ratio
KINDS = {
    "time": "time",
    "dt": "time",
    "velocity": "velocity",
    "slip_rate": "velocity",
    "acceleration": "acceleration",
    "flow_rate": "flow rate",
    **dict.fromkeys(
        ("displacement", "displacement_bottom", "slip", "plastic_slip", "opening", "aperture", "head"), "length"
    ),
    **dict.fromkeys(("shear_traction", "normal_traction", "strength", "pressure", "stress"), "stress"),
}
PARTS = {2: ("x", "y"), 4: ("xx", "yy", "zz", "xy")}


def unit_of(key: str, units: Mapping[str, str]) -> str:
    """Unit of a key of the history, "" for counts, ratios and scenes without units; energies are per thickness.

    units  names of length, force and time
    """
    length, force, time = (units.get(part, "") for part in ("length", "force", "time"))
    if not (length and force and time):
        return ""
    texts = {
        "length": length,
        "time": time,
        "velocity": f"{length}/{time}",
        "acceleration": f"{length}/{time}^2",
        "stress": f"{force}/{length}^2",
        "flow rate": f"{length}^3/{time}",
    }
    if key.startswith("energy/"):
        return f"{force} {length}/{length}"
    return texts.get(KINDS.get(key.rsplit("/", 1)[-1], ""), "") if not key.startswith("step/control/") else ""


def units_of_run(folder: Path) -> dict[str, str]:
    """Names of length, force and time, as ``unit_of`` takes them; none where the scene has none."""
    return read_units(folder / "history.h5")


def tables(folder: str | Path) -> dict[str, Columns]:
    """Tables of a run by name: "steps", "energy", "probe_<name>"; each column (steps,), headed "name [unit]".

    Every table begins with the time. Raises InputError if there is no history.
    """
    history, units = read_history(Path(folder) / "history.h5"), units_of_run(Path(folder))
    found: dict[str, Columns] = {}
    for key, values in history.items():
        if key == "time":
            continue
        group, _, name = key.partition("/")
        if group == "probe":
            probe, _, name = name.rpartition("/")
            group = f"probe_{probe}"
        table = found.setdefault(
            {"step": "steps"}.get(group, group), {_head("time", key="time", units=units): history["time"]}
        )
        flat = values.reshape(len(values), -1)
        parts = PARTS.get(flat.shape[1], range(flat.shape[1])) if values.ndim > 1 else [""]
        table |= {
            _head(f"{name}_{part}" if part != "" else name, key=key, units=units): flat[:, n]
            for n, part in enumerate(parts)
        }
    return found


def export_csv(folder: str | Path, output: str | Path | None = None) -> list[Path]:
    """Write the history of a run as CSV and return the files.

    output  a folder for one file a table, by default "csv" in the run's folder; or a file NAME.csv for all of them
            side by side, the columns of energies and probes led by "energy/" and "probe_<name>/"

    Raises InputError if there is no history, or nothing can be written there.
    """
    found = tables(folder)
    target = Path(folder) / "csv" if output is None else Path(output)
    one = target.suffix.lower() == ".csv" and not target.is_dir()
    if one:
        wide: Columns = dict(found.pop("steps", {}))
        for table, columns in found.items():
            wide |= {f"{table}/{head}": values for head, values in list(columns.items())[1:]}
        found = {target.stem: wide}
    place = target.parent if one else target
    try:
        place.mkdir(parents=True, exist_ok=True)
        return [
            _write(target if one else place / f"{_file_name(table)}.csv", columns) for table, columns in found.items()
        ]
    except OSError as error:
        raise InputError(f"{target}: {error.strerror}; name a folder or a .csv file to write to") from error


def _head(name: str, key: str, units: Mapping[str, str]) -> str:
    unit = unit_of(key, units)
    return f"{name} [{unit}]" if unit else name


def _file_name(table: str) -> str:
    """A table's name without what no file name may hold."""
    return "".join("_" if char in '/\\:*?"<>|' or not char.isprintable() else char for char in table)


def _write(path: Path, columns: Columns) -> Path:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True))
    write_atomic(path, text.getvalue())
    return path
