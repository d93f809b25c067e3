"""The input of the plan, and the record of a decision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

from fracflow.diagnostics.number import Number
from fracflow.model.setup import FarSides
from fracflow.scene.scene import Scene
from fracflow.solve.rock_cost import RockChoice

TOLERANCE = 1e-2  # where a scene states none


def tolerance_of(scene: Scene) -> float:
    """``accuracy.tolerance`` of a scene, or that of all that state none."""
    return TOLERANCE if scene.accuracy.tolerance is None else scene.accuracy.tolerance


@dataclass(frozen=True)
class Decision:
    """Something left out, or kept: the criterion, the value found, and the limit that it is to stay below.

    error   what leaving it out may do to the results
    saves   what it saves; what would have been saved is no reason by itself
    stage   the stage that it is about, empty for the whole run
    undone  when it was taken back during the run, and by which value; empty while it stands
    asked   the scene has it; its number in the pre-run checks shows whether it should have a part that it lacks
    added   the run made it
    """

    part: str
    left_out: bool
    criterion: str
    value: float | str
    limit: float | str
    error: str
    saves: str = "nothing"
    stage: str = ""
    undone: str = ""
    asked: bool = True
    added: bool = False

    @property
    def verdict(self) -> str:
        """In a word or two."""
        if self.added:
            return "added"
        return "not in the scene" if not self.asked else "left out" if self.left_out else "kept"


@dataclass(frozen=True)
class LockedFractures:
    """The fractures that can neither slip, open nor conduct.

    names       of them; empty where the plan ties none
    share       of the jumps of all joints, theirs [1]
    jumps       components that they have
    compliance  E'/(k L), the largest of those named [1]
    use         of the strength under what the scene's loads may add, the largest of those named [1]
    stress      what that is, the most at one of those named [stress]
    why         none are tied, or why not more
    """

    names: tuple[str, ...] = ()
    share: float = 0.0
    jumps: int = 0
    compliance: float = 0.0
    use: float = 0.0
    stress: float = 0.0
    why: str = "not asked"


@dataclass(frozen=True)
class UnloadedBlocks:
    """The parts of the rock that hang together with no other, and how many of them something loads; unknowns of the rest."""

    count: int = 1
    loaded: int = 1
    unknowns: int = 0


@dataclass(frozen=True)
class ReductionInput:
    """A scene as it is stated, and values from its model.

    period      longest period in which it vibrates while its joints stick; infinite where that was not asked [time]
    unrest      what the first instant changes in the loads, over their scale [1]
    unknowns    of displacement, and ``pressures`` of pressure, on all ranks
    jumps       components of the jumps of all joint sections
    damps       terms have a C
    rock        how it is solved for
    card        numbers of the pre-run checks by their names; on rank 0 only
    locked      fractures that are tied, also where that was undone
    parts       parts of the rock, also where all of them are kept
    sides       whether the rock is run without its sides; None where that is not for the plan
    undone      what was taken back in an earlier try of the run: "part, stage" -> when and why
    """

    scene: Scene
    period: float = inf
    unrest: float = 0.0
    unknowns: int = 0
    pressures: int = 0
    jumps: int = 0
    ranks: int = 1
    damps: bool = False
    rock: RockChoice = field(default_factory=RockChoice)
    card: Mapping[str, Number] = field(default_factory=dict)
    locked: LockedFractures = LockedFractures()
    parts: UnloadedBlocks = UnloadedBlocks()
    sides: FarSides | None = None
    undone: Mapping[str, str] = field(default_factory=dict)

    def with_card(self, numbers: Sequence[Number]) -> ReductionInput:
        """The same with the pre-run checks."""
        return replace(self, card={number.name: number for number in numbers})

    @property
    def tolerance(self) -> float:
        """The error that what is left out may cause, relative to the largest value."""
        return tolerance_of(self.scene)

    @property
    def leaves_out(self) -> bool:
        """Whether the plan may leave anything out."""
        return self.scene.model == "default"
