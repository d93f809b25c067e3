"""Thin rock between a fracture and another one, or a free side, that joints at the tip of the fracture are too long for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fracflow.diagnostics.nearest import nearest_within
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.places import extent_of, place_text
from fracflow.mesh.plane.sizes import ROOT, SLENDER
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH

ALONG = (1.0 + SLENDER**2) ** -0.5  # the cosine of the angle of such a wedge
FACING = 1.0
"""Joints in the gap of fractures side by side. The volume of the shorter errs by 3 to 7 %, with 0.6 by 5 to 14 %."""
COVERED = 2.0
"""Joints in the gap of a fracture that another covers all along, and that opens by a thousandth of it, or a hundredth. Its
volume errs by 4 to 16 %, with 1 by 70 to 95 %."""
FREE = 8.0  # joints in the thickness of rock under a free side: its bending errs by 4 %, with 4 by 13 %, with 2 by 49 %
LOCKS = 2.0 / 3.0
"""Rock g thick bends too stiffly by at least 1 + 2/3 (h/g)^2, of triangles h long with one strain each. This is the variance
h^2/18 of places in a triangle over g^2/12 of places in the rock. Measured 4.1 at h = 2 g (3.7), and 2.7 at h = g (1.7)."""
REACH = 2.0 * ROOT  # joints at a tip, within which the rock beside it is looked for
AROUND = 1.2  # thicknesses at the tip, within which rock counts as between both
MOST = 10  # lines
ROUND_OFF = 1e-9  # of lengths


@dataclass(frozen=True)
class ThinRock:
    """Rock that ends at the tip of a fracture.

    fracture   that has the tip
    other      the fracture or side beyond the rock
    is_side    whether that is a free side
    tip        (2,) [length]
    meeting    (2,) where both meet, the nearest to the tip; None where they do not [length]
    thickness  at the tip [length]
    length     of the fracture along the rock [length]
    share      of the fracture that lies along the rock [1]
    joint      the one at the tip, or the longest along rock that does not end where both meet [length]
    """

    fracture: str
    other: str
    is_side: bool
    tip: Floats
    meeting: Floats | None
    thickness: float
    length: float
    share: float
    joint: float

    @property
    def is_covered(self) -> bool:
        """Whether another fracture lies beside this one all along."""
        return not self.is_side and self.meeting is None and self.share > 1.0 - 1e-9

    @property
    def wanted(self) -> float:
        """The longest joint that serves [length]."""
        facing = COVERED if self.is_covered else FACING
        per_thickness = FREE if self.is_side else facing if self.meeting is None else ROOT
        return self.thickness / per_thickness

    @property
    def locking(self) -> float:
        """How many times too stiffly rock under a free side bends, at least."""
        return 1.0 + LOCKS * (self.joint / self.thickness) ** 2


def thin_rock_lines(scene: Scene, mesh: SplitMesh) -> list[str]:
    """A line for each piece of thin rock that the joints at its end are too long for, the worst first; in the plane."""
    coarse = [each for each in _thin_rock(scene, mesh) if each.joint > each.wanted * (1.0 + ROUND_OFF)]
    coarse.sort(key=lambda each: (-each.joint / each.wanted, each.fracture, each.other, *each.tip.tolist()))
    of_pairs: dict[frozenset[str], ThinRock] = {}
    for each in coarse:
        of_pairs.setdefault(frozenset((each.fracture, each.other)), each)
    extent, more = extent_of(mesh.points), len(of_pairs) - MOST
    lines = [_line(scene, each, extent) for each in list(of_pairs.values())[:MOST]]
    return lines + ([f"mesh: thin rock: {more} more pairs"] if more > 0 else [])


def _line(scene: Scene, rock: ThinRock, extent: float) -> str:
    unit = scene.unit_system.behind(LENGTH)
    other = f"side {rock.other}" if rock.is_side else rock.other
    if rock.meeting is None:
        how = f"run side by side over {rock.length:.3g}{unit}"
    else:
        reach = float(np.linalg.norm(rock.tip - rock.meeting))
        how = f"meet at {np.degrees(np.arcsin(rock.thickness / reach)):.2g} degrees"
    if rock.is_side:
        does = f"the rock bends at least {rock.locking:.2g} times too stiffly, and {rock.fracture} opens too little"
    elif rock.is_covered:
        far = "several times" if rock.joint >= rock.thickness else "by some tens of per cent"
        does = f"{rock.other} covers all of {rock.fracture}, which where open may open {far} too little or too much"
    elif rock.meeting is None:
        does = f"where open, {rock.fracture} may open by some tens of per cent too little or too much"
    else:
        does = f"where both are open, the opening is parted wrongly between {rock.fracture} and {rock.other}"
    remedy = f"geometry.{'size_at_tips' if rock.meeting is not None and not rock.is_side else 'size_at_fractures'}"
    if scene.geometry is None:
        remedy = "by a finer mesh"
    return (
        f"mesh: {rock.fracture} and {other} {how}, and joints of {rock.joint:.3g}{unit} do not resolve the rock between them,"
        f" {rock.thickness:.3g}{unit} thick at the tip {place_text(rock.tip, extent)}: {does}: it needs joints of"
        f" {_down(rock.wanted):.2g}{unit} there, {remedy}"
    )


def _down(length: float) -> float:
    """A length of two digits, no longer: joints of more would have the line again."""
    unit = 10.0 ** (np.floor(np.log10(length)) - 1.0)
    return float(np.floor(length / unit * (1.0 + 1e-9)) * unit)


def _thin_rock(scene: Scene, mesh: SplitMesh) -> Iterator[ThinRock]:
    """All thin rock at tips of fractures in the plane, resolved or not, within ``REACH`` joints."""
    tips = np.argwhere(mesh.joint_bottom == mesh.joint_top)  # walls hang together there
    if mesh.points.shape[1] != 2 or not len(tips) or all(scene.rock[name].rigid for name in mesh.rocks):
        return
    facets = _facets(scene, mesh)
    names, longest = (*mesh.fractures, *mesh.sides), facets.length.max()
    middle = facets.ends.mean(axis=1)
    by_x = np.argsort(middle[:, 0], kind="stable")
    sorted_x = middle[by_x, 0]
    for joint, end in tips.tolist():
        place, own, size = facets.ends[joint, end], facets.owner[joint], facets.length[joint]
        first, last = np.searchsorted(sorted_x, place[0] + (REACH * size + longest) * np.array([-1.0, 1.0]))
        near = by_x[first:last]
        near = near[facets.owner[near] != own]
        near = near[np.abs(facets.heading[near] @ facets.heading[joint]) > ALONG]
        away = _distances(place, facets.ends[near])
        near, away = near[away < REACH * size], away[away < REACH * size]
        for other in np.unique(facets.owner[near]).tolist():
            thickness = float(away[facets.owner[near] == other].min())
            beside = facets.beside(own, other, AROUND * thickness)
            length = float(facets.length[beside].sum())
            own_length = facets.length[facets.of(own)]
            if not 0.0 < thickness < SLENDER * length or length < own_length.max():
                continue
            shared = np.intersect1d(facets.nodes[facets.of(own)], facets.nodes[facets.of(other)])
            at = mesh.points[shared]
            meeting = at[np.argmin(np.linalg.norm(at - place, axis=1))] if len(at) else None
            is_side = other >= len(mesh.fractures)
            ends_there = meeting is not None and not is_side
            worst = float(size if ends_there else facets.length[beside].max())
            share = length / float(own_length.sum())
            yield ThinRock(names[own], names[other], is_side, place, meeting, thickness, length, share, worst)


@dataclass(frozen=True)
class _Facets:
    """Joints, then facets of free sides.

    nodes    (f, 2) before the split
    ends     (f, 2, 2) [length]
    owner    (f,) fracture, or side behind the fractures
    length   (f,) [length]
    heading  (f, 2) [1]
    by_owner (f,) facets in the order of their owners, each of which begins at its entry of ``starts``
    """

    nodes: Ints
    ends: Floats
    owner: Ints
    length: Floats
    heading: Floats
    by_owner: Ints
    starts: Ints

    def of(self, owner: int) -> Ints:
        """Those of one owner."""
        return self.by_owner[self.starts[owner] : self.starts[owner + 1]]

    def beside(self, own: int, other: int, within: float) -> Ints:
        """Those of one owner whose middles face one of the other at a distance of at most so much [length]."""
        mine, theirs = self.of(own), self.of(other)
        middle, start = self.ends[mine].mean(axis=1), self.ends[theirs, 0]
        farthest = float(np.hypot(within, self.length[theirs].max())) * (1.0 + ROUND_OFF)
        nearest = nearest_within(middle, self.ends[theirs].mean(axis=1), farthest)
        is_near = nearest >= 0
        mine, middle, nearest = mine[is_near], middle[is_near], nearest[is_near]
        step = middle - start[nearest]
        heading, length = self.heading[theirs[nearest]], self.length[theirs[nearest]]
        along = np.sum(step * heading, axis=1)
        across = np.abs(step[:, 0] * heading[:, 1] - step[:, 1] * heading[:, 0])
        return mine[(across <= within) & (np.abs(along - 0.5 * length) <= length)]


def _facets(scene: Scene, mesh: SplitMesh) -> _Facets:
    held = {side for support in scene.support for side in support.on}
    held |= {side for term in scene.terms for side in term.on if term.holds}
    is_free = ~np.isin(np.array(mesh.sides, dtype=str), sorted(held))
    free = np.flatnonzero(is_free[mesh.side_of]) if len(mesh.sides) else np.zeros(0, dtype=np.int64)
    nodes = np.concatenate([mesh.flow_origin[mesh.joint_flow], mesh.origin[mesh.side_facets[free]]])
    ends = np.concatenate([mesh.points[mesh.joint_bottom], mesh.points[mesh.side_facets[free]]])
    step = np.diff(ends, axis=1)[:, 0]
    length = np.linalg.norm(step, axis=1)
    owner = np.concatenate([mesh.joint_fracture, len(mesh.fractures) + mesh.side_of[free]])
    starts = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(mesh.fractures) + len(mesh.sides)))])
    return _Facets(nodes, ends, owner, length, step / length[:, None], np.argsort(owner, kind="stable"), starts)


def _distances(place: Floats, ends: Floats) -> Floats:
    """Distance (n,) of a place (2,) from edges (n, 2, 2), infinite where its foot is beyond them [length]."""
    step = ends[:, 1] - ends[:, 0]
    along = np.sum((place - ends[:, 0]) * step, axis=1) / np.sum(step * step, axis=1)
    across = np.linalg.norm(place - ends[:, 0] - along[:, None] * step, axis=1)
    return np.where((along > -1e-9) & (along < 1.0 + 1e-9), across, np.inf)
