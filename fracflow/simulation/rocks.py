"""Both rocks of a run whose events are meshed: rock without a mesh, and the mesh that it has while an event lasts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fracflow._petsc import timed
from fracflow.advance.step import Step
from fracflow.errors import OtherRock
from fracflow.mesh.data import SplitMesh
from fracflow.mesh.store import load_mesh
from fracflow.model.setup import Model, on_root
from fracflow.output.drawing.axes import shown
from fracflow.output.remarks import RESULT
from fracflow.remarks import marked, note
from fracflow.scene.units import ENERGY, STRESS
from fracflow.simulation.files import EVENT_MESH
from fracflow.simulation.recorder import Recorder


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
        self.now = first
        if event_seal:
            assert meshed is not None or not is_meshed
            self.now = _own_prestress(meshed if is_meshed and meshed is not None else first)

    @timed("FracSetUp", "Set up")
    def change(self, recorder: Recorder, step: Step, needed: OtherRock) -> Step:
        """The first state in the other rock, which is ``now`` from then on. Raises InputError, SolveError. Collective."""
        from fracflow.advance.event_rock import handed_over  # few runs need them
        from fracflow.advance.regime import after_change_of_rock

        old, state, scene = self.now, step.state, self._unmeshed.scene
        recorder.save(step)  # Gmsh may fail
        is_event, is_made = old.scene.is_unbounded, self._meshed is not None
        what = (
            f"an event needs inertia: {needed.why}: the rock is meshed"
            if is_event
            else f"{needed.why}: no mesh is needed"
        )
        recorder.log(f"time {scene.time_text(state.time)}: {what}")
        new = _own_prestress(self._with_mesh(recorder) if is_event else self._unmeshed)
        found = handed_over(old, new, state)
        event = after_change_of_rock(needed.progress, new, found.state, scene.stage[step.stage])
        state.destroy()
        if old.operators.prestress is not self._unmeshed.operators.prestress:
            old.operators.prestress.destroy()
        self.now = new
        recorder.hand_over(new, found.state.time, needed.why, found.most)
        sizes, units = new.operators.blocks.sizes, scene.unit_names
        mean, most = (shown(STRESS, value, units, 3) for value in (found.mean, found.most))
        stored = found.state.energy["rock_strain"]
        share = abs(found.energy / stored) if stored else 0.0
        rock = f"meshed rock: {sizes.cells} cells, {sizes.nodes} nodes" if is_event else "rock without a mesh"
        recorder.log(
            note(
                f"{rock}; at the same jumps its stress on the fractures differs by {mean} in the mean, {most} at the most,"
                f" {RESULT}; its strain energy by {shown(ENERGY, found.energy, units, 3)}, {share:.2g} of it:"
                " energy/change_of_rock"
            )
        )
        for line in () if is_made else new.placed.notes:
            recorder.log(marked(line))
        return replace(step, state=found.state, progress=event.as_progress())

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
