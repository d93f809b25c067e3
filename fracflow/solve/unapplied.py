"""What of the prescribed has not arrived yet at the end of a part of a step."""

from __future__ import annotations

from dataclasses import dataclass

from fracflow._petsc import PETSc
from fracflow.mesh.data import Floats
from fracflow.model.loads import Loads
from fracflow.model.state import State
from fracflow.scene.time_table import JUST_AFTER


@dataclass(frozen=True)
class Lag:
    """What the prescribed displacements and pressures (an array a support, or well) still lack at the end of a step."""

    displacement: tuple[Floats, ...] = ()
    pressure: tuple[Floats, ...] = ()

    @staticmethod
    def of(loads: Loads, state: State, share: float, of_wells: bool, load: PETSc.Vec, source: PETSc.Vec) -> Lag:
        """A share of what ``state`` lacks, what jumps there included.

        Forces that lack, and rates ``of_wells``, go into ``load`` and ``source``.
        """
        for total, term, had, now in (
            (load, load.duplicate(), state.forces.load, loads.force),
            (source, source.duplicate(), state.forces.source, loads.source),
        ):
            now(state.time, state.controls, term, JUST_AFTER)
            if total is load or of_wells:
                total.axpy(share, had)
                total.axpy(-share, term)
            term.destroy()
        return Lag(*(
            tuple(share * (vector.getArray(readonly=True)[part.numbers] - part.value(state.time, JUST_AFTER)) for part in parts)
            for vector, parts in ((state.motion.displacement, loads.supports), (state.pressure, loads.pressures))
        ))  # fmt: skip
