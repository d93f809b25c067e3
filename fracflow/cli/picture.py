"""Pictures at the command line: of a run, or of a scene before its run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fracflow.diagnostics.criticality import criticality
from fracflow.errors import DiskError, InputError
from fracflow.laws import JOINT_LAWS
from fracflow.mesh.data import Floats, SplitMesh, is_unmeshed
from fracflow.mesh.plane.unmeshed import map_cells
from fracflow.model.setup import place
from fracflow.output.drawing.before_a_run import before_a_run
from fracflow.output.drawing.network_map import Network, Places
from fracflow.output.plot_style import plain, save, styled
from fracflow.reduction.prepare import read_split
from fracflow.remarks import note
from fracflow.scene.scene import Scene


def picture_of_scene(scene: Scene, output: Path | None) -> list[str]:
    """Draw a scene before its run into ``output``, by default runs/NAME-before.png; lines to print.

    Raises InputError where it has no mesh or the file is no .png, and DiskError.
    """
    path = output or Path("runs") / f"{scene.name}-before.png"
    if path.suffix.lower() != ".png" or path.is_dir():
        raise InputError(f"{path}: is no file for a picture; name one with -o NAME.png")
    mesh = read_split(scene)
    marks, notes = _marks(scene, mesh)
    near = criticality(scene, mesh)
    cells = "Rock without cells" if is_unmeshed(mesh.cells) else f"{len(mesh.cells)} cells"
    below = (
        f"{cells}, {len(mesh.fractures)} fracture{'s' * (len(mesh.fractures) != 1)} of"
        f" {len(mesh.joint_fracture)} joints. From the initial stress and pressure, with rock and other fractures at rest"
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with styled():
            figure = before_a_run(
                _network(scene, mesh, marks),
                scene.title or scene.name,
                below,
                _of_pieces(near.tendency),
                _of_pieces(near.rise),
                any(JOINT_LAWS[scene.fracture_named(name).law].creeps for name in mesh.fractures),
            )
            save(figure, path)
    except OSError as error:
        raise DiskError.of(error, path) from error
    return [*notes, str(path)]


def _marks(scene: Scene, mesh: SplitMesh) -> tuple[dict[str, Places], list[str]]:
    """Places of wells and probes, and a note where they have none yet."""
    try:
        found = place(scene, mesh)
    except InputError as error:
        return {}, [note(f"wells and probes are not drawn: {error}")]
    wells = {name: mesh.points[mesh.flow_origin[np.ravel(nodes)[0]]] for name, nodes in found.wells.items()}
    probes = {name: each.point for name, each in found.probes.items()}
    return {
        kind: {name: (float(at[0]), float(at[1])) for name, at in places.items()}
        for kind, places in (("well", wells), ("probe", probes))
    }, []


def _of_pieces(at_ends: Floats) -> Floats:
    """Means (j,) of values at both ends (j, 2)."""
    return np.asarray(at_ends.mean(axis=1))


def _network(scene: Scene, mesh: SplitMesh, marks: dict[str, Places]) -> Network:
    names = {part: plain(unit) for part, unit in scene.unit_names.items()}
    is_meshed = not is_unmeshed(mesh.cells)
    points, cells = (mesh.points, mesh.cells) if is_meshed else map_cells(mesh)
    rock = [points[cell[cell >= 0]] for cell in cells]
    sides = {}
    for kind, tables in (("support", scene.support), ("absorbing side", scene.absorbing)):
        of = [number for number, name in enumerate(mesh.sides) if any(name in table.on for table in tables)]
        sides[kind] = mesh.points[mesh.side_facets[np.isin(mesh.side_of, of)]]
    return Network(
        rock,
        mesh.points[mesh.joint_bottom],
        mesh.joint_fracture,
        mesh.fractures,
        names,
        marks,
        sides,
        is_meshed=is_meshed,
    )
