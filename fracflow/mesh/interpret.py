"""Elements get their meaning: physical surfaces name rocks, curves fractures and sides, points places.

Facets of a fracture are ordered head to tail, whatever directions a file gives them.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, Ints, RawMesh
from fracflow.mesh.facets import count_cells_at, number_rows, spot
from fracflow.mesh.files.gmsh import Elements
from fracflow.mesh.graph import components
from fracflow.storage.files import steers

EVERY = "default"  # [fracture.default] makes fractures of all named curves inside the mesh
CURVE = 1
FARTHEST = 1e100  # coordinate, whose square is still a number [length]


def interpret(elements: Elements, fractures: Collection[str], what: str) -> RawMesh:
    """Give elements their meaning. Raises InputError, naming ``what``, if they have none."""
    if elements.others:
        raise InputError(f"{what}: has elements of type {elements.others[0]}; use linear triangles and quads only")
    points = _plane(elements.points, what)
    cells, rock_group = _cells(elements, points, what)
    facets, facet_group = _distinct(elements, "line")
    named, point_group = _distinct(elements, "point")
    _check_names(elements, np.unique(np.concatenate([rock_group, facet_group, point_group])), what)

    is_fracture = _fracture_groups(elements, cells, facets, facet_group, fractures)
    on_fracture = is_fracture[facet_group]
    rocks, cell_rock = _names(elements, rock_group)
    names, fracture_of = _names(elements, facet_group[on_fracture])
    sides, side_of = _names(elements, facet_group[~on_fracture])
    for name in sorted(set(fractures) - set(names) - {EVERY}):
        known = ", ".join(sorted({*names, *sides})) or "none"
        raise InputError(f'{what}: no physical curve "{name}" for the fracture of that name (there are: {known})')

    is_used = np.zeros(len(points) + 1, dtype=bool)  # the last one stands for padding
    is_used[cells] = True
    used = np.flatnonzero(is_used[:-1])
    number = np.full(len(points) + 1, -1, dtype=np.int64)
    number[used] = np.arange(len(used))
    fracture_facets, side_facets = number[facets[on_fracture]], number[facets[~on_fracture]]
    for group, rows, of in ((names, fracture_facets, fracture_of), (sides, side_facets, side_of)):
        if np.any(rows < 0):
            name = group[of[np.argmax(np.any(rows < 0, axis=1))]]
            raise InputError(f'{what}: physical curve "{name}" is not made of edges of cells; embed it in its surface')
    return RawMesh(
        points=points[used],
        cells=number[cells],
        cell_rock=cell_rock,
        rocks=rocks,
        fracture_facets=facet_order(fracture_facets, fracture_of),
        fracture_of=fracture_of,
        fractures=names,
        side_facets=side_facets,
        side_of=side_of,
        sides=sides,
        named_points=_named_points(elements, number[named[:, 0]], point_group, what),
    )


def _plane(points: Floats, what: str) -> Floats:
    if np.any(is_bad := ~np.all(np.abs(points) <= FARTHEST, axis=1)):
        where, fault = points[np.argmax(is_bad)].tolist(), f"not finite, or beyond {FARTHEST:g}"
        raise InputError(f"{what}: a node has the coordinates {where}, which are {fault}; save the mesh again")
    if points.shape[1] == 3 and len(points):
        height = np.ptp(points[:, 2])
        if height > 1e-9 * np.ptp(points, axis=0).max():
            fault = f"the mesh is not in a plane z = constant (z varies by {height:.3g})"
            raise InputError(f"{what}: {fault}; give nodes one z")
    return points[:, :2]


def _distinct(elements: Elements, kind: str) -> tuple[Ints, Ints]:
    """Nodes and group of the elements that have one: a row for each of an element's groups, none twice."""
    element, group = elements.members[kind].T
    nodes = elements.nodes[kind][element]
    number = number_rows(np.column_stack([group, np.sort(nodes, axis=1)]))
    if number.max(initial=-1) + 1 == len(nodes):
        return nodes, group
    first = np.sort(np.unique(number, return_index=True)[1])
    return nodes[first], group[first]


def _cells(elements: Elements, points: Floats, what: str) -> tuple[Ints, Ints]:
    """Counter-clockwise cells, padded, and the group of each."""
    blocks, groups = [], []
    width = 4 if len(elements.nodes["quad"]) else 3
    for kind in ("triangle", "quad"):
        nodes, group = _distinct(elements, kind)
        members = np.bincount(elements.members[kind][:, 0], minlength=len(elements.nodes[kind]))
        bare = np.flatnonzero(members == 0)
        if len(bare):
            raise InputError(
                f"{what}: the cell at {spot(points, elements.nodes[kind][bare[0]])} belongs to no physical "
                f"surface; give every surface a name"
            )
        number = number_rows(np.sort(nodes, axis=1))
        if np.any(twice := np.bincount(number)[number] > 1):
            one, other = group[np.flatnonzero(number == number[np.argmax(twice)])[:2]]
            raise InputError(
                f"{what}: the cell at {spot(points, nodes[np.argmax(twice)])} belongs to two physical "
                f'surfaces, "{elements.group_names[one]}" and "{elements.group_names[other]}"; give it one'
            )
        padding = ((0, 0), (0, width - nodes.shape[1]))
        if len(nodes):
            blocks.append(np.pad(_turned(nodes, points, what), padding, constant_values=-1))
        groups.append(group)
    if not blocks:
        raise InputError(f"{what}: has no cells; it needs a surface, meshed or to be meshed, with a physical name")
    return np.concatenate(blocks), np.concatenate(groups)


