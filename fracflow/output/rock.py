"""Points, cells and fields of the rock, which rank 0 gets from all ranks by slabs; of a map where it is not meshed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.mesh.blocks import Blocks, SolidBlock
from fracflow.mesh.data import Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.plane.unmeshed import map_cells
from fracflow.mesh.slabs import Distributed, Order, on_rank_0
from fracflow.model import stress as rock
from fracflow.model.state import State
from fracflow.output.fields import stored
from fracflow.output.probes import Cells
from fracflow.output.sampling import StateSampler
from fracflow.output.unmeshed import UnmeshedRock, far_stress
from fracflow.scene.quantities import quantities
from fracflow.scene.scene import Scene
from fracflow.storage.sealed import Slabs, whole

Data = dict[str, NDArray[Any]]


@contextmanager
def shown_rock(blocks: Blocks, mesh: SplitMesh | None) -> Iterator[tuple[Slabs, Slabs] | None]:
    """Points (n, 3) and cells (m, k) of the rock for a ``FieldWriter`` on rank 0, None elsewhere. Collective.

    mesh  of rank 0, of which there is a map where the rock is not meshed
    """
    has_cells = not is_unmeshed(blocks.solid.cells)
    with on_rank_0(blocks.comm, _geometry(blocks) if has_cells else {}) as found:
        if found is None or mesh is None:
            yield None
        elif has_cells:
            yield found["point/"], found["cell/"]
        else:
            points, squares = map_cells(mesh)
            yield whole(stored({"": points}, None)["point/"]), whole(squares)


@contextmanager
def rock_slabs(sample: StateSampler, mesh: SplitMesh | None) -> Iterator[Mapping[str, Slabs] | None]:
    """Fields of the rock for ``FieldWriter.write_stored`` on rank 0, None elsewhere. Collective.

    mesh  as of ``shown_rock``
    """
    blocks, scene, state = sample.sampler.operators.blocks, sample.sampler.scene, sample.state
    if is_unmeshed(blocks.solid.cells):
        motion = sample.motion()
        if motion is None or mesh is None:
            yield None
            return
        yield {name: whole(each) for name, each in stored(*_map_fields(mesh, scene, motion, state)).items()}
        return
    here = stored(*_rock_fields(blocks.solid, scene, sample.motion_here(), state))
    with on_rank_0(blocks.comm, _distributed(blocks, here)) as found:
        yield found


def _distributed(blocks: Blocks, arrays: Data) -> dict[str, Distributed]:
    """Arrays (n, ...) at a rank's own nodes and at its cells, as ``stored`` gives them, with those of the others."""
    block, sizes = blocks.solid, blocks.sizes
    points = Order(blocks.comm, block.node_ids[: block.owned], sizes.nodes)
    cells = Order(blocks.comm, block.cell_ids, sizes.cells)
    return {name: (points if name.startswith("point") else cells).of(values) for name, values in arrays.items()}


def _geometry(blocks: Blocks) -> dict[str, Distributed]:
    """Points and cells of the rock as a writer takes them."""
    block = blocks.solid
    numbers = np.append(block.node_ids, -1)  # the last keeps the padding at -1
    points = stored({"": block.points[: block.owned]}, None)["point/"]
    return _distributed(blocks, {"point/": points, "cell/": numbers[block.cells].astype(np.int64)})


def _rock_fields(block: SolidBlock, scene: Scene, motion: Floats, state: State) -> tuple[Data, Data]:
    """Point data of a rank's own nodes and data of its cells, from the motion (n, 3, 2) of its nodes."""
    moves, own = state.energy["kinetic"] != 0.0, motion[: block.owned]
    nodes = SimpleNamespace(displacement=own[:, 0], velocity=own[:, 1], acceleration=own[:, 2])
    far = far_stress(scene, state.time, state.controls)
    cells = Cells(scene, block, np.arange(len(block.cells)), block.points, block.cells, motion, moves, far)
    return _formulas(nodes, cells, block.cell_rock)


def _map_fields(mesh: SplitMesh, scene: Scene, motion: Floats, state: State) -> tuple[Data, Data]:
    """Point and cell data of a map of rock that is not meshed, from the motion (n, 3, 2) of all walls."""
    points, squares = map_cells(mesh)
    far = far_stress(scene, state.time, state.controls)
    nodes = UnmeshedRock(scene, mesh, points, motion, far)
    cells = UnmeshedRock(scene, mesh, points[squares].mean(axis=1), motion, far)
    return _formulas(nodes, cells, np.zeros(len(squares), dtype=np.int64))


def _formulas(nodes: Any, cells: Any, rocks: Ints) -> tuple[Data, Data]:
    point = {row.name: row.formula(nodes) for row in quantities("node").values() if row.field}
    cell: Data = {"rock": rocks}
    for row in quantities("cell").values():
        if row.field:
            values = row.formula(cells)
            cell[row.name] = rock.tensors(values) if row.kind == "tensor" else values
    return point, cell
