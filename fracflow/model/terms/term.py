"""A term of the balances: a boundary condition or a force on the rock, one object in a list that all consumers go through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats, Ints
from fracflow.scene.time_table import Around


@dataclass(frozen=True)
class MeanDamping:
    """D of an explicit step, which meets its mean velocity [force time/length per thickness].

    scale  (m,) squared frequency of each local cell with its damping, over that without, as a step's stability sees them
    ratio  damping of a cell's fastest vibration over the critical one, the largest of all cells
    note   words for the log
    doubt  a warning for it, if any
    """

    matrix: PETSc.Mat
    scale: Floats
    ratio: float
    note: str = ""
    doubt: str = ""

    def force(self, increment: PETSc.Vec, dt: float) -> PETSc.Vec:
        """D times the mean velocity of a step, in a new vector. Collective."""
        result = increment.duplicate()
        self.matrix.mult(increment, result)
        result.scale(1.0 / dt)
        return result


class Leaving(NamedTuple):
    """Fluid that leaves the network at the ends (j, 2) of this rank's joints.

    rate         [volume rate per thickness]
    by_pressure  its derivative by the pressure of the end
    by_aperture  its derivative by the aperture of the end
    """

    rate: Floats
    by_pressure: Floats
    by_aperture: Floats


class TermStep(NamedTuple):
    """A step as terms with a memory see it.

    memory  of each such term at the start of the step, or at the instant, by its name
    alphas  of the step's rule; None at an instant
    dt      its length [time]
    """

    memory: Mapping[str, Floats] = {}
    alphas: Alphas | None = None
    dt: float = 0.0


class Term:
    """A term of a balance; what a term does not say stays as it is here: nothing.

    name       of its force in ``Forces.of_terms``, and in checkpoints
    entry      of the energy balance that takes the work of its forces [energy per thickness]
    stiffness  K, which ``Operators.stiffness`` has in it [force/length per thickness]
    damping    C, which ``Operators.damping`` has in it; it acts where there is inertia [force time/length per thickness]
    stores     whether its entry is energy of the rock, which is another one where the rock changes
    drains     whether fluid leaves by it
    has_memory  whether the rate at which it leaves depends on the pressures so far
    """

    name: str
    entry: str
    stiffness: PETSc.Mat | None = None
    damping: PETSc.Mat | None = None
    stores: bool = False
    drains: bool = False
    has_memory: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines of the log."""
        return ()

    def held(self) -> tuple[Ints, Floats]:
        """Unknowns (n,) that it holds where there is no inertia, and their places (n, dim)."""
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))

    def incoming(self, time: float, around: Around, result: PETSc.Vec) -> float | None:
        """Add outer forces at the end of a step to ``result``; their power, None where it has none. Collective.

        Unlike loads they act with C alone, where there is inertia [energy/time per thickness].
        """
        return None

    def energy(self, taken: float, brought: float) -> Mapping[str, float]:
        """Entries that a step adds to the energy balance [energy per thickness].

        taken    work on the term: mean force of K, C and D, less incoming forces, times the motion
        brought  mean power of the incoming forces times the time step
        """
        return {self.entry: taken}

    def joints(self) -> Ints:
        """Numbers (k,) of this rank's joints whose pressure it settles, for what leaves depends on it."""
        return np.zeros(0, dtype=np.int64)

    def memory(self) -> Floats:
        """Its memory (j, 2, m) at the ends of this rank's joints at the start, if it has one."""
        return np.zeros((0, 2, 0))

    def memory_after(self, pressure: Floats, step: TermStep) -> Floats:
        """Its memory (j, 2, m) after a step to these pressures (j, 2); likewise."""
        return step.memory[self.name]

    def restored(self, saved: Floats, first: Floats) -> Floats:
        """Its memory (j, 2, m) from that (j, 2, k) in a checkpoint, whose stages may have had other times.

        first  (1, 2, k) that of the first joint of all
        """
        return saved

    def lost(self, memory: Floats, dt: float) -> float:
        """Fluid that left this rank's joints in the last step, by the memory (j, 2, m) after it [volume per thickness]."""
        return 0.0

    def leaving(self, pressure: Floats, aperture: Floats, step: TermStep) -> Leaving:
        """Fluid that leaves by it at pressures and apertures (j, 2) of the ends of this rank's joints [stress], [length]."""
        return Leaving(*(np.zeros(pressure.shape) for _ in range(3)))

    def mean_damping(self) -> MeanDamping | None:
        """Its contribution to an explicit step; made at the first call. Collective."""
        return None


def summed(matrices: list[PETSc.Mat]) -> PETSc.Mat | None:
    """The sum of matrices, None of none; of one, the matrix itself. Collective."""
    if len(matrices) < 2:
        return matrices[0] if matrices else None
    total = matrices[0].copy()
    for other in matrices[1:]:
        total.axpy(1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return total


def held_without_inertia(terms: Sequence[Term]) -> tuple[Ints, Floats]:
    """Unknowns (n,) that terms hold where there is no inertia, and their places (n, dim)."""
    numbers, places = zip(Term().held(), *(term.held() for term in terms), strict=True)
    return np.concatenate(numbers), np.concatenate(places)
