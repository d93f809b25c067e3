"""Limit points: where slip in a stage without inertia has no further equilibrium, and the message on it.

Strength that falls with slip lets a slipping patch grow at rest up to a length of its own; past it no state at rest is near.
A step that ends in a distant state at rest has jumped: it slips a large share of the length over which strength falls. Slip is
unstable somewhere within it. Such a step is refused and halved; the stage ends where no shorter step is allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.outcome import Advance, Outcome
from fracflow.diagnostics.joints import gather
from fracflow.diagnostics.slip import critical_length
from fracflow.errors import NotConverged, SolveError
from fracflow.mesh.agreement import on_root
from fracflow.model.properties import on_joints
from fracflow.model.setup import Model
from fracflow.model.state import Sections, State
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH
from fracflow.solve.request import StepRequest
from fracflow.solve.stability import Weakening, largest_share, of_state, of_step

RESOLVED = 0.1  # of the slip over which strength falls: in a shorter step it cannot have jumped
LIMITS = ((1.0, 0.7), (0.95, 1.0))
"""Least shares of a state without a near equilibrium: of the sliding patch, which grows by a joint; of one that also counts
the sections that almost slide."""
REMEDY = '; slip goes on with inertia: let a stage of kind = "dynamic" follow, or begin a new run with kind = "auto"'
MOST_HALVED = 40  # times: a step of a year is a millisecond then
SEEN = 1e-2  # of the largest slip of a mode: what is less is beside the patch


class UnstableStep(NotConverged):
    """A step without inertia reached a state that stable slip cannot reach; with the sections that slid."""

    def __init__(self, message: str, newton: int, sections: Sections, weakening: Weakening) -> None:
        """Keep the sections at the end of that step, and its Newton iterations."""
        super().__init__(message, newton)
        self.sections, self.weakening = sections, weakening


class LimitPoint(SolveError):
    """A stage without inertia has reached unstable slip. The state is the last one at rest."""

    @property
    def message(self) -> str:
        """The message without its remedy."""
        return str(self).removesuffix(REMEDY)


@dataclass(frozen=True)
class Patch:
    """The patch that slips as a limit point is reached.

    share     of weakening over the stiffness of the rock; unstable from 1 on
    is_sharp  whether all its printed digits are known
    fracture  its name
    place     of the most slip (dim,) [length]
    length    of what weakens as it slips, along that fracture [length]
    critical  the nucleation length beside; None where the rock is rigid [length]
    """

    share: float
    fracture: str
    place: tuple[float, ...]
    length: float
    critical: float | None
    is_sharp: bool = True

    def describe(self, scene: Scene) -> str:
        """Fracture, place and lengths, for messages."""
        unit = scene.unit_system.behind(LENGTH)
        spot = ", ".join(f"{value:.6g}" for value in self.place)
        beside = "rigid rock" if self.critical is None else f"nucleation length {self.critical:.4g}{unit}"
        return (
            f"fracture {self.fracture} at ({spot}), slipping patch {self.length:.4g}{unit}, {beside}; its strength falls"
            f"{'' if self.is_sharp else ' about'} {self.share:.3g} times as fast as rock unloads it"
            f"{', and faster once the next section slides' if self.share < 1.0 else ''}"
        )


def refuse_unstable_slip(model: Model, old: State, new: State, newton: int) -> None:
    """Free ``new`` and raise UnstableStep, on every rank, where slip may not have come to it from ``old`` at rest. Collective.

    ``newton`` is the number of iterations that led there
    """
    slipped = weakened(model, old.sections, new.sections)
    if slipped <= RESOLVED:
        return
    weakening = of_step(model.operators, old.sections, new.sections)
    share, _, is_sharp = largest_share(model.operators, model.loads, new.sections, weakening)
    if share >= 1.0:
        new.destroy()
        fast = f"{'' if is_sharp else 'about '}{share:.3g} times as fast as rock unloads"
        why = f"slip of {slipped:.3g} of the distance over which strength falls, {fast}"
        raise UnstableStep(f"time {new.time:.6g}: {why}", newton, new.sections, weakening)


def weakens(model: Model) -> bool:
    """Whether the strength of any fracture falls over a length of slip. Collective."""
    here = False
    for group in model.operators.joints.laws:
        length = group.law.slip_length(len(group.sections))
        here |= bool(np.any((length > 0.0) & np.isfinite(length)))
    return bool(model.operators.layout.comm.allreduce(here, op=MPI.LOR))


def weakened(model: Model, old: Sections, new: Sections) -> float:
    """Largest slip of a step over the weakening length of its law, of sections whose strength fell. Collective."""
    slipped = np.linalg.norm((new.inelastic - old.inelastic)[:, :-1], axis=1)
    most = 0.0
    for group, past in zip(model.operators.joints.laws, old.history, strict=True):
        here = group.sections
        falls = np.maximum(group.law.softening(old.traction[here], past), group.law.softening(new.traction[here], past))
        length = np.where(falls > 0.0, group.law.slip_length(len(here)), np.inf)
        most = max(most, float((slipped[here] / length).max(initial=0.0)))
    return float(model.operators.layout.comm.allreduce(most, op=MPI.MAX))


def patch_of(model: Model, sections: Sections, weakening: Weakening) -> Patch | None:
    """The patch nearest to instability; None where no strength falls with slip. Collective."""
    share, mode, is_sharp = largest_share(model.operators, model.loads, sections, weakening)
    if share == 0.0:
        return None
    blocks, joints = model.operators.blocks, model.operators.joints
    ends = blocks.solid.points[blocks.joints.bottom]
    places = on_joints(ends, joints.natural).reshape(-1, ends.shape[-1])
    owner = np.repeat(np.arange(len(blocks.joints.ids)), joints.points)
    size = np.abs(mode) * weakening.counts
    best = int(size.argmax()) if len(size) else -1
    mine: tuple[float, int, str, tuple[float, ...]] = (0.0, 0, "", ())
    if best >= 0 and size[best] > 0.0:
        joint = owner[best]
        name = blocks.joints.fractures[blocks.joints.fracture[joint]]
        mine = (float(size[best]), -int(blocks.joints.ids[joint]), name, tuple(map(float, places[best])))
    comm = blocks.comm
    _, number, fracture, place = max(comm.allgather(mine))
    names = np.array(blocks.joints.fractures, dtype=object)
    there = (size > SEEN) & (names[blocks.joints.fracture[owner]] == fracture) if len(size) else size > SEEN
    weights = joints.weights[there]
    length = comm.allreduce(float(weights.sum()), op=MPI.SUM)
    fall = comm.allreduce(float(weights @ weakening.fall[there]), op=MPI.SUM) / max(length, 1e-300)
    critical = on_root(comm, lambda: _critical(model, -number, fall))
    return Patch(share, fracture, place, length, comm.bcast(critical, root=0), is_sharp)


def _critical(model: Model, joint: int, fall: float) -> float | None:
    assert model.mesh is not None
    joints = gather(model.scene, model.mesh, model.placed.wells)
    length = critical_length(joints.mode_2_modulus[joint], joints.layer[joint], fall)
    return float(length) if np.isfinite(length) else None


def to_the_next(scene: Scene, number: int, step: float) -> int:
    """Times that a step is halved for a limit point to be known as well as the steps of a dynamic stage that follows.

    That stage begins with the last state at rest: from one long before the limit point nothing would slip in it.
    """
    after = scene.stage[number + 1] if number + 1 < len(scene.stage) else None
    if after is None or after.kind != "dynamic" or not after.time_step or step <= after.time_step:
        return 0
    return min(MOST_HALVED, math.ceil(math.log2(step / after.time_step)))


@dataclass(frozen=True)
class StableSlip:
    """Refuses steps without inertia in which slip goes on by itself; where strength falls over a length of slip.

    shortest  fraction of the step, above which a substep that fails is halved at small cost
    """

    inner: Advance
    model: Model
    shortest: float

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same. Raises UnstableStep, on every rank. Collective."""
        halves = request.end - request.begin > self.shortest or is_near(self.model, state)
        found = self.inner.advance(state, replace(request, expects_failure=halves))
        refuse_unstable_slip(self.model, state, found.state, found.report.newton)
        return found


