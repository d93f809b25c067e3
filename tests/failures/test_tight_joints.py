"""Tight joints under jumps of pressure: a front wets them, they lift off and close again. 500 of them: scripts/benches."""

import numpy as np
import pytest
import random_tight

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

SCENE = {
    "rock": {"shale": {"youngs_modulus": 6.1e9, "poissons_ratio": 0.33, "density": 2450}},
    "initial_stress": {"xx": -5.3e6, "yy": -7.0e6, "zz": -6.0e6},
    "fluid": {"viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": 0.5e6, "compressibility": 4.4e-10},
    "geometry": {
        "domain": [-5, -5, 5, 5],
        "size": 2.5,
        "size_at_fractures": 0.5,
        "fracture": [{"name": "fault", "points": [[-2.3, -5], [2.3, 5]]}],
    },
    "fracture": {
        "fault": {
            "normal_stiffness": 20e9,
            "shear_stiffness": 20e9,
            "aperture": 10e-6,
            "friction_coefficient": 0.84,
        }
    },
    "support": [
        {"on": ["west", "east"], "components": ["x"]},
        {"on": ["south", "north"], "components": ["y"]},
    ],
    "well": [
        {
            "name": "injection",
            "at": {"fracture": "fault", "end": "start"},
            "pressure": [
                [0, 0.5e6],
                [0.01, 1.9e6],
                [9, 1.9e6],
                [9.01, 6.3e6],
                [15, 6.3e6],
                [15.01, 3.4e6],
                [24, 3.4e6],
            ],
        },
        {"name": "outlet", "at": {"fracture": "fault", "end": "end"}, "pressure": "initial"},
    ],
    "probe": [{"name": "injection", "at": {"fracture": "fault", "end": "start"}}],
    "stage": [{"kind": "quasi-static", "time_step": 3, "steps": 8}],
    "output": {"pictures": False},
}


@pytest.mark.filterwarnings("error")
def test_jumps_of_a_megapascal_need_no_halving(shared_tmp):
    """k_n0 d_0 = 0.2 MPa under 5.1 MPa: a front at 1.9 MPa, lift-off at 6.3 MPa with shear on the fault, and back."""
    trials = []
    run(Scene.from_data(SCENE, shared_tmp / "scene.toml"), shared_tmp / "run", MPI.COMM_WORLD, trials.append)
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    assert len(found["time"]) == 9 and not found["step/rejected"].any()
    assert (
        found["step/newton"].sum() <= 120
    )  # 97 on one rank, 105 on two; held to the end they were 134, besides a rejected trial
    assert np.diff(found["probe/injection/opening"])[0] > 1e-5 and found["probe/injection/normal_traction"].max() == 0.0
    assert found["probe/injection/normal_traction"][-1] < -1e5
    assert not any(np.isinf(step.state.sections.traction).any() for step in trials)
    largest = max(np.abs(values).max() for name, values in found.items() if name.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest


def test_a_front_does_not_close_the_springs_that_it_opens(shared_tmp):
    """Springs close without end, so that no bound of the law stops an iteration that shuts the film before the front."""
    springs = {"normal_stiffness": 20e9, "shear_stiffness": 20e9, "aperture": 10e-6, "law": "linear"}
    scene = Scene.from_data(SCENE | {"fracture": {"fault": springs}}, shared_tmp / "scene.toml")
    run(scene, shared_tmp / "run", MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    assert len(found["time"]) == 9 and not found["step/rejected"].any()
    assert found["step/newton"].max() <= 25


def test_springs_that_overlap_do_not_keep_a_front_from_others(shared_tmp):
    """A side that moves in by 4 mm closes a drained seam by more than its aperture, while a front opens the fault."""
    fault = {"normal_stiffness": 20e9, "shear_stiffness": 20e9, "aperture": 10e-6, "law": "linear"}
    traces = [*SCENE["geometry"]["fracture"], {"name": "seam", "points": [[2.0, -3.0], [4.5, 2.5]]}]
    ends = (
        {"name": end, "at": {"fracture": "seam", "end": end}, "pressure": [[0, 5e5], [1, 0]]}
        for end in ("start", "end")
    )
    scene = SCENE | {
        "geometry": SCENE["geometry"] | {"fracture": traces},
        "fracture": {"fault": fault, "seam": fault | {"normal_stiffness": 5e9}},
        "support": [
            {"on": "west", "components": ["x"], "displacement": {"x": [[0, 0], [3, 0.004], [24, 0.004]]}},
            {"on": "east", "components": ["x"]},
            {"on": ["south", "north"], "components": ["y"]},
        ],
        "well": [*SCENE["well"], *ends],
    }
    done = run(Scene.from_data(scene, shared_tmp / "scene.toml"), shared_tmp / "run", MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    assert any("more than their aperture" in line for line in done.doubts)
    assert len(found["time"]) == 9 and not found["step/rejected"].any()
    assert (
        found["step/newton"].sum() <= 120
    )  # 97 on one rank, 105 on two; held to the end they were 134, besides a rejected trial


@pytest.mark.serial
def test_random_tight_joints_end_right(tmp_path):
    """One that lifts off, crossings whose walls part seventyfold in a step."""
    for seed in (2, 3, 18):
        end = random_tight.end_of(seed, tmp_path / str(seed))
        assert end.what == "right" and end.halved == 0, end


@pytest.mark.serial
def test_wide_fractures_behind_tight_ones_keep_their_books(tmp_path):
    """A rate parts joints of 3 um by centimetres: pressures differ by their round-off, tight ends have tiny rows."""
    for seed in (65, 85, 105):
        end = random_tight.end_of(seed, tmp_path / str(seed))
        assert end.what == "right" and end.halved <= 1, end


@pytest.mark.serial
def test_a_front_that_crosses_in_a_hundredth_of_a_step_is_followed(tmp_path):
    """Crossing fractures lift off together, within a ramp of a thousandth of the step: six halvings are too few."""
    end = random_tight.end_of(59, tmp_path)
    assert end.what == "right" and 6 < end.halved <= 10, end


def test_the_scenes_are_the_same_again_and_span_four_decades():
    closures, lifts = np.array([random_tight.scene(seed)[1:] for seed in range(200)]).T
    assert random_tight.scene(7) == random_tight.scene(7)
    assert closures.min() < 2e-3 and closures.max() > 8.0 and lifts.min() < 0.6 and lifts.max() > 1.2
