"""HDF5 files that hold their data themselves: HDF5 follows links to other files, and makes up what was never written."""

from __future__ import annotations

from pathlib import Path

import h5py

from fracflow.errors import InputError

DEEPEST = 8  # groups inside each other; ours are four deep
SLACK = 1 << 20  # bytes that a dataset may claim beyond those in the file: the last chunks of a run that was killed


def check_contained(file: h5py.File, path: Path) -> None:
    """Look at every dataset of an open file, reading none.

    Raises InputError for a link or storage that leads to another file, and for a dataset larger than the file.
    """
    size, seen = path.stat().st_size + SLACK, set[int]()

    def walk(group: h5py.h5g.GroupID, name: str, depth: int) -> None:
        address = h5py.h5o.get_info(group).addr
        if address in seen or depth > DEEPEST:
            raise InputError(f"{path}: {name or '/'}: groups go round in circles or too deep: {_REMEDY}")
        seen.add(address)
        for raw in group:
            inside = f"{name}/{raw.decode('utf-8', 'replace')}"
            if group.links.get_info(raw).type != h5py.h5l.TYPE_HARD:
                raise InputError(f"{path}: {inside}: is a link, which may lead to another file: {_REMEDY}")
            item = h5py.h5o.open(group, raw)
            if isinstance(item, h5py.h5g.GroupID):
                walk(item, inside, depth + 1)
            elif isinstance(item, h5py.h5d.DatasetID):
                _check_dataset(item, inside)

    def _check_dataset(item: h5py.h5d.DatasetID, name: str) -> None:
        plan = item.get_create_plist()
        if plan.get_external_count() or plan.get_layout() == h5py.h5d.VIRTUAL:
            raise InputError(f"{path}: {name}: has its data in another file: {_REMEDY}")
        claimed = item.get_space().get_simple_extent_npoints() * item.get_type().get_size()
        if claimed > size:
            raise InputError(f"{path}: {name}: claims {claimed} bytes, more than the file has: {_REMEDY}")

    walk(file["/"].id, "", 0)


_REMEDY = "no run of fracflow wrote it so; start the run again with fracflow run"
