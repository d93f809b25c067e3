"""Limit points: a stage without inertia stops where slip goes on by itself, names it, or hands over to one with inertia."""

import numpy as np
import pytest
from nucleation import UNIFORM

from fracflow._petsc import MPI
from fracflow.advance.instability import UnstableStep
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.output.remarks import last_limit
from fracflow.reduction.prepare import prepare
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import of_stage, resume, run
from fracflow.solve.stability import Weakening, largest_share

from .test_slip_weakening import LAYER, PEAK, K

D_C = 0.3e-3  # strength falls by FALL, faster than layer and joint unload together, K, and slower than the joint alone
FALL = 0.5e6 / D_C
ONSET = PEAK / K / 4e-3
STEP = 0.07
UNSTABLE = (f"stage.0.time_step={STEP}", "fracture.seam.slip_weakening_distance=0.3 mm", "output.checkpoint_every=1")
HANDED = (
    *UNSTABLE,
    f"stage=[{{kind = 'quasi-static', time_step = {STEP}, end = 1}}, {{kind = 'dynamic', time_step = 5e-5, steps = 25}}]",
)


class Stop(Exception):
    """Out of a run, as a fault would."""


def scene_file(folder):
    file = folder / "scene.toml"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(LAYER, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return file


def history_of(folder):
    comm = MPI.COMM_WORLD
    return comm.bcast(read_history(folder / "history.h5") if comm.rank == 0 else None)


def test_a_layer_stops_where_its_strength_falls_faster_than_it_unloads(shared_tmp):
    """The onset in closed form, K pull = peak; 1.158 mu*/W with mu* = 5 GPa."""
    length = 1.158 * 5e9 / FALL
    said = rf"limit point: .* seam at \([\d., ]+\), slipping patch [\d.]+ m, nucleation length {length:.4g} m;.*dynamic"
    with pytest.raises(SolveError, match=said):
        run(load(scene_file(shared_tmp), UNSTABLE), shared_tmp / "out", MPI.COMM_WORLD)
    time = history_of(shared_tmp / "out")["time"][-1]
    assert time == pytest.approx(ONSET, abs=STEP / 64.0)
    with pytest.raises(SolveError, match=said):  # from the last good state, which is on disk
        resume(shared_tmp / "out", MPI.COMM_WORLD)


def test_a_dynamic_stage_goes_on_from_a_limit_point_and_so_does_a_resumed_run(shared_tmp):
    scene, count = load(scene_file(shared_tmp), HANDED), [0]

    def halfway(step):
        count[0] += 1
        if count[0] == 5:  # between the parts into which the limit point halves its step
            raise Stop

    totals = run(scene, shared_tmp / "whole", MPI.COMM_WORLD)
    with pytest.raises(Stop):
        run(scene, shared_tmp / "stopped", MPI.COMM_WORLD, progress=halfway)
    resume(shared_tmp / "stopped", MPI.COMM_WORLD)
    whole, stopped = (history_of(shared_tmp / name) for name in ("whole", "stopped"))
    assert whole["time"] == pytest.approx(stopped["time"], rel=1e-9)
    if MPI.COMM_WORLD.size == 1:  # on more, two runs of the same scene differ in their last bits
        same = (np.array_equal(whole[key], stopped[key], equal_nan=True) for key in {*whole} - {"step/factorisations"})
        assert all(same)
    # the trials of the step that ends at the limit point led to no row of the history
    assert (
        totals.counts["rejected"] > whole["step/rejected"].sum()
        and totals.counts["wasted"] > whole["step/wasted"].sum()
    )
    at_rest = whole["step/kind"] == 1
    assert 0.5 * STEP > np.diff(whole["time"][at_rest])[-1]
    assert whole["time"][at_rest][-1] == pytest.approx(ONSET, abs=STEP / 64.0)
    slip = whole["probe/middle/plastic_slip"]
    assert abs(slip[at_rest][-1]) < 1e-12 and slip[-1] > 0.1 * D_C


@pytest.mark.serial
def test_a_refused_step_gets_the_name_of_its_stage():
    stage = Stage(kind="steady", name="fill", time_step=1.0, steps=1)
    found = of_stage(stage, UnstableStep("time 1: slip", 7, None, None))
    assert isinstance(found, UnstableStep) and found.newton == 7 and str(found) == f"stage {stage.title}: time 1: slip"


def test_an_event_of_a_stage_auto_names_its_limit_point(shared_tmp):
    def until_it_moves(step):
        if step.regime == "dynamic":
            raise Stop

    settings = (
        *UNSTABLE,
        f"stage=[{{kind = 'auto', time_step = {STEP}, end = 1}}]",
        "fracture.seam.slip_weakening_distance=1 mm",
    )
    settings = (*settings, "fracture.seam.shear_stiffness=20 GPa/m", "rock.rock.youngs_modulus=1 GPa")
    with pytest.raises(Stop):
        run(load(scene_file(shared_tmp), settings), shared_tmp / "out", MPI.COMM_WORLD, progress=until_it_moves)
    if MPI.COMM_WORLD.rank == 0:
        log = (shared_tmp / "out/log.txt").read_text()
        assert "an event begins" in log and "limit point: fracture seam at" in log
        words, (x, y) = last_limit(log.splitlines())
        assert words.startswith(f"fracture seam at ({x:g}, {y:g}), slipping patch ") and y == 1.0 and 0.0 <= x <= 2.0


@pytest.mark.serial
def test_the_share_of_a_patch_in_wide_rock_is_that_of_uenishi_and_rice(monkeypatch):
    """.579 mu*/W of half-length under a load that is the same everywhere; it ends between two nodes."""
    half, size = 10.0, 0.5
    trace = {"name": "fault", "points": [[-12, 0], [12, 0]]}
    scene = Scene.from_data(
        {
            "geometry": {
                "domain": [-200, -200, 200, 200], "size": 40, "size_at_fractures": size, "growth": 0.1, "fracture": [trace],
            },
            "rock": {"rock": {"youngs_modulus": 60e9, "poissons_ratio": 0.25, "density": 2700.0}},
            "fracture": {"fault": {"law": "linear", "normal_stiffness": 1e14, "shear_stiffness": 1e14, "aperture": 1e-3}},
            "support": [{"on": ["south", "north", "east", "west"]}],
            "initial_stress": {"yy": -1e7},
            "stage": [{"kind": "quasi-static", "end": 1.0, "time_step": 0.5}],
        }
    )  # fmt: skip
    model = prepare(scene, MPI.COMM_SELF)
    joints, blocks = model.operators.joints, model.operators.blocks
    x = blocks.solid.points[blocks.joints.bottom][:, :, 0].ravel()
    slides = np.abs(x) < half - 0.5 * size
    weakening = Weakening(np.where(slides, 1.0, 0.0), np.where(slides, 1.0, 0.0), slides[:, None].astype(float))
    sections = joints.evaluate(np.zeros((len(x), 2)), joints.initial_history())
    share, mode, is_sharp = largest_share(model.operators, model.loads, sections, weakening)
    assert half - size < share * UNIFORM * 32e9 < half
    shape = 1.0 - (x[slides] / half) ** 2
    assert np.corrcoef(np.abs(mode[slides]), np.sqrt(shape))[0, 1] > 0.98
    monkeypatch.setattr("fracflow.solve.stability.MOST_VECTORS", 2)
    few = largest_share(model.operators, model.loads, sections, weakening)
    assert is_sharp and not few.is_sharp and few.value == pytest.approx(share, rel=0.3)