@dataclass(frozen=True)
class UpToLimitPoint:
    """Distinguishes a limit point from other failures of a stage without inertia.

    halvings  of a step, at most
    """

    inner: Advance
    model: Model
    halvings: int

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same, or LimitPoint in the place of NotConverged is raised, on every rank. Collective."""
        try:
            return self.inner.advance(state, request)
        except NotConverged as failure:
            assert request.step is not None
            error = limit_point(self.model, state, failure, request.step.length * 0.5**self.halvings)
            if error is None:
                raise
            raise error from failure


def limit_point(model: Model, state: State, failure: NotConverged, least: float) -> LimitPoint | None:
    """The limit point that a failed step of ``least`` length after a state is taken for; None for another one. Collective."""
    cause = failure.__cause__ or failure
    patch = patch_at_limit(model, state)
    if patch is None and isinstance(cause, UnstableStep):
        patch = patch_of(model, cause.sections, cause.weakening)
    if patch is None:
        return None
    scene = model.scene
    return LimitPoint(
        f"time {state.time:.9g}: limit point: within {scene.time_text(least, 3)} slip goes on by itself,"
        f" and no state at rest is near: {patch.describe(scene)}{REMEDY}",
        failure.newton,
        failure.trials,
    )


def patch_at_limit(model: Model, state: State) -> Patch | None:
    """The patch that slips or almost slips, if it may have no equilibrium nearby. Collective."""
    for almost, least in LIMITS:
        patch = patch_of(model, state.sections, of_state(model.operators, state.sections, almost))
        if patch is not None and patch.share >= least:
            return patch
    return None


def is_near(model: Model, state: State) -> bool:
    """Whether there is such a patch, at lower cost. Collective."""
    ops, sections = model.operators, state.sections
    shares = (largest_share(ops, model.loads, sections, of_state(ops, sections, almost)).value for almost, _ in LIMITS)
    return any(share >= least for share, (_, least) in zip(shares, LIMITS, strict=True))
