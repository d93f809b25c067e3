"""The most that steps of powers of two would gain where cells differ: local_steps.py [SCENE...] [--set KEY=VALUE].

In steps of one length each cell takes part in each step. In local ones a node has the longest of the critical step times 1, 2,
4, ... that its cells allow, and a cell takes part in the steps of its quickest node. Prints the critical step, the steps that
cells would allow over it, and the evaluations of cells with one length over those with local ones. Cells are a share of an
explicit step, measured from the scene's start: joints, fluid and sides take the rest, which stands at the quickest cells. So
the gain of the whole is 1/(1 - share + share/gain). It is a bound: the way between lengths costs nothing in it, nor do
records. Exit code 1 where one of the whole is more than ``ASKED``.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping
from fracflow.errors import InputError
from fracflow.integrators import Explicit
from fracflow.model.mass import cell_rates
from fracflow.model.setup import Model
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.explicit import ExplicitModel
from fracflow.solve.request import StepRequest

MESHES = Path(__file__).parents[2] / "meshes"
SCENES = ("crossings", "three_fractures", "own_traces", "mapped_network", "ten_faults", "rupture", "injected_fault")
ASKED = 2.0
LONGEST = 8  # powers of two
SUBSTEPS = 50  # in a timed step


def gain(critical: np.ndarray, cells: np.ndarray, nodes: int, step: float) -> float:
    """Evaluations of cells with one length over those with local ones.

    critical  (m,) steps that each cell allows, ``cells`` (m, k) their nodes, -1 for none; ``step`` that of the whole [time]
    """
    allowed = critical * (step / critical.min())  # the whole allows more than its quickest cell by itself
    corners, used = np.maximum(cells, 0), cells >= 0
    least = np.full(nodes, np.inf)
    np.minimum.at(least, corners[used], np.broadcast_to(allowed[:, None], cells.shape)[used])
    level = np.clip(np.floor(np.log2(least / step * (1.0 + 1e-12))), 0, LONGEST)
    of_cell = np.where(used, level[corners], LONGEST).min(axis=1)
    return len(cells) / float((0.5**of_cell).sum())


def share_of_cells(model: Model, step: float) -> float:
    """CPU of the sweep through the rock over that of a whole explicit step [1]."""
    stepping, sweeps = Stepping(model), []
    state = stepping.enter(equilibrium_state(model), Explicit(), step)
    rock = stepping.explicit.leapfrog.run.rock
    sweep = rock.step

    def timed(kick: float, drift: float) -> None:
        began = process_time()
        sweep(kick, drift)
        sweeps.append(process_time() - began)

    rock.step = timed
    request = StepRequest(0.0, SUBSTEPS * step * (1.0 - 1e-9), state.controls, model.loads)
    for number in (1, 2):  # the first one sets up
        sweeps.clear()
        began = process_time()
        state = stepping.by(Explicit()).advance(state, replace(request, time=number * request.length)).state
        lasts = process_time() - began
    return sum(sweeps) / lasts


def main() -> int:
    """Print a row a scene; 1 where local steps would gain more than is asked for."""
    parser = argparse.ArgumentParser(prog="scripts/bench local_steps", description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=SCENES, help="folders in meshes/, or files")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE of the scenes")
    given, wins = parser.parse_args(), False
    print(f"{'':24} {'':>7} {'critical':>9} {'cells allow, over it':>26} {'gain of':>8} {'share of':>9} {'gain of':>8}")
    print(
        f"{'scene':24} {'cells':>7} {'step':>9} {'a tenth':>8} {'half':>8} {'all':>8} {'cells':>8} {'cells':>9} {'all':>8}"
    )
    for name in given.scenes:
        file = Path(name) if name.endswith(".toml") else MESHES / name / "scene.toml"
        try:
            model = prepare(
                load(file, ['method={stepper = "explicit"}', "output.pictures=false", *given.set]), MPI.COMM_SELF
            )
            explicit = ExplicitModel(model.scene, model.operators, model.loads)
        except InputError as error:
            print(f"{name:32} {str(error)[:90]}")
            continue
        step, blocks = explicit.critical, model.operators.blocks
        rates = cell_rates(blocks, model.scene)
        moves = rates > 0.0
        critical, cells = 2.0 / np.sqrt(rates[moves]), blocks.solid.cells[moves]
        found = gain(critical, cells, len(blocks.solid.points), step)
        shares = np.quantile(critical, [0.1, 0.5, 1.0]) / critical.min()
        share = share_of_cells(model, step)
        whole = 1.0 / (1.0 - share + share / found)
        wins |= whole > ASKED
        print(
            f"{name[-24:]:24} {len(cells):7d} {step:9.3g} {shares[0]:8.2f} {shares[1]:8.2f} {shares[2]:8.1f}"
            f" {found:8.2f} {share:9.2f} {whole:8.2f}"
        )
        explicit.destroy()
    return int(wins)


if __name__ == "__main__":
    sys.exit(main())
