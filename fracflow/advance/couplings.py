"""The couplings that solve the steps of a run, kept for the loads they were made with; and which steps they condense."""

from __future__ import annotations

import math
from dataclasses import replace

from fracflow._petsc import destroy
from fracflow.advance.outcome import Log
from fracflow.integrators import Stepper
from fracflow.model.loads import Loads
from fracflow.model.setup import Model
from fracflow.remarks import note
from fracflow.solve import COUPLINGS, Coupling, Multigrid
from fracflow.solve.condensed_cost import condensing, is_chosen, key_of, planned
from fracflow.solve.options import is_meant
from fracflow.solve.rock_cost import rock_choice

MOST_KEPT = 4  # solvers, with their factors, for different loads: wells go from one limit to the next, seldom back


class Couplings:
    """Makes the coupling of each set of loads when a step first needs it."""

    def __init__(self, model: Model, log: Log) -> None:
        """Plan which steps are condensed; where any are, the first coupling that is made writes to the log. Collective."""
        self.model, self.log, self._is_logged = model, log, False
        operators = model.operators
        self._unknowns = int(operators.layout.solid_starts[-1])
        self._jumps = operators.layout.comm.allreduce(len(operators.joints.weights)) * operators.joints.dim
        self._damps = operators.damping is not None
        self._rock = rock_choice(model.scene, operators.layout.comm, self._unknowns)
        ranks = operators.layout.comm.size
        self._planned = condensing(model.scene, self._unknowns, self._jumps, ranks, self._damps)
        self._kept: dict[Loads, Coupling] = {}  # the one used last comes last

    def expect(self, stepper: Stepper, dt: float) -> None:
        """Prepare for steps by a rule of inertia, whose number in events is unknown. Collective."""
        key = key_of(stepper.alphas(dt), self._damps)
        self._planned = replace(self._planned, steps={**self._planned.steps, key: math.inf})
        for coupling in self._kept.values():
            coupling.expect(self._planned)

    def of(self, loads: Loads) -> Coupling:
        """The coupling for a set of loads. Collective."""
        coupling = self._kept.pop(loads, None)
        if coupling is None:
            if len(self._kept) == MOST_KEPT:
                self._kept.pop(next(iter(self._kept))).destroy()
            name = self._way()
            kind: type[Coupling] = Multigrid if name == "multigrid" else COUPLINGS[name]
            coupling = kind(self.model.scene, self.model.operators, loads)
            coupling.expect(self._planned)
            if name == "condensed" and not self._is_logged:
                self.log(self._as_line())
                self._is_logged = True
        self._kept[loads] = coupling
        return coupling

    def forget_closures(self) -> None:
        """Free solvers for network components that exist no longer. Collective."""
        for loads in [each for each in self._kept if each.is_closed]:
            self._kept.pop(loads).destroy()

    def _way(self) -> str:
        """Name of the coupling: the scene's, or the one that takes less time."""
        scene, name = self.model.scene, self.model.scene.method.coupling
        if is_chosen(scene, self._planned, self._rock):
            return "condensed"
        if name in ("auto", "monolithic") and self._rock.by_multigrid:
            return "multigrid"
        if self.model.operators.flow is None and name != "condensed":
            return "monolithic"
        return "monolithic" if name == "auto" and is_meant("monolithic") else name

    def _as_line(self) -> str:
        """Stages that are condensed, the numbers of unknowns, and the number of steps from which on condensing pays."""
        scene, plan = self.model.scene, self._planned
        is_asked = scene.method.coupling == "condensed"
        steps = [each for each in planned(scene) if is_asked or plan.is_worth(key_of(each[1], self._damps))]
        stages = [s.title + (f" ({count:.0f} steps)" if count < math.inf else "") for s, _, count in steps]
        pays = "never pays, but is asked for"
        pays = f"pays from {plan.pays:.0f} steps of one length on" if plan.pays < math.inf else pays
        return note(
            f"rock condensed to its joints, {self._unknowns} displacements to {self._jumps} jumps, which {pays}:"
            f" {'stage ' + ', '.join(stages) if stages else 'no stage has so many'}"
        )

    def destroy(self) -> None:
        """Free the solvers. Collective."""
        destroy(*self._kept.values())
