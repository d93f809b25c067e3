"""Stability of slip-weakening patches: the largest ratio of weakening to the stiffness of the rock.

While sections slide, rock gives way by C = G K_0^-1 G' W, K_0 its stiffness with nothing but normal stiffness on them. Slip d
reduces their traction by B d, and the response of the rock is C B d: slip grows without bound where the largest eigenvalue of
C B reaches 1 (Uenishi and Rice 2003, where B is uniform and C that of an infinite body).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.errors import NotConverged, is_alone
from fracflow.mesh.data import Bools, Floats
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import SectionHistory, Sections
from fracflow.solve.options import solver_of
from fracflow.solve.period import sprung

MOST_VECTORS = 40
KNOWN = 1e-4  # of the eigenvalue: how well it is known
SOFT = 1e-10  # of the normal stiffness, on sections that slide: it holds a block that is otherwise loose


@dataclass(frozen=True)
class Weakening:
    """How the strength of this rank's sections falls with their slip.

    rate    (s,) B, of joint and its spring in series; 0 where it does not fall or nothing slides [stress/length]
    fall    (s,) the same of the strength alone [stress/length]
    way     (s, dim - 1) unit direction of the slip, 0 where nothing slides
    """

    rate: Floats
    fall: Floats
    way: Floats

    @property
    def counts(self) -> Bools:
        """Which sections (s,) weaken as they slide."""
        return self.rate > 0.0


def of_state(operators: Operators, sections: Sections, almost: float = 1.0) -> Weakening:
    """That of the sections which slide at a state, and of others that carry ``almost`` all of their strength."""
    way, shear = _sliding_way(operators, sections), sections.traction[:, :-1]
    size = np.linalg.norm(shear, axis=1)[:, None]
    starts = (sections.utilisation >= almost)[:, None] & ~way.any(axis=1, keepdims=True) & (size > 0.0)
    way = np.where(starts, shear / np.where(size > 0.0, size, 1.0), way)
    return _weakening(operators, sections, sections.history, way)


def of_step(operators: Operators, old: Sections, new: Sections) -> Weakening:
    """The largest possible in a step: each section that slid weakens as at its start or as at its end."""
    moved = (new.inelastic - old.inelastic)[:, :-1]
    size = np.linalg.norm(moved, axis=1)
    along = moved / np.where(size > 0.0, size, 1.0)[:, None]
    way = np.where((size > 0.0)[:, None], along, _sliding_way(operators, new))
    begins, ends = _weakening(operators, new, old.history, way), _weakening(operators, new, new.history, way)
    before = _weakening(operators, old, old.history, way)
    most = [np.max([getattr(each, name) for each in (before, begins, ends)], axis=0) for name in ("rate", "fall")]
    return Weakening(most[0], most[1], way)


def _sliding_way(operators: Operators, sections: Sections) -> Floats:
    way = np.zeros_like(sections.traction[:, :-1])
    for group, past in zip(operators.joints.laws, sections.history, strict=True):
        for name in group.law.status:
            way[group.sections] = past[name].reshape(len(group.sections), way.shape[1])
    size = np.linalg.norm(way, axis=1)[:, None]
    return np.asarray(way / np.where(size > 0.0, size, 1.0))


def _weakening(operators: Operators, sections: Sections, past: SectionHistory, way: Floats) -> Weakening:
    fall, steep = np.zeros(len(way)), np.zeros(len(way))
    for group, history in zip(operators.joints.laws, past, strict=True):
        here = group.sections
        fall[here] = group.law.softening(sections.traction[here], history)
        steep[here] = group.law.steepness(sections.traction[here], history)
    fall = np.where(way.any(axis=1), fall, 0.0)
    return Weakening(np.where(steep < 1.0, fall / np.maximum(1.0 - steep, 1e-12), np.inf), fall, way)


class Share(NamedTuple):
    """Ratio of weakening to the stiffness of the rock, the slip (s,) of its mode, and whether ``KNOWN`` is met."""

    value: float
    mode: Floats
    is_sharp: bool = True


def largest_share(operators: Operators, loads: Loads, sections: Sections, weakening: Weakening) -> Share:
    """The largest real eigenvalue of C B, by Arnoldi's method, and the slip (s,) of its mode, of largest size 1.

    Inf where a joint unloads no faster than its strength falls, or nothing holds the rock; pressures stay as they are.
    Collective.
    """
    comm, counts = operators.layout.comm, weakening.counts
    worst = comm.allreduce(float(weakening.rate.max(initial=0.0)), op=MPI.MAX)
    mode = counts.astype(float)
    if worst == 0.0 or not np.isfinite(worst):
        return Share(worst, mode)
    compliance = _Compliance(operators, loads, _sliding(sections, weakening), weakening)
    try:
        return _arnoldi(compliance)
    except NotConverged:
        return Share(np.inf, mode)
    finally:
        if not is_alone():
            compliance.destroy()


def _sliding(sections: Sections, weakening: Weakening) -> Floats:
    """Moduli (s, dim, dim) of joints that slide at the strength that they have, along their way."""
    way, slides = weakening.way, weakening.way.any(axis=1)
    across = np.eye(way.shape[1]) - way[:, :, None] * way[:, None, :]
    moduli = np.array(sections.tangent)
    kept = across @ moduli[:, :-1, :-1] @ across
    soft = SOFT * np.abs(moduli[:, -1, -1])[:, None, None] * (np.eye(way.shape[1]) - across)
    moduli[:, :-1, :-1] = np.where(slides[:, None, None], kept + soft, moduli[:, :-1, :-1])
    return moduli


class _Compliance:
    """B^1/2 C B^1/2 on slips (s,) of this rank, as products with factors of K_0."""

    def __init__(self, operators: Operators, loads: Loads, moduli: Floats, weakening: Weakening) -> None:
        """Factor K_0. Collective."""
        self.operators, self.joints, self.comm = operators, operators.joints, operators.layout.comm
        self.held = loads.standing().held
        self.root = np.sqrt(weakening.rate)
        self.way = weakening.way
        self.stiff = sprung(operators, moduli)
        rows = (self.stiff.getOwnershipRange()[0] + self.held).astype(PETSc.IntType)
        self.stiff.zeroRowsColumns(rows, 1.0)
        self.solver = solver_of(self.stiff, "stability_")
        self.force, self.shape = operators.layout.solid_vector(), operators.layout.solid_vector()

    def times(self, slip: Floats) -> Floats:
        """Raises NotConverged, on every rank, where K_0 is singular. Collective."""
        traction = np.zeros((len(slip), self.joints.dim))
        traction[:, :-1] = (self.root * slip)[:, None] * self.way
        self.force.set(0.0)
        self.joints.force(traction, self.force)
        self.force.getArray()[self.held] = 0.0
        self.solver.solve(self.force, self.shape)
        size = self.shape.norm()
        if self.solver.getConvergedReason() < 0 or not np.isfinite(size):
            raise NotConverged("nothing holds the rock beside the sliding sections")
        return np.asarray(self.root * np.einsum("si,si->s", self.joints.strain(self.shape)[:, :-1], self.way))

    def dot(self, one: Floats, other: Floats) -> float:
        """Over all sections. Collective."""
        return float(self.comm.allreduce(float(self.joints.weights @ (one * other)), op=MPI.SUM))

    def destroy(self) -> None:
        """Free matrix and factors. Collective."""
        destroy(self.solver, self.stiff, self.force, self.shape)


def _arnoldi(compliance: _Compliance) -> Share:
    """Largest real part of its eigenvalues, and the slip (s,) of the mode. Collective."""
    start = compliance.root.copy()
    basis = [start / np.sqrt(compliance.dot(start, start))]
    matrix = np.zeros((MOST_VECTORS + 1, MOST_VECTORS))
    share, shape, is_sharp = 0.0, np.ones(1), False
    for size in range(1, MOST_VECTORS + 1):
        vector = compliance.times(basis[-1])
        for _ in range(2):  # refined once
            for row, each in enumerate(basis):
                part = compliance.dot(each, vector)
                matrix[row, size - 1] += part
                vector = vector - part * each
        left = float(np.sqrt(max(compliance.dot(vector, vector), 0.0)))
        values, shapes = np.linalg.eig(matrix[:size, :size])
        best = int(np.argmax(values.real))
        share, shape = float(values[best].real), shapes[:, best].real
        is_sharp = left * abs(shapes[-1, best]) <= KNOWN * abs(share) or left <= 1e-14 * abs(share)
        if is_sharp:
            break
        matrix[size, size - 1] = left
        basis.append(vector / left)
    mode = np.sum([part * each for part, each in zip(shape, basis, strict=False)], axis=0)
    slip = mode * np.where(compliance.root > 0.0, 1.0 / np.where(compliance.root > 0.0, compliance.root, 1.0), 0.0)
    size_of = compliance.comm.allreduce(float(np.abs(slip).max(initial=0.0)), op=MPI.MAX)
    return Share(share, np.asarray(slip / max(size_of, 1e-300)), is_sharp)
