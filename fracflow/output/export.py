"""The history of a run as CSV: a table each for steps, energies, every probe, and fractures; or histories in one."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.output.folder import check_own, write_atomic
from fracflow.output.fracture_table import COLUMNS, fracture_table
from fracflow.output.history import read_history, read_units
from fracflow.scene.quantities import component_names, dimension_of, row_of
from fracflow.scene.units import unit_text

Columns = dict[str, NDArray[Any]]


def unit_of(key: str, units: Mapping[str, str]) -> str:
    """Unit of a key of the history, "" for counts, ratios and scenes without units; energies are per thickness.

    units  names of length, force and time
    """
    return unit_text(dimension_of(key), units)


def units_of_run(folder: Path) -> dict[str, str]:
    """Names of length, force and time, as ``unit_of`` takes them; none where the scene has none."""
    return read_units(folder / "history.h5")


def tables(folder: str | Path) -> dict[str, Columns]:
    """Tables of a run by name: "steps", "energy", "probe_<name>"; each column (steps,), headed "name [unit]".

    Every table begins with the time, but "fractures", which has a row a fracture, of the last fields. Raises InputError if
    there is no history.
    """
    check_own(Path(folder))
    history, units = read_history(Path(folder) / "history.h5"), units_of_run(Path(folder))
    found: dict[str, Columns] = {}
    for key, values in history.items():
        if key == "time":
            continue
        group, _, name = key.partition("/")
        if group == "probe":
            probe, _, name = name.rpartition("/")
            group = f"probe_{probe}"
        table = found.setdefault({"step": "steps"}.get(group, group), {_head("time", "time", units): history["time"]})
        flat, row = values.reshape(len(values), -1), row_of(key)
        kind = "scalar" if values.ndim == 1 else row.kind if row is not None else None
        heads = [_head(each, key, units) for each in component_names(name, kind, flat.shape[1])]
        table |= dict(zip(heads, flat.T, strict=True))
    return found | _by_fracture(Path(folder), units)


def _by_fracture(folder: Path, units: Mapping[str, str]) -> dict[str, Columns]:
    """The table "fractures", of the last fields, where there are any."""
    table = fracture_table(folder)
    if table is None:
        return {}
    heads = {f"{key} [{unit}]" if (unit := unit_text(of, units)) else key: key for key, of in COLUMNS.items()}
    columns: Columns = {"fracture": np.array(table.names, dtype=object)}
    columns |= {head: table.columns[key] for head, key in heads.items()}
    return {"fractures": columns | {"state": np.array(table.state, dtype=object)}}


def export_csv(folder: str | Path, output: str | Path | None = None) -> list[Path]:
    """Write the history of a run as CSV and return the files.

        output  a folder for one file a table, by default "csv" in the run's folder. Or a file NAME.csv for all of them side by
                side,
    with columns of energies and probes named "energy/..." and "probe_<name>/..."

        Raises InputError if there is no history, or nothing can be written there.
    """
    found = tables(folder)
    target = Path(folder) / "csv" if output is None else Path(output)
    one = target.suffix.lower() == ".csv" and not target.is_dir()
    if one:
        found.pop("fractures", None)  # its rows are not times
        wide: Columns = dict(found.pop("steps", {}))
        for table, columns in found.items():
            wide |= {f"{table}/{head}": values for head, values in list(columns.items())[1:]}
        found = {target.stem: wide}
    place = target.parent if one else target
    try:
        place.mkdir(parents=True, exist_ok=True)
        names = _file_names(found)
        return [_write(target if one else place / f"{names[table]}.csv", found[table]) for table in found]
    except OSError as error:
        raise InputError(f"{target}: {error.strerror}; name a folder or a .csv file to write to") from error


def _head(name: str, key: str, units: Mapping[str, str]) -> str:
    unit = unit_of(key, units)
    return f"{name} [{unit}]" if unit else name


def _file_names(tables: Iterable[str]) -> dict[str, str]:
    """Names of tables -> names of their files, none twice, whatever the case of its letters."""
    found: dict[str, str] = {}
    taken = set[str]()
    for table in tables:
        name, base = _file_name(table), _file_name(table)
        for number in count(2):
            if name.lower() not in taken:
                break
            name = f"{base}_{number}"
        taken.add(name.lower())
        found[table] = name
    return found


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
