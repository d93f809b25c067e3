"""Both rocks of a run whose events are meshed: rock without a mesh, and the mesh that it has while an event lasts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fracflow._petsc import PETSc, timed
from fracflow.advance.step import Step
from fracflow.errors import OtherRock
from fracflow.mesh.agreement import on_root
from fracflow.mesh.data import SplitMesh
from fracflow.mesh.locate import RockPlace
from fracflow.mesh.store import load_mesh
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.output.drawing.axes import shown
from fracflow.output.remarks import FROZEN
from fracflow.remarks import marked, note, parted
from fracflow.scene.units import ENERGY, STRESS
from fracflow.simulation.files import EVENT_MESH
from fracflow.simulation.recorder import Recorder

if TYPE_CHECKING:
    from fracflow.advance.event_rock import Handed, Unslipped


class Rocks:
    """The models of both rocks, with nothing frozen in them; ``now`` is that of the rock that the run is in.

    A run whose scene has a mesh, or needs none, stays in its first model. Both are kept once an event was meshed: the next
    one need not set up its mesh anew.
    """

    def __init__(
        self, first: Model, meshed: Model | None = None, event_seal: str = "", is_meshed: bool = False
    ) -> None:
        """Of a run that begins in its first model, or goes on in one of both.

        meshed      of the mesh of events, where that is set up already
        event_seal  of that mesh, where an earlier event has left it in the run folder
        """
        self._unmeshed, self._meshed, self._event_seal = first, meshed, event_seal
        # is meshed -> forces of the initial stress, as the run last left that rock
        self._left: dict[bool, PETSc.Vec] = {}
        self._unslipped: Unslipped | None = None
        self.now = first
        if event_seal:
            assert meshed is not None or not is_meshed
            self.now = _own_prestress(meshed if is_meshed and meshed is not None else first)

    @timed("FracSetUp", "Set up")
    def change(self, recorder: Recorder, step: Step, needed: OtherRock) -> Step:
        """The first state in the other rock, which is ``now`` from then on. Raises InputError, SolveError. Collective."""
        from fracflow.advance.event_rock import Unslipped, handed_over  # few runs need them
        from fracflow.advance.regime import after_change_of_rock

        old, state, scene = self.now, step.state, self._unmeshed.scene
        is_event, is_made = old.scene.is_unbounded, self._meshed is not None
        if not is_event:
            recorder.keep_fields(step)
        recorder.save(step)  # Gmsh may fail
        what = (
            f"an event needs inertia: {needed.why}: the rock is meshed"
            if is_event
            else f"{needed.why}: no mesh is needed"
        )
        recorder.log(f"time {scene.time_text(state.time)}: {what}")
        new = _own_prestress(self._with_mesh(recorder) if is_event else self._unmeshed)
        found = handed_over(old, new, state)
        event = after_change_of_rock(needed.progress, new, found.state, scene.stage[step.stage])
        lines = self._differences(new, found, is_event)
        self._unslipped = Unslipped.of(state) if is_event else None
        self._leave(old.operators, not is_event)
        state.destroy()
        self.now = new
        recorder.hand_over(new, found.state.time, needed.why, found.most)
        for line in lines:
            recorder.log(marked(line))
        recorder.totals.doubts += parted(lines)[0]
        inside = [name for name, place in new.placed.probes.items() if isinstance(place, RockPlace)]
        if inside:
            sides = (
                "displacements are those within the box of its mesh" if is_event else "the rock has no sides any more"
            )
            recorder.log(note(f"values of probes in the rock jump here ({', '.join(inside)}): {sides}"))
        for line in () if is_made else new.placed.notes:
            recorder.log(marked(line))
        return replace(step, state=found.state, progress=event.as_progress())

    def _leave(self, ops: Operators, is_meshed: bool) -> None:
        """Keep the forces of the initial stress, with what is frozen, of the rock that is left. Collective."""
        if is_meshed in self._left:
            self._left.pop(is_meshed).destroy()
        self._left[is_meshed] = ops.prestress.copy()
        if ops.prestress is not self._unmeshed.operators.prestress:
            ops.prestress.destroy()

    def _differences(self, new: Model, found: Handed, is_event: bool) -> list[str]:
        """Lines on the stress that is frozen in a new rock, which its first state has, and the strain energy. Collective."""
        from fracflow.advance.event_rock import as_traction, frozen_since
        from fracflow.reduction.event_mesh import stress_left_frozen

        ops, scene, sizes = new.operators, new.scene, new.operators.blocks.sizes
        units, stored = scene.unit_names, found.state.energy["rock_strain"]
        rock = f"meshed rock: {sizes.cells} cells, {sizes.nodes} nodes" if is_event else "rock without a mesh"
        untouched = self._meshed if is_event and self._meshed else self._unmeshed
        frozen = frozen_since(ops, self._left.get(is_event) or untouched.operators.prestress)
        by_this, in_all = (
            f"{shown(STRESS, mean, units, 3)} in the mean, {shown(STRESS, most, units, 3)} at the most"
            for mean, most in (as_traction(ops, frozen), (found.mean, found.most))
        )
        so_far = "" if in_all == by_this else f"; with what was frozen before {in_all}"
        energy, share = shown(ENERGY, found.energy, units, 3), abs(found.energy / stored) if stored else 0.0
        lines = [
            note(
                f"{rock}; at the same jumps its stress on the fractures differs by {by_this},"
                f" {FROZEN}{so_far}; its strain energy by {energy}, {share:.2g} of it: energy/change_of_rock"
            )
        ]
        if not is_event and self._unslipped is None:
            lines.append(note("the run was resumed amid this event: that stress is not compared with its stress drop"))
        elif self._unslipped is not None:
            part = self._unslipped.share(ops, found.state, frozen)
            lines.append(stress_left_frozen(scene, scene.time_text(found.state.time), part))
        frozen.destroy()
        return lines

    def _with_mesh(self, recorder: Recorder) -> Model:
        """The model on the mesh of events, which the first one makes. Raises InputError. Collective."""
        from fracflow.reduction.event_mesh import with_event_mesh  # few runs need it

        if self._meshed is None:
            comm, files = recorder.comm, recorder.files

            def saved() -> SplitMesh | None:
                return load_mesh(Path(files.folder.path) / EVENT_MESH, self._event_seal) if files else None

            mesh = on_root(comm, saved) if self._event_seal else None
            self._meshed = with_event_mesh(self._unmeshed, comm, mesh)
        return self._meshed


def _own_prestress(model: Model) -> Model:
    """The model with forces of the initial stress of its own, which may take up what is frozen. Collective."""
    ops = model.operators
    return replace(model, operators=replace(ops, prestress=ops.prestress.copy()))
