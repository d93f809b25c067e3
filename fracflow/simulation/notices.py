"""Lines of the log on a step whose results may be wrong, or which another choice of the scene would make better."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracflow.advance.step import Step
from fracflow.model.energy import spurious_share
from fracflow.model.flow import is_transposed
from fracflow.model.setup import Model
from fracflow.scene.scene import Scene
from fracflow.simulation.suction import suction_line
from fracflow.simulation.totals import Totals

TOLD_AGAIN = 0.5  # relative change of the predicted contraction from which on it is reported again
TOLD_FROM = 0.1  # smaller factors are all the same

FOLD = 1.5
"""Largest growth of an aperture by inflow through it, in a step of backward Euler, d - d0 = c d^3. For c d0^2 > 4/27 only the
stiffness of the walls stops them, at a distant solution; for less there are both solutions."""
WIDENS = 2.0  # and again where an aperture grew by as much more
STRAINED = 0.1  # p/E: a tenth is no small strain
SPURIOUS = 1e-3  # share of the largest entry of the energy balance from which the log warns of the spurious one


def watches_spurious(scene: Scene) -> bool:
    """Whether pressure force and storage are not transposed, so that the energy balance has a spurious entry."""
    return scene.has_flow and not is_transposed(scene.method.storage)


class Notices:
    """Reports each step once: the totals keep the reported lines, also across a restart."""

    def __init__(self, model: Model, totals: Totals, log: Callable[[str], None]) -> None:
        """Before the first step."""
        self._model, self._scene, self._totals, self._log = model, model.scene, totals, log

    def of(self, step: Step) -> None:
        """Look at a step that was put on record. Collective."""
        self._spurious(step)
        self._pressure(step)
        self._widening(step)
        self._suction(step)
        self._coupling(step)

    def _coupling(self, step: Step) -> None:
        """A line where the contraction of the fixed point has changed, and where it first failed."""
        totals, report, scene = self._totals, step.report, self._scene
        stage = f"stage {scene.stage[step.stage].title}"
        if report.handed_over and not totals.handed_over:
            self._log(
                f"{stage}: {report.handed_over}; handed over to the monolithic solver, as are later steps like it"
            )
        totals.handed_over += bool(report.handed_over)
        told, factor = totals.told_factor, report.predicted
        if np.isnan(factor):
            return
        if np.isnan(told) or (max(factor, told) >= TOLD_FROM and not abs(factor - told) <= TOLD_AGAIN * told):
            totals.told_factor = factor
            time = f"time {step.state.time:.6g} {scene.unit_system.time}".rstrip()
            measured = (
                f"the last cycle, {scene.method.fixed_point}, by {report.measured:.3g} (measured)"
                if np.isfinite(report.measured)
                else "fewer than two cycles were made, so that none is measured"
            )
            self._log(
                f"{stage}, {time}: a plain cycle of the fixed point multiplies the error by {factor:.3g} (predicted);"
                f" {measured}"
            )

    def _spurious(self, step: Step) -> None:
        share, totals = spurious_share(step.state.energy), self._totals
        if share > totals.spurious:
            if totals.spurious <= SPURIOUS < share:
                self._log(
                    f'time {step.state.time:.6g}: spurious work of method.storage = "{self._scene.method.storage}" is'
                    f" {share:.1e} of the largest entry of the energy balance, above {SPURIOUS:g}: see energy/spurious;"
                    ' method.storage = "lumped" has none'
                )
            totals.spurious, totals.spurious_time = share, step.state.time

    def _pressure(self, step: Step) -> None:
        """A line, once, where a pressure would strain the rock by over ``STRAINED``: a rate through next to nothing."""
        stiff = [rock.youngs_modulus for rock in self._scene.rock.values() if rock.youngs_modulus is not None]
        drive, totals, wells = step.state.max_overpressure, self._totals, self._scene.well
        if totals.strained or not stiff or drive <= STRAINED * min(stiff):
            return
        totals.strained = 1
        rates = ", ".join(well.name for well in wells if well.flow_rate is not None)
        self._doubt(
            f"time {step.state.time:.6g}: a pressure of {drive:.3g} above that at rest strains rock of E = {min(stiff):.3g} by"
            f" over {STRAINED:g}, where neither strains nor joints are those of the model: later results are meaningless;"
            + (
                f" give a maximum_pressure to {rates}, or a minimum_hydraulic_aperture to fractures too narrow for its rate"
                if rates
                else " lower the pressures that wells and fractures prescribe"
            )
        )

    def _widening(self, step: Step) -> None:
        """A line where an aperture grew in a step by more than can be predicted, and again where by far more."""
        grown, totals = step.report.widening, self._totals
        if grown <= WIDENS * totals.widening:
            return
        totals.widening = grown
        self._doubt(
            f"time {step.state.time:.6g}: an aperture of {step.report.widest} grew {grown:.3g} times as wide in one step."
            f" Above {FOLD:g} such a step has two solutions and may be at the wrong one: take smaller time_steps until nothing"
            " changes, or give accuracy.tolerance"
        )

    def _suction(self, step: Step) -> None:
        """A line, once, where a pressure falls below zero: no fluid holds together there."""
        if self._totals.sucked or not (line := suction_line(self._model, step.state)):
            return
        self._totals.sucked = 1
        self._doubt(line)

    def _doubt(self, line: str) -> None:
        """A line of the log that the end of the run repeats."""
        self._log(line)
        self._totals.doubts.append(line)
