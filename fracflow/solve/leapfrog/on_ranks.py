"""Sections and unknowns of other ranks with which a rank takes explicit steps in a row by itself.

Each rank has all clusters of sections that push its unknowns, or those that are damped with them. It solves for these as their
own ranks do, to the bit. The motion of unknowns of others comes once a step. So no forces of joints or of damping travel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.layout import Rows, local_rows
from fracflow.solve.clusters import Clusters, Exchange
from fracflow.solve.leapfrog.compiled import address
from fracflow.solve.leapfrog.damping import half_of
from fracflow.solve.leapfrog.guess import JointGuess, rows_of_laws
from fracflow.solve.leapfrog.joint_nodes import shares_columns
from fracflow.solve.leapfrog.nodes import Nodes
from fracflow.solve.leapfrog.numbering import GhostWay
from fracflow.solve.leapfrog.rock import Cells
from fracflow.solve.newton import MOST_CHANGES


class _Sections(NamedTuple):
    """Sections by global numbers (s,), how many unknowns each has (s,), these (k,), entries (k, 2), and laws (s, 13)."""

    number: Ints
    counts: Ints
    columns: Ints
    entries: Floats
    laws: Floats

    def of(self, chosen: Ints) -> _Sections:
        """Chosen ones (c,), in that order."""
        counts = self.counts[chosen]
        first = (np.cumsum(self.counts) - self.counts)[chosen]
        at = np.repeat(first - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        return _Sections(self.number[chosen], counts, self.columns[at], self.entries[at], self.laws[chosen])

    def touched(self, chosen: Bools) -> Bools:
        """Which ones (s,) have an unknown among the chosen (k,)."""
        section = np.repeat(np.arange(len(self.counts)), self.counts)
        return np.bincount(section[chosen], minlength=len(self.counts)) > 0


def _joined(parts: list[_Sections]) -> _Sections:
    return _Sections(*(np.concatenate(each) for each in zip(*parts, strict=True)))


@dataclass(frozen=True)
class Beyond:
    """A rank's own things, and those of other ranks behind them.

    is_coupled, has_path  of the compiled laws
    sections  how to get rows of the sections of others;  ``count`` of all sections here
    moved     motion of ``Nodes.every``, and behind these of unknowns of others [length];  ``way`` how that of others comes
    given     counts and addresses by their names in ``steps.c``;  ``kept`` the arrays
    """

    is_coupled: bool
    has_path: bool
    sections: Exchange
    count: int
    moved: Floats
    way: GhostWay
    given: dict[str, int]
    kept: list[np.ndarray]

    def receive_motion(self) -> None:
        """Bring the motion of unknowns of others. Collective."""
        self.way.begin()
        self.way.end()

    def destroy(self) -> None:
        """Free the way. Collective."""
        self.way.destroy()


def beyond(nodes: Nodes, guess: JointGuess | None, damping: list[PETSc.Mat], others: bool) -> Beyond | None:
    """None where loops do not serve on all ranks; ``others``: more acts here than they have. Collective."""
    joints, layout, comm = nodes.operators.joints, nodes.operators.layout, nodes.operators.layout.comm
    law, rock = joints.copy_of_law if len(joints.weights) else None, nodes.rock
    lacks = others or guess is None or not isinstance(rock, Cells) or len(nodes.bodies) > 0 or not shares_columns(nodes)
    lacks |= len(joints.weights) > 0 and law is None
    kinds = comm.allgather((lacks, None if law is None else (law.is_coupled, law.has_path)))
    known = {kind for _, kind in kinds if kind is not None}
    if any(each for each, _ in kinds) or len(known) > 1:
        return None
    assert guess is not None and isinstance(rock, Cells)
    own = len(joints.weights)
    starts = np.concatenate([[0], np.cumsum(comm.allgather(len(joints.weights)))])
    low = int(layout.solid_starts[comm.rank])
    high = low + layout.solid_count

    def is_own(columns: Ints) -> Bools:
        return np.asarray((columns >= low) & (columns < high))

    rows = [_nonzero(local_rows(each)) for each in damping]
    of_rows = np.unique(np.concatenate([np.zeros(0, np.int64), *(each.cols for each in rows)]))
    of_rows = of_rows[~is_own(of_rows)]
    sections, batches = _clusters(nodes, guess.clusters, starts, of_rows)
    wanted = np.concatenate([sections.columns, of_rows])
    pairs = 2 * np.unique(wanted[~is_own(wanted)] // 2)[:, None] + np.arange(2)
    ghosts, first = pairs.ravel(), len(nodes.every) + len(nodes.every) % 2
    half = _damping(nodes, rows, low, ghosts, first)
    if comm.allreduce(int(half is None)):
        return None
    assert half is not None
    to_ghosts = _exchange(comm, layout.solid_starts, ghosts)
    inverse, place = 1.0 / nodes.mass, np.full(len(nodes.mass), -1)
    inverse[nodes.held], place[nodes.every] = 0.0, np.arange(len(nodes.every))
    of_ghosts = to_ghosts.there(np.stack([inverse, place], axis=1))
    if comm.allreduce(int((of_ghosts[:, 1] < 0.0).any())):
        return None
    starts_of_motion = np.concatenate([[0], np.cumsum(comm.allgather(first))])
    places = of_ghosts[:, 1].astype(np.int64) + starts_of_motion[owner_of(layout.solid_starts, ghosts)]
    moved, is_here, columns = np.zeros(first + len(ghosts)), is_own(sections.columns), sections.columns
    at, to = np.empty(len(columns), np.int64), np.empty(len(columns), np.int64)
    at[is_here] = nodes.find(columns[is_here] - low)
    to[is_here] = np.searchsorted(nodes.pushed, at[is_here])
    behind = np.searchsorted(ghosts, columns[~is_here])
    at[~is_here], to[~is_here] = first + behind, len(nodes.pushed) + behind
    floats = {
        "entries": sections.entries, "weights": sections.laws[:, 1], "laws": sections.laws,
        "inverse_pushed": np.concatenate([nodes.inverse, of_ghosts[:, 0]]),
        "before": np.zeros((len(sections.number), 13)), "found": np.zeros((len(sections.number), 7)), "damping": half[2],
    }  # fmt: skip
    narrow = {
        "starts": np.concatenate([[0], np.cumsum(sections.counts)]), "at": at, "to": to,
        "of_pushed": np.concatenate([nodes.pushed, first + np.arange(len(ghosts))]),
        "damping_starts": half[0], "damping_columns": half[1],
    }  # fmt: skip
    of_batches = [each for batch in batches for each in batch]
    wide = {
        "places": nodes.places, "places_forced": nodes.places_forced, "places_pushed": nodes.places_pushed,
        "shapes": np.array([each.shape for each, _ in batches], np.int64).reshape(-1, 2),
        "rows": np.array([address(each) for each, _ in batches], np.int64),
        "compliance": np.array([address(each) for _, each in batches], np.int64),
    }  # fmt: skip
    kinds_of = ((floats, np.float64), (narrow, np.int32), (wide, np.int64))
    arrays = {name: np.ascontiguousarray(each, kind) for group, kind in kinds_of for name, each in group.items()}
    is_coupled, has_path = known.pop() if known else (False, False)
    given = rock.given() | {name: address(each) for name, each in arrays.items()}
    given |= {
        "sections": own, "sections_all": len(sections.number), "every": len(nodes.every),
        "forced": len(nodes.places_forced), "pushed": len(nodes.pushed), "pushed_all": len(nodes.pushed) + len(ghosts),
        "ghosts": len(ghosts), "first_ghost": first, "damped": len(half[0]) - 1, "batches": len(batches), "most": guess.most,
        "most_changes": MOST_CHANGES, "is_coupled": int(is_coupled), "has_path": int(has_path),
    }  # fmt: skip
    way = GhostWay(comm, places, (moved[:first], moved[first:]))
    of_others = _exchange(comm, starts, sections.number[own:])
    kept = [*arrays.values(), *of_batches]
    return Beyond(is_coupled, has_path, of_others, len(sections.number), moved, way, given, kept)


def _exchange(comm: MPI.Comm, starts: Ints, wanted: Ints) -> Exchange:
    """How rows come of ascending numbers (w,) of other ranks, whose first ones are ``starts`` (ranks + 1,). Collective."""
    owner = owner_of(starts, wanted)
    asked = comm.alltoall([wanted[owner == rank] for rank in range(comm.size)])
    sent, received = np.array([len(each) for each in asked]), np.bincount(owner, minlength=comm.size)
    return Exchange(comm, np.concatenate(asked) - starts[comm.rank], sent, received)


def _clusters(
    nodes: Nodes, clusters: Clusters, starts: Ints, damping: Ints
) -> tuple[_Sections, list[tuple[Ints, Floats]]]:
    """Sections of all clusters that have sections or unknowns of this rank, its own first, and these. Collective.

    starts   (ranks + 1,) first sections of all ranks
    damping  (g,) unknowns of others whose motion it damps with its own, and which clusters push
    Clusters are their sections (c, m) in that order, and compliances (c, 2 m, 2 m).
    """
    comm, solid_starts, exchange = nodes.operators.layout.comm, nodes.operators.layout.solid_starts, clusters.exchange
    ends = np.cumsum(exchange.sent)
    own = _own_sections(nodes, int(starts[comm.rank]))
    to = [own.of(exchange.order[end - count : end]) for end, count in zip(ends, exchange.sent, strict=True)]
    solved = _joined(comm.alltoall(to))
    owner, of_column = owner_of(starts, solved.number), owner_of(solid_starts, solved.columns)
    damped, parts = comm.allgather(damping), []
    for rank in range(comm.size):
        wanted = (owner == rank) | solved.touched((of_column == rank) | np.isin(solved.columns, damped[rank]))
        chosen = [(each, wanted[each.sections].any(axis=1)) for each in clusters.batches]
        members = [batch.sections[here] for batch, here in chosen]
        used = np.unique(np.concatenate([np.zeros(0, np.int64), *(each.ravel() for each in members)]))
        found = [(solved.number[batch.sections[here]], batch.compliance[here]) for batch, here in chosen if here.any()]
        parts.append((solved.of(used), found))
    parts = comm.alltoall(parts)
    sections = _joined([each for each, _ in parts])
    sections = sections.of(np.lexsort((sections.number, owner_of(starts, sections.number) != comm.rank)))
    order = np.argsort(sections.number)
    batches = []
    for numbers, compliance in (batch for _, found in parts for batch in found):
        rows = order[np.searchsorted(sections.number, numbers, sorter=order)]
        batches.append((np.ascontiguousarray(rows, np.int64), np.ascontiguousarray(compliance, float)))
    return sections, batches


def _own_sections(nodes: Nodes, first: int) -> _Sections:
    """This rank's, from number ``first`` on, with the unknowns that they have any entry at."""
    joints = nodes.operators.joints
    starts, columns, values = joints.jump.getValuesCSR()
    counts, number = np.diff(starts), len(joints.weights)
    even = np.repeat(np.arange(len(counts)) % 2 == 0, counts)
    entries = np.stack([values[even], values[~even]], axis=1)
    kept = (entries != 0.0).any(axis=1)
    section = np.repeat(np.arange(number), counts[::2])[kept]
    counts = np.bincount(section, minlength=number)
    laws = rows_of_laws(joints)
    return _Sections(first + np.arange(number), counts, columns[even][kept].astype(np.int64), entries[kept], laws)


