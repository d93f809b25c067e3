"""The content of a checkpoint for every kind of scene: rigid rocks, ties, wells at limits, searches, every kind of stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import list_steps, read_history, read_step
from fracflow.output.checkpoint import read_notes
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

MESHES = Path(__file__).parents[2] / "meshes"
from physics.test_absorbing import STILL, STRESSED  # noqa: E402
from physics.test_along_fractures import RIGID  # noqa: E402
from physics.test_books import CRACK, DYNAMIC, QUASI  # noqa: E402
from physics.test_depth import HEAVY  # noqa: E402
from physics.test_explicit import RUPTURE  # noqa: E402
from physics.test_slip_weakening import LAYER  # noqa: E402
from physics.test_supports import PERIODIC  # noqa: E402
from physics.test_unbounded import NETWORK  # noqa: E402
from physics.test_wells import PUMPED  # noqa: E402

EVERY = "output.checkpoint_every=1"
SLIPPING = PERIODIC.replace("xx = -1e6", "xx = -1e6\nxy = 0.8e6").split("[[stage]]")[0]
STAGES = """
[[stage]]
kind = "equilibrate"
steps = 2
[[stage]]
kind = "dynamic"
time_step = 1e-5
steps = 6
"""
SHORT = ["stage.0.steps=2", "stage.1.steps=2"]
SPIKE = ["load.0.traction=[[[0, 0], [0.98, 0], [1, 2], [1.02, 0]], 0]", "fracture.default.law=linear", "stage.0.end=2"]
SPIKE += ["stage.0.time_step=1", "accuracy.tolerance=0.05"]
JUMP = ["well.in.pressure=[[0, 2e6], [1.3e-4, 2e6], [1.3e-4, 3e6]]", "accuracy.tolerance=0.2"]  # step 6 ends there
# scene, steps after which the run is stopped
CASES = {
    "rigid rocks": ("report_5_2", ["stage.0.end=1"], (4,)),
    "search and drop": ("report_5_3", ["stage.failure.steps=8"], (2, 5, 8)),
    "crossings": ("crossings", ["stage.1.steps=8"], (2, 8)),
    "stages": (CRACK + QUASI + DYNAMIC + QUASI, [], (3, 5, 8, 10, 12)),
    "bdf2": (CRACK + DYNAMIC + QUASI, ["method.flow_integrator=bdf2", "method.storage=averaging"], (5, 6, 8)),
    "generalised-alpha": (CRACK + QUASI + DYNAMIC, ["method.stepper=generalised-alpha"], (5, 6, 8)),
    "damped faults": (RUPTURE, ["method.stepper=explicit", "stage.0.end=0.024"], (2, 4)),
    "absorbing": (STRESSED + STILL + STILL, [], (1, 2, 9, 24)),
    "trapezoid": (CRACK + QUASI, ["method.flow_integrator=trapezoid", "method.storage=consistent-lumped"], (0, 1, 3)),
    "compressible": (
        CRACK + QUASI + DYNAMIC + QUASI,
        ["method.flow_integrator=bdf2", "fluid.compressibility=1e-8"],
        (1, 3, 5, 8, 10),
    ),
    "compressible trapezoid": (
        CRACK + QUASI,
        ["method.flow_integrator=trapezoid", "fluid.compressibility=1e-8"],
        (0, 1, 3),
    ),
    "ties": (SLIPPING + STAGES, ["support.1={on = 'north', displacement_gradient = [[0, 0], [0, 0]]}"], (2, 5)),
    "unbounded rock": (NETWORK, ["stage.0.steps=4"], (1, 3)),
    "multipoles": (NETWORK, ["stage.0.steps=4", "method.rock_solver=multipoles"], (1, 3)),
    "wells at limits": (PUMPED, [], (3, 5)),
    "stress with depth": (HEAVY, ["well.out.pressure='5 kPa'"], (1, 4)),
    "parts of a step": ("failures/closing_joint", ["accuracy.max_iterations=6"], (4, 7)),
    "tolerance": (CRACK + QUASI + DYNAMIC, ["method.flow_integrator=bdf2", "accuracy.tolerance=0.1", *SHORT], (4, 8)),
    "tolerance at a jump": (CRACK + QUASI, [*JUMP, "method.flow_integrator=bdf2", "stage.0.steps=2"], (5, 6, 7)),
    "tolerance at a spike": ("report_5_2", SPIKE, (3, 12)),
    "slip weakening": (LAYER, ["stage.0.time_step=0.1"], (6, 9, 12)),
    "explicit": (CRACK + DYNAMIC, ["method.stepper=explicit", "stage.0.time_step=6e-4"], (1, 4)),
    "auto": (
        "failures/two_modes",
        ["stage.push.end=430", "stage.push.dynamic_time_step=0.5", "stage.push.at_rest=0.1"],
        (12, 30),
    ),
    "rigid walls": (RIGID, ["fracture.slot.pressure=[[0, 0], [2, 1e4]]"], (1,)),
}


SIZES = (("energy/",), ("/displacement", "/slip", "/opening"), ("/pressure",), ("/shear_traction", "/normal_traction"))


def differences(one, other, ranks, natural=None):
    """Keys that differ: alone in any bit; on more ranks, where each run is partitioned anew, beyond round-off.

    natural  histories whose sizes count too: what has come to rest is zero to round-off of what it was
    """
    if ranks == 1:
        return [k for k in one if k != "step/factorisations" and not np.array_equal(one[k], other[k], equal_nan=True)]
    found = []
    for names in SIZES:
        tables = (other, natural or {})
        sized = [v for table in tables for k, v in table.items() if k.startswith(names) or k.endswith(names)]
        keys = [k for k in one if k.startswith(names) or k.endswith(names)]
        size = max((np.abs(values).max() for values in sized), default=0.0)
        found += [k for k in keys if not np.all(np.abs(one[k] - other[k]) <= 1e-9 * size)]
    return found


def last_fields(folder, family):
    """The last fields of a run, named as histories are."""
    _, point, cell = read_step(list_steps(folder, family)[-1][1])
    return {f"/{name}": values for name, values in {**point, **cell}.items()}


class Stop(Exception):
    """Out of a run, as a fault would."""


@pytest.mark.parametrize("case", CASES)
def test_a_run_cut_anywhere_ends_as_the_whole_one(case, shared_tmp):
    comm = MPI.COMM_WORLD
    text, overrides, cuts = CASES[case]
    file = MESHES / text / "scene.toml"
    if "\n" in text:
        file = shared_tmp / "scene.toml"
        if comm.rank == 0:
            file.write_text(text, encoding="utf-8")
        comm.barrier()
    scene = load(file, ["output.pictures=false", EVERY, *overrides])
    run(scene, shared_tmp / "whole", comm)
    for cut in cuts if comm.size == 1 else cuts[-1:]:
        folder, count = shared_tmp / f"cut{cut}", [0]

        def stop(step, at=cut, count=count):
            count[0] += 1
            if count[0] > at:  # the checkpoint of step ``at`` is written, the one of this step is not
                raise Stop

        with pytest.raises(Stop):
            run(scene, folder, comm, stop)
        comm.barrier()
        assert read_notes(folder / "checkpoint.h5")["totals"]["steps"] == cut + 1
        resume(folder, comm)
        if comm.rank == 0:
            one, other = read_history(folder / "history.h5"), read_history(shared_tmp / "whole" / "history.h5")
            assert "resumed after" in (folder / "log.txt").read_text()
            assert one.keys() == other.keys()
            assert not differences(one, other, comm.size), cut
            for family in ("rock", "fractures"):
                last = [last_fields(where, family) for where in (folder, shared_tmp / "whole")]
                assert not differences(*last, comm.size, other), cut
