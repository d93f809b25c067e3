"""Facets of a fracture ordered head to tail, whatever directions a file gives them."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Ints
from fracflow.mesh.facets import components


def orient(facets: Ints, fracture_of: Ints) -> Ints:
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