def _nonzero(rows: Rows) -> Rows:
    kept = rows.values != 0.0
    return Rows(rows.rows[kept], rows.cols[kept], rows.values[kept])


def _damping(nodes: Nodes, rows: list[Rows], low: int, ghosts: Ints, first: int) -> tuple[Ints, Ints, Floats] | None:
    """Starts, columns and blocks of rows of damping as ``steps.c`` takes them; None where they are not as it needs them.

    low     first unknown of this rank
    ghosts  (g,) numbers of unknowns of others, which have places from ``first`` on
    """
    from scipy import sparse  # imports much

    if not rows or not len(rows[0].rows):
        return np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros((0, 2, 2))
    (numbers,), (here,) = ([each.numbers for each in nodes.damping.values()], rows)
    local = here.cols - low
    is_own = (local >= 0) & (local < len(nodes.mass))
    if not np.isin(here.rows, numbers).all() or not np.isin(local[is_own], numbers).all():
        return None
    count = len(numbers)
    columns = np.where(is_own, np.searchsorted(numbers, local), count + np.searchsorted(ghosts, here.cols))
    row = np.searchsorted(numbers, here.rows)
    whole = sparse.csr_matrix((here.values, (row, columns)), shape=(count, count + len(ghosts)))
    half = half_of(whole)
    if half is None:
        return None
    nodes_here = half[1]
    return half[0], np.where(nodes_here < count // 2, nodes_here, nodes_here + (first - count) // 2), half[2]
