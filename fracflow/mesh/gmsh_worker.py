"""The process that runs Gmsh: ``python -m fracflow.mesh.gmsh_worker FOLDER``.

It reads job.json and writes mesh.npz in that folder. Gmsh may crash in C++; alone in its process, it
takes nothing with it. What Gmsh reports goes to error.txt.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
from numpy.typing import NDArray

KINDS = {15: "point", 1: "line", 2: "triangle", 3: "quad"}  # Gmsh's element types
NEAR = 1e-7  # of the domain's extent: a curve this near to a side is on it
GROWTH = 0.3  # of the mesh size, per length away from the fractures
ALL_QUADS = 1  # subdivision that cuts quads in four and triangles in three quads


def main(folder: Path) -> int:
    """Do the job in ``folder``; 0 if mesh.npz was written, 1 if error.txt was."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    try:
        if "file" in job:
            arrays = read_file(job["file"])
        else:
            arrays = mesh_geometry(job)
    except Exception as error:  # Gmsh raises plain Exception
        (folder / "error.txt").write_text(_reason(error), encoding="utf-8")
        return 1
    finally:
        gmsh.finalize()
    np.savez(folder / "mesh.npz", **arrays)
    return 0


def _reason(error: Exception) -> str:
    """Gmsh's first error, which tells more than its last."""
    reports = [line.removeprefix("Error:").strip() for line in gmsh.logger.get() if line.startswith("Error")]
    return " ".join((reports or [str(error) or type(error).__name__])[0].split())


def _stop_on_errors() -> None:
    if any(line.startswith("Error") for line in gmsh.logger.get()):
        raise RuntimeError("Gmsh reported an error")


def read_file(path: str) -> dict[str, Any]:
    """Open a geometry or mesh; mesh it if it is not a mesh yet."""
    gmsh.open(path)
    _stop_on_errors()
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
    arrays: dict[str, Any] = {"points": coordinates.reshape(-1, 3)[first]}
    groups = gmsh.model.getPhysicalGroups()
    arrays["group_dim"] = np.array([dim for dim, _ in groups], dtype=np.int64)
    arrays["group_tag"] = np.array([tag for _, tag in groups], dtype=np.int64)
    arrays["group_name"] = np.array([gmsh.model.getPhysicalName(*group) for group in groups], dtype=np.str_)
    number = {group: index for index, group in enumerate(groups)}

    nodes: dict[str, list[Any]] = {kind: [] for kind in KINDS.values()}
    members: dict[str, list[Any]] = {kind: [] for kind in KINDS.values()}
    counts = dict.fromkeys(KINDS.values(), 0)
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
    for kind, width in zip(KINDS.values(), (1, 2, 3, 4), strict=True):
        arrays[kind] = np.concatenate([np.zeros((0, width), dtype=np.int64), *nodes[kind]])
        arrays[f"{kind}_member"] = np.concatenate([np.zeros((0, 2), dtype=np.int64), *members[kind]])
    arrays["other"] = np.array(sorted(others), dtype=np.str_)
    return arrays


def mesh_geometry(job: dict[str, Any]) -> dict[str, Any]:
    """Cut a polygon by traces and mesh it; facets of a trace run along it."""
    domain = np.array(job["domain"], dtype=float)
    # Gmsh's tolerances are absolute: work on a domain of size one. A power of two scales without rounding.
    corner = domain.min(axis=0)
    scale = 2.0 ** -math.ceil(math.log2(np.ptp(domain, axis=0).max()))
    traces = [(np.array(trace, dtype=float) - corner) * scale for trace in job["traces"]]
    edges, segments, surfaces = _fragments((domain - corner) * scale, traces)
    gmsh.model.addPhysicalGroup(2, surfaces, name=job["rock"])
    for name, curves in zip(job["sides"], edges, strict=True):
        gmsh.model.addPhysicalGroup(1, curves, name=name)
    for name, pieces in zip(job["names"], segments, strict=True):
        gmsh.model.addPhysicalGroup(1, [curve for curves in pieces for curve in curves], name=name)
    if job["cells"] == "quads":
        gmsh.option.setNumber("Mesh.RecombineAll", 1)
        gmsh.option.setNumber("Mesh.SubdivisionAlgorithm", ALL_QUADS)
        scale_of_size = 2 * scale  # the subdivision halves
    else:
        scale_of_size = scale
    _set_sizes(job["size"] * scale_of_size, job["size_at_fractures"] * scale_of_size, segments)
    gmsh.model.mesh.generate(2)
    _stop_on_errors()
    arrays = dump()
    _along_traces(arrays, traces, segments)
    arrays["points"] = arrays["points"][:, :2] / scale + corner
    return arrays


