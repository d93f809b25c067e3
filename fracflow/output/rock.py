"""Points, cells and fields, which rank 0 gets from all ranks by slabs: those of the rock, or of a map, and of fractures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow.mesh.blocks import Blocks, SolidBlock
from fracflow.mesh.data import Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.plane.unmeshed import map_cells
from fracflow.mesh.slabs import ByRows, Distributed, Order, on_rank_0
from fracflow.model import stress as rock
from fracflow.model.state import State
from fracflow.output.fields import stored
from fracflow.output.probes import Cells, fracture_fields
from fracflow.output.sampling import StateSampler
from fracflow.output.unmeshed import UnmeshedRock, far_stress
from fracflow.scene.quantities import quantities
from fracflow.scene.scene import Scene
from fracflow.storage.sealed import Slabs, whole

Data = dict[str, NDArray[Any]]
ROWS_AT_ONCE = 2**16


class ShownRock(NamedTuple):
    """Points (n, 3) and cells (m, k) of the rock that fields show, and what else is asked for at once."""

    points: Slabs
    cells: Slabs
    beside: Mapping[str, Slabs]


@contextmanager
def shown_rock(
    blocks: Blocks, mesh: SplitMesh | None, beside: Mapping[str, Distributed] | None = None
) -> Iterator[ShownRock | None]:
    """Points and cells of the rock for a ``FieldWriter`` on rank 0, None elsewhere. Collective.

    mesh    of rank 0, of which there is a map where the rock is not meshed
    beside  other arrays that rank 0 needs
    """
    has_cells = not is_unmeshed(blocks.solid.cells)
    asked = dict(beside or {})
    with on_rank_0(blocks.comm, (_geometry(blocks) if has_cells else {}) | asked) as found:
        if found is None or mesh is None:
            yield None
            return
        others = {name: found[name] for name in asked}
        if has_cells:
            yield ShownRock(found["point/"], found["cell/"], others)
        else:
            points, squares = map_cells(mesh)
            yield ShownRock(whole(stored({"": points}, None)["point/"]), whole(squares), others)


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
    with on_rank_0(
        blocks.comm, _distributed(blocks, _shown(blocks.solid, scene, sample.motion_here(), state))
    ) as found:
        yield found


@contextmanager
def fracture_slabs(sample: StateSampler) -> Iterator[Mapping[str, Slabs] | None]:
    """Fields of fractures for ``FieldWriter.write_stored`` on rank 0, None elsewhere. Collective."""
    blocks, columns = sample.sampler.operators.blocks, sample.sampler.fields
    joints, total = blocks.joints, blocks.sizes.joints
    ends = Order(blocks.comm, (2 * joints.ids[:, None] + np.arange(2)).ravel(), 2 * total)
    each = Order(blocks.comm, joints.ids, total)
    found = stored(fracture_fields(columns, columns.fill(sample.ends)), {"fracture": joints.fracture})
    of_all = {name: (ends if name.startswith("point") else each).of(values) for name, values in found.items()}
    with on_rank_0(blocks.comm, of_all) as arrays:
        yield arrays


def _distributed(blocks: Blocks, arrays: Mapping[str, ByRows]) -> dict[str, Distributed]:
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


@dataclass(frozen=True)
class _Field:
    """A field of a rank's rock, computed when it is asked for: all fields at once may fill the memory.

    name    as ``stored`` gives it
    count   of rows
    motion  (n, 3, 2) of its nodes; ``moves`` and ``far`` as of ``Cells``
    """

    name: str
    count: int
    block: SolidBlock
    scene: Scene
    motion: Floats
    moves: bool
    far: Floats

    def __getitem__(self, rows: Ints | slice) -> NDArray[Any]:
        """Values (k, ...) at own nodes, or at cells (k,), some at a time: what is found on the way is larger."""
        chosen = np.arange(self.count)[rows]
        found = np.empty((len(chosen), *self._none.shape[1:]), dtype=self.dtype)
        for first in range(0, len(chosen), ROWS_AT_ONCE):
            some = slice(first, first + ROWS_AT_ONCE)
            found[some] = self._of(chosen[some])
        return found

    def _of(self, rows: Ints) -> NDArray[Any]:
        place, _, key = self.name.partition("/")
        if place == "point":
            moved = self.motion[rows]
            nodes = SimpleNamespace(displacement=moved[:, 0], velocity=moved[:, 1], acceleration=moved[:, 2])
            return stored({key: quantities("node")[key].formula(nodes)}, None)[self.name]
        block = self.block
        cells = Cells(self.scene, block, rows, block.points, block.cells[rows], self.motion, self.moves, self.far)
        return stored(None, {key: _of_cells(key, cells, block.cell_rock[rows])})[self.name]

    @cached_property
    def _none(self) -> NDArray[Any]:
        return self._of(np.zeros(0, dtype=np.int64))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the numbers."""
        return self._none.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """That of all rows."""
        return self.count, *self._none.shape[1:]


def _shown(block: SolidBlock, scene: Scene, motion: Floats, state: State) -> dict[str, _Field]:
    """Point data of a rank's own nodes and data of its cells, from the motion (n, 3, 2) of its nodes."""
    about = block, scene, motion, state.energy["kinetic"] != 0.0, far_stress(scene, state.time, state.controls)
    points, cells = _names()
    found = {f"point/{key}": _Field(f"point/{key}", block.owned, *about) for key in points}
    return found | {f"cell/{key}": _Field(f"cell/{key}", len(block.cells), *about) for key in cells}


def _map_fields(mesh: SplitMesh, scene: Scene, motion: Floats, state: State) -> tuple[Data, Data]:
    """Point and cell data of a map of rock that is not meshed, from the motion (n, 3, 2) of all walls."""
    points, squares = map_cells(mesh)
    far = far_stress(scene, state.time, state.controls)
    nodes = UnmeshedRock(scene, mesh, points, motion, far)
    cells = UnmeshedRock(scene, mesh, points[squares].mean(axis=1), motion, far)
    return _formulas(nodes, cells, np.zeros(len(squares), dtype=np.int64))


def _formulas(nodes: Any, cells: Any, rocks: Ints) -> tuple[Data, Data]:
    point, cell = _names()
    return (
        {key: quantities("node")[key].formula(nodes) for key in point},
        {key: _of_cells(key, cells, rocks) for key in cell},
    )


def _names() -> tuple[list[str], list[str]]:
    """Names of the fields of points, and of cells."""
    point, cell = ([key for key, row in quantities(home).items() if row.field] for home in ("node", "cell"))
    return point, ["rock", *cell]


def _of_cells(key: str, cells: Any, rocks: Ints) -> NDArray[Any]:
    """A field of cells that are of ``rocks`` (m,)."""
    if key == "rock":
        return rocks
    row = quantities("cell")[key]
    values: Floats = row.formula(cells)
    return rock.tensors(values) if row.kind == "tensor" else values
