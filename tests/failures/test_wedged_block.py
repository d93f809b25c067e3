"""F6d: statuses that cycle between sticking and sliding, f |K_nt| / K_tt > 1: each ends in an equilibrium, or is named."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.errors import SolveError
from fracflow.integrators import Steady
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene, load
from fracflow.scene.toml import read_toml
from fracflow.simulation.run import run
from fracflow.solve.request import StepRequest

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "wedged_block" / "scene.toml"
SPRING, BASE = (1.0, 0.05), 10.0  # k_n, k_s of the slope; k_n0 and k_s of the base
NORMAL = np.array([1.0, 2.0]) / np.sqrt(5.0)
STIFFNESS = np.sqrt(1.25) * (SPRING[0] * np.outer(NORMAL, NORMAL) + SPRING[1] * (np.eye(2) - np.outer(NORMAL, NORMAL)))
RATIO = STIFFNESS[0, 1] / STIFFNESS[0, 0]


def equilibria(force, friction):
    """Displacements (2,) of all equilibria of one contact: it sticks, slides to either side, or is open (d_0 infinite)."""
    found = {}
    stick = np.linalg.solve(STIFFNESS + BASE * np.eye(2), force)
    strength = friction * (1.0 - BASE * stick[1])
    if abs(BASE * stick[0]) <= strength and BASE * stick[1] <= 1.0:
        found["stick"] = stick
    for way in (-1.0, 1.0):  # f_s = way f (1 - k y)
        matrix = STIFFNESS + np.array([[0.0, -way * friction * BASE], [0.0, BASE]])
        slide = np.linalg.solve(matrix, force - [way * friction, 0.0])
        if way * BASE * slide[0] >= friction * (1.0 - BASE * slide[1]) and BASE * slide[1] <= 1.0:
            found[f"slide {way:+.0f}"] = slide
    loose = np.linalg.solve(STIFFNESS, force - [0.0, 1.0])
    if BASE * loose[1] > 1.0:
        found["open"] = loose
    return found


def test_the_scene_has_one_equilibrium_and_it_is_open():
    assert RATIO == pytest.approx(1.583, abs=1e-3) and list(equilibria(np.array([-1.3, 0.0]), 1.0)) == ["open"]


@pytest.mark.parametrize("search", ["energy", "residual"])
def test_the_search_goes_on_to_where_it_lifts_off(search, shared_tmp):
    comm = MPI.COMM_WORLD
    scene = load(SCENE, ["output.pictures=false", "accuracy.max_halvings=0", f"method.line_search={search}"])
    run(scene, shared_tmp / "run", comm)
    history = comm.bcast(read_history(shared_tmp / "run" / "history.h5") if comm.rank == 0 else None)
    right = equilibria(np.array([-1.3, 0.0]), 1.0)["open"]
    assert history["probe/base/slip"][-1] == pytest.approx(right[0], rel=1e-9)
    assert history["probe/base/opening"][-1] == pytest.approx(right[1], rel=1e-9)
    assert history["step/open"][-1] == 2 and history["step/newton"][-1] <= 10


@pytest.mark.parametrize("overshoot", ["hold", "one-change"])
def test_without_a_search_the_sections_are_named(overshoot, shared_tmp):
    settings = ["accuracy.max_halvings=0", "method.line_search=none", f"method.overshoot={overshoot}"]
    expected = (
        r"2 sections keep changing between sticking and sliding: base at \(0, 0\), base at \(1, 0\); .*\"dynamic\""
    )
    with pytest.raises(SolveError, match=expected):
        run(load(SCENE, ["output.pictures=false", *settings]), shared_tmp / "run", MPI.COMM_WORLD)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("ratio", "search", "most"),
    [(0.5, "none", 0), (1.5, "none", 15), (1.5, "energy", 0), (3.0, "energy", 0)],
)
def test_seeded_loads_end_in_an_equilibrium_or_are_named(ratio, search, most):
    """40 loads each; where f |K_nt| / K_tt > 1 some have several equilibria, and some circles unless they are searched."""
    data = read_toml(SCENE)
    data["fracture"]["base"] |= {"friction_coefficient": (friction := ratio / RATIO), "aperture": 1e9}
    data["load"][1] = {"on": "block", "force": [1, 0], "control": "x"}
    data["load"].append({"on": "block", "force": [0, 1], "control": "y"})
    data |= {"control": {"x": {}, "y": {}}, "method": {"line_search": search}}
    model = prepare(Scene.from_data(data, SCENE), MPI.COMM_SELF)
    refuse_imbalance(model)
    stepping, state, named = Stepping(model), equilibrium_state(model), 0
    joints = model.operators.blocks.joints
    base = np.repeat(joints.fracture == joints.fractures.index("base"), 2)
    for force in np.random.default_rng(1).normal(size=(40, 2)) * [2.0 * friction, 0.5]:
        known = equilibria(force, friction)
        try:
            new, _ = stepping.step(
                state, StepRequest(1.0, 1.0, {"x": force[0], "y": force[1]}, stepping.model.loads), Steady()
            )
        except SolveError as error:
            assert "2 sections keep changing between sticking and sliding: base at (0, 0)" in str(error)
            named += 1
            continue
        found = new.sections.strain[base]
        assert any(np.abs(found - each).max() <= 1e-6 * np.abs(each).max() for each in known.values()), (force, found)
        new.destroy()
    stepping.destroy()
    assert named <= most and bool(named) == bool(most)
