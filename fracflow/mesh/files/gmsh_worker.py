"""The process that runs Gmsh: ``python -m fracflow.mesh.files.gmsh_worker FOLDER``.

It reads job.json in that folder and writes the file mesh: a line of JSON, then the arrays that it names. Gmsh may crash
in C++; alone in its process, it takes nothing with it. Reports of Gmsh go to error.txt.
"""

from __future__ import annotations

import json
import math
import resource
import sys
from pathlib import Path
from typing import Any

import gmsh
import numpy as np

from fracflow.mesh.files.sets import CORNERS, Found
from fracflow.storage.child import end_with

GRACE = 5  # seconds of CPU time
KINDS = {15: "point", 1: "line", 2: "triangle", 3: "quad"}  # Gmsh's element types
FRONTAL, RIGHT_ANGLED = 6, 8  # its algorithms: for triangles, and for triangles that make good quads in pairs


def main(folder: Path) -> int:
    """Do the job in ``folder``; 0 if the file mesh was written, 1 if error.txt was."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    keep_within(job["seconds"], job["memory"], job["parent"])
    try:
        arrays = _arrays(*_by_meshio(job)) if "meshio" in job or "msh2" in job else with_gmsh(job)
    except Exception as error:
        (folder / "error.txt").write_text(str(error) or type(error).__name__, encoding="utf-8")
        return 1
    texts = {name: arrays.pop(name) for name in ("other", "group_name")}
    kinds = {name: (values.dtype.str, values.shape) for name, values in arrays.items()}
    with (folder / "mesh").open("wb") as file:
        file.write(json.dumps({**texts, "arrays": kinds}).encode() + b"\n")
        for values in arrays.values():
            file.write(np.ascontiguousarray(values).data)
    return 0


def _by_meshio(job: dict[str, Any]) -> Found:
    if "meshio" in job:
        from fracflow.mesh.files.others import read_other  # imports much

        return read_other(Path(job["meshio"]))
    from fracflow.mesh.files.msh2 import read_msh2  # imports much

    return read_msh2(Path(job["msh2"]))


def keep_within(seconds: int, memory: int, parent: int) -> None:
    """Let the system end this process where it uses too much CPU time [s] or memory [bytes], or its parent has ended."""
    wanted = {
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_AS: memory,
        resource.RLIMIT_FSIZE: memory,
        resource.RLIMIT_CORE: 0,
    }
    for kind, limit in wanted.items():
        hard = resource.getrlimit(kind)[1]
        least = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        # a signal that says why comes first, then one that nothing withstands
        resource.setrlimit(kind, (least, least + GRACE if kind == resource.RLIMIT_CPU and least == limit else least))
    end_with(parent)


def with_gmsh(job: dict[str, Any]) -> dict[str, Any]:
    """Let Gmsh open a file or mesh traces. Raises RuntimeError with its first error, which is more specific than its last."""
    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    try:
        return read_file(job["file"]) if "file" in job else mesh_geometry(job)
    except Exception as error:  # Gmsh raises plain Exception
        reports = [line.removeprefix("Error:").strip() for line in gmsh.logger.get() if line.startswith("Error")]
        reason = (reports or [str(error) or type(error).__name__])[0]
        raise RuntimeError(f"Gmsh: {' '.join(reason.split())}") from error
    finally:
        gmsh.finalize()


def _stop_on_errors() -> None:
    lines = gmsh.logger.get()
    if any(line.startswith("Error") for line in lines):
        raise RuntimeError("Gmsh reported an error")
    for line in lines:
        if "unknown" in line and "in physical" in line:  # Gmsh goes on without it, and a fracture would be shorter
            said = line.removeprefix("Warning:").strip()
            raise RuntimeError(
                f"{said}: tags change in Boolean operations; find it again by Curve In BoundingBox {{...}}"
            )


def _refuse_parts() -> None:
    """Raise RuntimeError for one part of a partitioned mesh: its file lists all parts, and has cells of one."""
    for dim, entity in gmsh.model.getEntities(2):
        if len(gmsh.model.getPartitions(dim, entity)) and not len(gmsh.model.mesh.getElementTypes(dim, entity)):
            raise RuntimeError("some parts of a mesh without the other parts; set Mesh.PartitionSplitMeshFiles = 0")


def read_file(path: str) -> dict[str, Any]:
    """Open a geometry or mesh; mesh it if it is not a mesh yet."""
    gmsh.open(path)
    _stop_on_errors()
    _refuse_parts()
    if not len(gmsh.model.mesh.getElementTypes(2)):
        gmsh.model.mesh.generate(2)
        _stop_on_errors()
    return dump()


def dump() -> dict[str, Any]:
    """All points and elements, and the physical groups of each element.

    points (n, 3); KIND (m, k) rows of points, KIND_member (q, 2) element, group; other (types of elements
    beside these); group_dim, group_tag, group_name.
    """
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    tags, first = np.unique(tags.astype(np.int64), return_index=True)
    groups = gmsh.model.getPhysicalGroups()
    number = {group: index for index, group in enumerate(groups)}
    nodes: dict[str, list[Any]] = {kind: [] for kind in CORNERS}
    members: dict[str, list[Any]] = {kind: [] for kind in CORNERS}
    counts = dict.fromkeys(CORNERS, 0)
    others = set()
    for dim, entity in gmsh.model.getEntities():
        own = [number[dim, tag] for tag in gmsh.model.getPhysicalGroupsForEntity(dim, entity)]
        for kind, _, connected in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
            if kind not in KINDS:
                others.add(gmsh.model.mesh.getElementProperties(kind)[0])
                continue
            name, width = KINDS[kind], gmsh.model.mesh.getElementProperties(kind)[3]
            rows = np.searchsorted(tags, connected.astype(np.int64)).reshape(-1, width)
            at = counts[name] + np.arange(len(rows))
            counts[name] += len(rows)
            nodes[name].append(rows)
            members[name] += [np.stack([at, np.full(len(at), group)], axis=1) for group in own]
    named = [(tag, dim, gmsh.model.getPhysicalName(dim, tag)) for dim, tag in groups]
    return _arrays(coordinates.reshape(-1, 3)[first], nodes, members, sorted(others), named)


def _arrays(
    points: Any, nodes: dict[str, list[Any]], members: dict[str, list[Any]], others: list[str], groups: list[Any]
) -> dict[str, Any]:
    """The arrays of ``dump``; ``groups`` are tag, dimension and name of each."""
    return {
        "points": points,
        **{kind: np.concatenate([np.zeros((0, k), np.int64), *nodes[kind]]) for kind, k in CORNERS.items()},
        **{f"{kind}_member": np.concatenate([np.zeros((0, 2), np.int64), *members[kind]]) for kind in CORNERS},
        "other": others,
        "group_dim": np.array([dim for _, dim, _ in groups], dtype=np.int64),
        "group_tag": np.array([tag for tag, _, _ in groups], dtype=np.int64),
        "group_name": [name for _, _, name in groups],
    }


def mesh_geometry(job: dict[str, Any]) -> dict[str, Any]:
    """Mesh a polygon with triangles so that the edges inside it are edges of cells, each a single one if ``whole`` asks."""
    points = np.array(job["points"], dtype=float)
    # Gmsh's tolerances are absolute: work on a domain of size one. A power of two scales without rounding.
    corner = points.min(axis=0)
    scale = 2.0 ** -math.ceil(math.log2(np.ptp(points, axis=0).max()))
    geo = gmsh.model.geo

    def added(places: Any) -> list[int]:
        return [geo.addPoint(x, y, 0.0) for x, y in ((np.array(places) - corner) * scale).tolist()]

    tags = added(points)
    round_it = [[geo.addLine(tags[one], tags[other]) for one, other in edges] for edges in job["sides"].values()]
    curves = [[geo.addLine(tags[one], tags[other]) for one, other in edges] for edges in job["traces"].values()]
    surface = geo.addPlaneSurface([geo.addCurveLoop([line for lines in round_it for line in lines])])
    for line in (line for lines in curves for line in lines if job.get("whole")):
        geo.mesh.setTransfiniteCurve(line, 2)
    around = [(fine * scale, reach * scale, added(places)) for fine, reach, places in job["sources"]]
    geo.synchronize()
    gmsh.model.mesh.embed(1, [line for lines in curves for line in lines], 2, surface)
    gmsh.model.addPhysicalGroup(2, [surface], name=job["rock"])
    for name, lines in [*zip(job["sides"], round_it, strict=True), *zip(job["traces"], curves, strict=True)]:
        gmsh.model.addPhysicalGroup(1, lines, name=name)
    _set_sizes(job["size"] * scale, around, job["growth"])
    gmsh.option.setNumber("Mesh.Algorithm", RIGHT_ANGLED if job["right_angled"] else FRONTAL)
    gmsh.model.mesh.generate(2)
    _stop_on_errors()
    arrays = dump()
    arrays["points"] = arrays["points"][:, :2] / scale + corner
    return arrays


def _set_sizes(size: float, around: list[tuple[float, float, list[int]]], growth: float) -> None:
    """Mesh sizes kept within a reach of points, from there growing by ``growth`` per length up to ``size``."""
    for source in ("Points", "Curvature", "ExtendFromBoundary"):
        name = source if source.startswith("Extend") else f"From{source}"
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    field = gmsh.model.mesh.field
    grown = []
    for fine, reach, points in around:
        distance, growing = field.add("Distance"), field.add("Threshold")
        field.setNumbers(distance, "PointsList", points)
        limits = {"InField": distance, "SizeMin": fine, "SizeMax": size, "DistMin": reach}
        for key, value in limits.items():
            field.setNumber(growing, key, value)
        field.setNumber(growing, "DistMax", reach + (size - fine) / growth)
        grown.append(growing)
    if grown:
        least = field.add("Min")
        field.setNumbers(least, "FieldsList", grown)
        field.setAsBackgroundMesh(least)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