def _turned(cells: Ints, points: Floats, what: str) -> Ints:
    """Cells (m, k) of one shape, clockwise ones turned. Raises InputError for flat or folded ones."""
    if not len(cells):
        return cells
    x, y = points[cells, 0].T, points[cells, 1].T
    along, up = np.roll(x, -1, axis=0) - x, np.roll(y, -1, axis=0) - y  # edge i starts at corner i
    turn = np.roll(along, 1, axis=0) * up - np.roll(up, 1, axis=0) * along
    is_clockwise = turn.sum(axis=0) < 0
    turn[:, is_clockwise] *= -1.0
    if np.any(is_bad := turn.min(axis=0) <= 0):
        worst = cells[np.argmax(is_bad)]
        raise InputError(f"{what}: the cell at {spot(points, worst)} is flat, folded or not convex; mesh it better")
    return np.where(is_clockwise[:, None], cells[:, ::-1], cells)


def _check_names(elements: Elements, used: Ints, what: str) -> None:
    for group in used:
        kind = ("point", "curve", "surface")[elements.group_dims[group]]
        it = f"{what}: physical {kind} {elements.group_tags[group]}"
        if not elements.group_names[group].strip():
            raise InputError(f"{it} has no name; give it one")
        if steers(elements.group_names[group]):  # terminals would take it for a command
            raise InputError(f"{it}: control characters in its name; rename it")


def _fracture_groups(elements: Elements, cells: Ints, facets: Ints, group: Ints, fractures: Collection[str]) -> Ints:
    """Which groups are fractures (groups,)."""
    is_fracture = np.isin(elements.group_names, list(fractures)) & (elements.group_dims == CURVE)
    if EVERY in fractures and len(facets):
        is_outside = count_cells_at(cells, facets) < 2
        is_fracture[np.setdiff1d(group, group[is_outside])] = True
    return is_fracture


def _names(elements: Elements, group: Ints) -> tuple[tuple[str, ...], Ints]:
    """Names of the groups that occur, and the place of each among them."""
    used, place = np.unique(group, return_inverse=True)
    return tuple(elements.group_names[index] for index in used), place.astype(np.int64)


def _named_points(elements: Elements, nodes: Ints, group: Ints, what: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for node, index in zip(nodes.tolist(), group.tolist(), strict=True):
        name = elements.group_names[index]
        if node < 0:
            raise InputError(f'{what}: physical point "{name}" is no node of a cell; embed it in its surface')
        if name in found:
            raise InputError(f'{what}: physical point "{name}" has several points; give each its own name')
        found[name] = node
    return found


def facet_order(facets: Ints, fracture_of: Ints) -> Ints:
    """Turn facets (f, 2) so that each chain of a fracture (f,) runs head to tail.

    The lowest-numbered facet of a chain keeps its direction. A node where more than two facets of one
    fracture meet constrains nothing: chains end there. Closed loops are chains too.
    """
    if not len(facets):
        return facets
    one, other, same = _neighbours(facets, fracture_of)
    # Each facet is two vertices, as it is and turned; an edge joins what must go together.
    count = len(facets)
    links_from = np.concatenate([one, one + count])
    links_to = np.concatenate([np.where(same, other, other + count), np.where(same, other + count, other)])
    label = components(links_from, links_to, 2 * count)
    as_is, turned = label[:count], label[count:]
    chain = np.minimum(as_is, turned)
    _, first, member = np.unique(chain, return_index=True, return_inverse=True)
    is_turned = as_is != as_is[first][member]
    return np.where(is_turned[:, None], facets[:, ::-1], facets)


def _neighbours(facets: Ints, fracture_of: Ints) -> tuple[Ints, Ints, Ints]:
    """Pairs of facets that follow each other on one fracture, and whether their directions agree."""
    node = facets.T.ravel()
    facet = np.tile(np.arange(len(facets)), 2)
    is_head = np.repeat([0, 1], len(facets))
    key = np.tile(fracture_of, 2) * (node.max() + 1) + node
    order = np.argsort(key, kind="stable")
    key = key[order]
    begins = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    pairs = begins[np.diff(np.append(begins, len(key))) == 2]
    one, other = order[pairs], order[pairs + 1]
    return facet[one], facet[other], is_head[one] != is_head[other]
