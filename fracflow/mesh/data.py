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
    cells            (m, k)    nodes, counter-clockwise; -1 pads cells with fewer than k nodes
    cell_rock        (m,)      index into ``rocks``
    fracture_facets  (f, dim)  nodes of fracture facets, each ordered along its trace
    fracture_of      (f,)      index into ``fractures``
    side_facets      (s, dim)  nodes of boundary facets that carry a name
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
class SplitMesh:
    """The mesh with fractures split into zero-thickness joints, and the network of flow elements on them.

    points         (n, dim)  coordinates; copies of a node share them [length]
    origin         (n,)      node of the raw mesh each node is a copy of; the first copy keeps the number
    cells          (m, k)    nodes, -1 pads
    cell_rock      (m,)      index into ``rocks``
    joint_bottom   (f, dim)  nodes on the right of the trace, in its direction
    joint_top      (f, dim)  nodes on the left, facing ``joint_bottom`` one by one; equal at a tip
    joint_cells    (f, 2)    cell below, cell above
    joint_flow     (f, dim)  flow nodes: one per raw fracture node, shared at junctions
    joint_fracture (f,)      index into ``fractures``
    joint_along    (f, dim)  distance of each end from the start of its fracture [length]
    flow_origin    (q,)      raw node of each flow node
    side_facets    (s, dim)  nodes of named boundary facets
    side_cell      (s,)      the cell a side facet belongs to
    side_of        (s,)      index into ``sides``
    named_points   name -> raw node
    notes          what was changed in the traces before meshing, a line each
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
