"""The mesh of a scene at the command line: its summary, and a file of it that scenes and ranks read without Gmsh."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from fracflow.cli.answer import size_line
from fracflow.diagnostics.well_parts import unconnected_wells
from fracflow.errors import DiskError, InputError
from fracflow.mesh.data import SplitMesh
from fracflow.mesh.read import SPLIT
from fracflow.mesh.split import summary
from fracflow.mesh.store import is_saved_mesh, save_mesh
from fracflow.model.setup import place
from fracflow.reduction.prepare import cut_for, read_uncut
from fracflow.remarks import marked
from fracflow.scene.scene import Scene


def mesh_lines(scene: Scene, output: Path | None) -> Iterator[str]:
    """Mesh and split a scene, write the split mesh into ``output``, and give lines to print.

    Raises InputError where there is no mesh to write or the file is no .h5, and DiskError.
    """
    if output is not None and (output.suffix != SPLIT or output.is_dir()):
        raise InputError(f"{output}: is no file for a split mesh; name one with -o NAME{SPLIT}")
    if output is not None and scene.is_unbounded:
        raise InputError(f'{scene.source}: geometry.domain = "unbounded": there is no mesh to write; leave -o out')
    if output is not None and os.path.lexists(output) and not is_saved_mesh(output):
        raise InputError(f"{output}: is no split mesh, and would be lost; name another file")
    sized, mesh = read_uncut(scene)
    whole = cut_for(sized, mesh)
    yield from map(marked, whole.notes)
    try:
        yield from map(marked, unconnected_wells(scene, whole, place(scene, whole).wells))
    except InputError as error:  # wells may be placed later
        yield marked(str(error))
    for key, value in summary(whole).items():
        yield size_line(key, value)
    if output is not None:
        yield from _written(mesh, output, scene.refine)


def _written(mesh: SplitMesh, output: Path, cuts: int) -> Iterator[str]:
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        save_mesh(mesh, output)
    except OSError as error:
        raise DiskError.of(error, output) from error
    before = f", with refine = {cuts} as here" if cuts else ""
    yield f'{output}: {len(mesh.cells)} cells; scenes read it by [mesh] file = "{output.name}"{before}'