def _fragments(domain: NDArray[Any], traces: list[NDArray[Any]]) -> tuple[list[Any], list[Any], list[int]]:
    """Curves of each side, curves of each segment of each trace, and surfaces, once all are cut."""
    occ = gmsh.model.occ
    surface = occ.addPlaneSurface([occ.addCurveLoop(_lines(domain, closed=True))])
    lines = [_lines(trace, closed=False) for trace in traces]
    tools = [(1, line) for group in lines for line in group]
    surfaces = [surface]
    became: dict[int, list[int]] = {}
    if tools:
        _, children = occ.fragment([(2, surface)], tools)
        surfaces = [tag for dim, tag in children[0] if dim == 2]
        became = {line: [tag for _, tag in found] for (_, line), found in zip(tools, children[1:], strict=True)}
    occ.synchronize()
    return _sides(domain), [[became[line] for line in group] for group in lines], surfaces


def _sides(domain: NDArray[Any]) -> list[list[int]]:
    """Curves on each side of the domain; Gmsh's own map loses sides that nothing cuts."""
    middles = {}
    for _, curve in gmsh.model.getEntities(1):
        low, high = gmsh.model.getParametrizationBounds(1, curve)
        middles[curve] = np.array(gmsh.model.getValue(1, curve, [(low[0] + high[0]) / 2])[:2])
    found = []
    for start, end in zip(domain, np.roll(domain, -1, axis=0), strict=True):
        step = end - start
        normal = np.array([-step[1], step[0]]) / np.hypot(*step)
        found.append([
            curve for curve, middle in middles.items()
            if abs((middle - start) @ normal) < NEAR and 0 < (middle - start) @ step < step @ step
        ])  # fmt: skip
    return found


def _lines(points: NDArray[Any], closed: bool) -> list[int]:
    occ = gmsh.model.occ
    loop = closed or np.array_equal(points[0], points[-1])
    distinct = points if closed or not loop else points[:-1]
    tags = [occ.addPoint(float(x), float(y), 0.0) for x, y in distinct]
    tags += tags[:1] if loop else []
    return [occ.addLine(one, other) for one, other in itertools.pairwise(tags)]


def _set_sizes(size: float, fine: float, segments: list[Any]) -> None:
    """Mesh size ``fine`` on the traces, growing linearly to ``size``."""
    for source in ("Points", "Curvature", "ExtendFromBoundary"):
        name = source if source.startswith("Extend") else f"From{source}"
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", max(size, fine))
    curves = [curve for pieces in segments for group in pieces for curve in group]
    if not curves or fine >= size:
        return
    field = gmsh.model.mesh.field
    box = [gmsh.model.getBoundingBox(1, curve) for curve in curves]
    longest = max(math.dist(ends[:3], ends[3:]) for ends in box)
    distance, growing = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, "CurvesList", curves)
    field.setNumber(distance, "Sampling", 2 + math.ceil(2 * longest / fine))
    for key, value in {"InField": distance, "SizeMin": fine, "SizeMax": size, "DistMin": 0.0}.items():
        field.setNumber(growing, key, value)
    field.setNumber(growing, "DistMax", (size - fine) / GROWTH)
    field.setAsBackgroundMesh(growing)


def _along_traces(arrays: dict[str, Any], traces: list[NDArray[Any]], segments: list[Any]) -> None:
    """Turn the line elements of every trace into its direction."""
    entity = np.concatenate([
        np.full(len(tags), curve)
        for _, curve in gmsh.model.getEntities(1)
        for tags in gmsh.model.mesh.getElements(1, curve)[1]
    ])  # fmt: skip
    direction = np.zeros((1 + entity.max(initial=0), 2))
    for trace, pieces in zip(traces, segments, strict=True):
        for step, curves in zip(np.diff(trace, axis=0), pieces, strict=True):
            direction[curves] = step
    ends = arrays["points"][arrays["line"], :2]
    is_against = np.sum((ends[:, 1] - ends[:, 0]) * direction[entity], axis=1) < 0
    arrays["line"] = np.where(is_against[:, None], arrays["line"][:, ::-1], arrays["line"])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
