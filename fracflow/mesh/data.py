"""The mesh before and after the split, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class RawMesh:
    """A conforming mesh in which fractures are still facets shared by two cells.

    points           (n, dim)  coordinates [length]
    cells            (m, c)    nodes, counter-clockwise or as Gmsh orders them; -1 pads cells with fewer than c nodes
    cell_rock        (m,)      index into ``rocks``
    fracture_facets  (f, k)    nodes of fracture facets, each ordered along its trace, or around its normal: 2 in the
                               plane, 3 or 4 in space
    fracture_of      (f,)      index into ``fractures``
    side_facets      (s, k)    nodes of boundary facets that carry a name
    side_of          (s,)      index into ``sides``
    named_points     name -> node
    notes            what was changed in the traces before meshing, a line each
    """

    points: Floats
    cells: Ints
    cell_rock: Ints
    rocks: tuple[str, ...]
    fracture_facets: Ints
    fracture_of: Ints
    fractures: tuple[str, ...]
    side_facets: Ints
    side_of: Ints
    sides: tuple[str, ...]
    named_points: dict[str, int]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class CellSums:
    """Sums over all cells of a mesh of which rank 0 has the near ones alone.

    cells       how many there are
    piece       (n,) block of rock of each node on near cells: what no joint cuts
    piece_area  (p,) of each block [length**2]
    piece_rock  (p,) index into the rocks
    has_rock    (r, p) whether each block has cells of each rock
    rock_area   (r,) of each rock [length**2]
    blunt       share of cells with a corner over 150 degrees
    """

    cells: int
    piece: Ints
    piece_area: Floats
    piece_rock: Ints
    has_rock: Bools
    rock_area: Floats
    blunt: float


@dataclass(frozen=True)
class SplitMesh:
    """The mesh with fractures split into zero-thickness joints, and the network of flow elements on them.

    points         (n, dim)  coordinates; copies of a node share them [length]
    origin         (n,)      node of the raw mesh each node is a copy of; the first copy keeps the number
    cells          (m, c)    nodes, -1 pads
    cell_rock      (m,)      index into ``rocks``
    joint_bottom   (f, k)    nodes on the right of the trace, in its direction; behind the normal of a surface
    joint_top      (f, k)    nodes on the left, facing ``joint_bottom`` one by one; equal at a tip
    joint_cells    (f, 2)    cell below, cell above
    joint_flow     (f, k)    flow nodes: one per raw fracture node, shared at junctions
    joint_fracture (f,)      index into ``fractures``
    joint_along    (f, k)    distance of each end from the start of its fracture [length]; 0 in space
    flow_origin    (q,)      raw node of each flow node
    side_facets    (s, k)    nodes of named boundary facets
    side_cell      (s,)      the cell a side facet belongs to
    side_of        (s,)      index into ``sides``
    named_points   name -> raw node
    notes          what was changed in the traces before meshing, a line each
    cuts           how often each cell is cut in four once it is on its rank
    near           how many cells come first, with all that is on them; -1 where all do. See ``mesh.near_cells``
    coarse         the mesh, with ``cuts``, that this one was made from; None where none was
    sums           of a mesh that has the near cells alone and no ``coarse``; see ``mesh.slices``
    """

    points: Floats
    origin: Ints
    cells: Ints
    cell_rock: Ints
    rocks: tuple[str, ...]
    joint_bottom: Ints
    joint_top: Ints
    joint_cells: Ints
    joint_flow: Ints
    joint_fracture: Ints
    joint_along: Floats
    fractures: tuple[str, ...]
    flow_origin: Ints
    side_facets: Ints
    side_cell: Ints
    side_of: Ints
    sides: tuple[str, ...]
    named_points: dict[str, int]
    notes: tuple[str, ...] = ()
    cuts: int = 0
    near: int = -1
    coarse: SplitMesh | None = None
    sums: CellSums | None = None

    @property
    def uncut(self) -> SplitMesh:
        """The whole mesh before its cells were cut: itself where none were."""
        return self.coarse or self

    @property
    def children(self) -> int:
        """How many cells were made of each cell of ``uncut``: those of the cell c are the next ones from children * c on."""
        return 1 if self.coarse is None else 4**self.coarse.cuts

    @property
    def pieces(self) -> int:
        """How many joints were made of each joint of ``uncut``, numbered as cells are."""
        return 1 if self.coarse is None else 2**self.coarse.cuts

    @property
    def near_count(self) -> int:
        """How many cells come first, or all."""
        return len(self.cells) if self.near < 0 else self.near


def is_unmeshed(cells: Ints) -> bool:
    """Whether cells (m, k) are walls of fractures in rock that is not meshed."""
    return cells.shape[1] == 2
