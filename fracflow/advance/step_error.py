"""The error of a step, estimated from its two ends; and the vibration of the node where it is largest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.integrators import Stepper
from fracflow.mesh.data import Floats
from fracflow.model.operators import Operators
from fracflow.model.state import StageStart, State

LEAST = 1e-9  # of the length of a joint, or the volume of fractures: smaller motions need no accuracy


def step_error(
    operators: Operators, stepper: Stepper, dt: float, old: State, new: State, largest: float = 0.0
) -> float:
    """Largest local error of a node's displacement over a step, relative to the largest displacement of the run.

    dt       length of the step, or of the equal parts that it is taken in, whose errors add up [time]
    largest  that of earlier states [length]; by default that of the end of the step

    Both are lengths of nodal vectors, and depend on neither axes nor units. Collective.
    """
    moved = max(largest, largest_displacement(operators, new))
    return local_error(operators, stepper, dt, old, new) / max(moved, LEAST * operators.scales.length)


def local_error(operators: Operators, stepper: Stepper, dt: float, old: State, new: State) -> float:
    """Largest local error of a node's displacement over a step, or over one of its equal parts [length]. Collective."""
    here = float(_error_sizes(operators, stepper, dt, old, new).max(initial=0.0))
    return operators.layout.comm.allreduce(here, op=MPI.MAX)


def largest_displacement(operators: Operators, state: State, since: StageStart | None = None) -> float:
    """Largest displacement of any node [length], of the run or ``since`` a stage began. Collective."""
    moved = displacement_since(state, since)
    here = float(np.linalg.norm(_nodal(operators, moved), axis=1).max(initial=0.0))
    moved.destroy()
    return operators.layout.comm.allreduce(here, op=MPI.MAX)


def displacement_since(state: State, since: StageStart | None) -> PETSc.Vec:
    """Displacements of the solid unknowns, of the run or ``since`` a stage began, in a new vector [length]."""
    moved = state.motion.displacement.copy()
    if since is not None:
        moved.getArray()[:] -= since.displacement
    return moved


def _error_sizes(operators: Operators, stepper: Stepper, dt: float, old: State, new: State) -> Floats:
    """Lengths (n,) of the local errors of the displacements of this rank's own nodes. Collective."""
    wrong = new.motion.displacement.duplicate()
    wrong.setArray(stepper.local_error(dt, old.motion.values(), new.motion.values()))
    sizes: Floats = np.linalg.norm(_nodal(operators, wrong), axis=1)
    wrong.destroy()
    return sizes


def _nodal(operators: Operators, unknowns: PETSc.Vec) -> Floats:
    """Vectors (n, dim) at this rank's own nodes. Collective."""
    nodal = operators.nodal(unknowns)
    values: Floats = nodal.getArray().reshape(-1, operators.blocks.sizes.dim).copy()
    nodal.destroy()
    return values


@dataclass(frozen=True)
class Vibration:
    """Largest acceleration and jerk, over substeps in a row, of the node whose estimated error is the largest in each.

    parts  in a row that were so short that over ``MOST_PARTS`` were left; 0 where the last one was not
    place  of that node in the last part
    """

    parts: int = 0
    acceleration: float = 0.0
    jerk: float = 0.0
    place: str = ""

    def followed_by(self, other: Vibration) -> Vibration:
        """Both together, in a row."""
        most = max(self.acceleration, other.acceleration), max(self.jerk, other.jerk)
        return Vibration(self.parts + other.parts, *most, other.place)

    def as_progress(self) -> dict[str, float]:
        """The numbers that a checkpoint keeps of it."""
        kept = {"parts": float(self.parts), "acceleration": self.acceleration, "jerk": self.jerk}
        return {f"vibration_{name}": value for name, value in kept.items()}

    @classmethod
    def of(cls, progress: Mapping[str, float]) -> Vibration:
        """The one that a checkpoint stored."""
        kept = [progress.get(f"vibration_{name}", 0.0) for name in ("parts", "acceleration", "jerk")]
        return cls(int(kept[0]), kept[1], kept[2])


def vibration(operators: Operators, stepper: Stepper, dt: float, old: State, new: State) -> Vibration:
    """Motion of the node with the largest estimated error in a substep of length ``dt``. Collective."""
    sizes = _error_sizes(operators, stepper, dt, old, new)
    ends = [_nodal(operators, state.motion.acceleration) for state in (old, new)]
    mine: tuple[float, float, float, str] = (-1.0, 0.0, 0.0, "")
    if len(sizes):
        worst = int(sizes.argmax())
        before, after = (each[worst] for each in ends)
        largest = max(float(np.linalg.norm(before)), float(np.linalg.norm(after)))
        mine = (float(sizes[worst]), largest, float(np.linalg.norm(after - before)) / dt, _place(operators, worst))
    return Vibration(1, *max(operators.layout.comm.allgather(mine))[1:])


def swing_of(acceleration: float, jerk: float) -> tuple[float, float]:
    """Amplitude and period of y = A sin(w t), whose accelerations reach A w^2 and whose jerks A w^3 [length, time].

    Of several such motions the amplitude is no less than that of the one which rules the jerk.
    """
    if not (acceleration > 0.0 and jerk > 0.0):
        return math.inf, math.inf
    return acceleration**3 / jerk**2, 2.0 * math.pi * acceleration / jerk


def _place(operators: Operators, node: int) -> str:
    """Where one of this rank's own nodes is, and on which fracture."""
    joints = operators.blocks.joints
    faces = np.any(np.concatenate([joints.bottom, joints.top], axis=1) == node, axis=1)
    on = f"on {joints.fractures[joints.fracture[faces.argmax()]]} " if faces.any() else ""
    return f"{on}at ({', '.join(f'{x:.4g}' for x in operators.blocks.solid.points[node])})"
