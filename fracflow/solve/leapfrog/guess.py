"""A first guess of the motion of joints in an explicit step, by the compiled loops of ``joints.c``.

Those have a copy of some laws, in the plane. The laws evaluate a guess like any other trial. Where they find no balance, or
another status, it counts for nothing. It spares four of five evaluations, each of which passes some 250 arrays. Where all
sections follow one law that has a compiled copy, the loops have this answer with their last trial, which spares the fifth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracflow.laws.compiled import PARAMETERS, Answers, number_of, table
from fracflow.mesh.data import Floats
from fracflow.model.joints import Joints
from fracflow.model.operators import Operators
from fracflow.model.state import SectionHistory, Sections
from fracflow.solve.clusters import Batch, Clusters
from fracflow.solve.leapfrog.compiled import address, library
from fracflow.solve.newton import MOST_CHANGES

MOST_MEMBERS = 8  # sections of a cluster, as in joints.c


class Trial(NamedTuple):
    """Motion of sections (s, 2), their histories with the statuses there, and iterations; -1 where it is no balance.

    strain, traction  (s, 2) there [length], and of the copies of the laws [stress]
    left              (s, 2) what is left of the motion [length]
    moved, worst      largest size of the motion, and of what is left of it
    answer            the sections there, where compiled laws answered with the last trial; else None
    """

    change: Floats
    status: SectionHistory
    iterations: int
    strain: Floats
    traction: Floats
    left: Floats
    moved: float
    worst: float
    answer: Sections | None


class _Batch:
    """A batch of clusters as joints.c takes it."""

    def __init__(self, batch: Batch) -> None:
        self._arrays = np.ascontiguousarray(batch.sections, np.int64), np.ascontiguousarray(batch.compliance, float)
        self.given = (*batch.sections.shape, *map(address, self._arrays))


class JointGuess:
    """Newton's method in each cluster by itself, compiled."""

    def __init__(self, operators: Operators, clusters: Clusters, most: int) -> None:
        """Bring the parameters of the laws to where clusters are solved for. Collective."""
        self.joints, self.clusters, self.most = operators.joints, clusters, most
        count = len(self.joints.weights)
        self._laws = clusters.exchange.there(rows_of_laws(self.joints))
        self._before, self._found = np.zeros((count, 13)), np.zeros((len(self._laws), 7))
        self._batches = [_Batch(each) for each in clusters.batches]
        self._friction = self.joints.copy_of_law if clusters.exchange.stays else None
        self._shapes = np.array([each.given[:2] for each in self._batches], np.int64).reshape(-1, 2)
        self._addresses = np.array([each.given[2:] for each in self._batches], np.int64).reshape(-1, 2).T.copy()

    def given(self) -> dict[str, int] | None:
        """Counts and addresses by their names in ``steps.c``; None where compiled laws do not answer with the last trial."""
        if self._friction is None:
            return None
        counts = {"batches": len(self._batches), "most": self.most, "most_changes": MOST_CHANGES}
        kind = {"is_coupled": int(self._friction.is_coupled), "has_path": int(self._friction.has_path)}
        rows, compliance = self._addresses
        arrays = {"laws": self._laws, "before": self._before, "found": self._found, "shapes": self._shapes}
        arrays |= {"rows": rows, "compliance": compliance}
        return counts | kind | {name: address(values) for name, values in arrays.items()}

    def solve(self, before: Sections, free: Floats, share: float) -> Trial:
        """The motion of sections that would move freely by ``free`` (s, 2); ``share`` as in ``joints``. Collective."""
        loops, here = library(), self._before
        assert loops is not None
        self._take(before, free)
        there, most = self.clusters.exchange.there(here), 0
        laws, given, found = address(self._laws), address(there), address(self._found)
        answers: Answers | None = None
        to: tuple[int | None, ...] = (0, 0, None, None)
        if self._friction is not None:
            answers = self._friction.empty()
            to = len(here), int(self._friction.is_coupled), *map(address, answers)
        for batch in self._batches:
            done = loops.fracflow_joints(*batch.given, share, laws, given, self.most, MOST_CHANGES, found, *to)
            most = max(most, done) if done >= 0 and most >= 0 else -1
        return self._trial(before.history, self.clusters.exchange.back(self._found), most, answers)

    def _take(self, before: Sections, free: Floats) -> None:
        loops, here = library(), self._before
        assert loops is not None
        known = [free, before.strain, before.traction, before.tangent]
        if self._friction is not None:
            known += self._friction.past(before.history[0])
        else:
            for group, history in zip(self.joints.laws, before.history, strict=True):
                for column, name in ((10, "plastic_slip"), (11, "sliding"), (12, "slip_path")):
                    if name in history:
                        here[group.sections, column] = history[name].ravel()
        known = [np.ascontiguousarray(each, float) for each in known]
        given: list[int | None] = [*map(address, known), None, None, None]
        loops.fracflow_before(len(here), *given[:7], address(here))

    def _trial(self, history: SectionHistory, back: Floats, iterations: int, answers: Answers | None) -> Trial:
        loops, largest, strain = library(), np.zeros(2), np.empty((len(back), 2))
        assert loops is not None
        found, status = map(address, (self._before, back, strain, largest)), history
        if loops.fracflow_after(len(back), *found):
            status = tuple(
                {**start, "sliding": back[group.sections, 2:3]} if "sliding" in start else start
                for group, start in zip(self.joints.laws, history, strict=True)
            )
        answer = None
        if self._friction is not None and answers is not None and iterations >= 0:
            answer = self.joints.answered(strain, self._friction.response(answers))
        moved, worst = largest.tolist()
        return Trial(back[:, :2], status, iterations, strain, back[:, 3:5], back[:, 5:], moved, worst, answer)


def joint_guess(operators: Operators, clusters: Clusters, most: int) -> JointGuess | None:
    """The guess for a scene; None where loops are not compiled, or have no copy of its laws. Collective."""
    joints, comm = operators.joints, operators.layout.comm
    has_laws = joints.dim == 2 and all(number_of(group.law) is not None for group in joints.laws)
    is_small = all(each.sections.shape[1] <= MOST_MEMBERS for each in clusters.batches)
    lacks = comm.allreduce(int(library() is None or not has_laws or not is_small))
    return None if lacks else JointGuess(operators, clusters, most)


def rows_of_laws(joints: Joints) -> Floats:
    """Number of the law, weight and parameters (s, 13) of this rank's sections."""
    rows = np.zeros((len(joints.weights), 2 + len(PARAMETERS)))
    for group in joints.laws:
        rows[group.sections] = table(group.law, joints.weights[group.sections])
    return rows
