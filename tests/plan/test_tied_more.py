"""Tied fractures leave measured displacements alone; what the plan and a step look at before they tie, or let parts rest."""

import numpy as np
import pytest
from test_tied import PAIR, TWO, chosen, done, rock, scene_of  # noqa: F401  done is a fixture

from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.errors import ReductionInvalid
from fracflow.model.setup import place
from fracflow.reduction import ReductionInput
from fracflow.reduction import locked_fractures as tied
from fracflow.reduction.apply import planned
from fracflow.reduction.locked_fractures import PART, compliance, together
from fracflow.reduction.locked_mesh import find_locked, watch_locked
from fracflow.reduction.prepare import prepare, read_split
from fracflow.reduction.unloaded_blocks import idle_pieces
from fracflow.scene.scene import Scene, load

YOUNG, PRESS, APERTURE = 1e10, 1e6, 1e-2


def bar(contact, stiffness, probe):
    """100 m by 100 m on its foot, of nu = 0, that a contact right across parts; pressed from above, and in sections as 1-D."""
    return {
        "output": {"pictures": False, "checkpoint_every": 0},
        "geometry": {
            "domain": [[0, 0], [100, 0], [100, 100], [0, 100]], "size": 20, "size_at_fractures": 3,
            "fracture": [{"name": "contact", "points": [[0, contact], [100, contact]]}],
        },
        "rock": {"rock": {"youngs_modulus": YOUNG, "poissons_ratio": 0.0, "density": 2500}},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -5e6},
        "fracture": {
            "default": {
                "normal_stiffness": stiffness, "shear_stiffness": stiffness, "aperture": APERTURE, "friction_coefficient": 0.6,
            }
        },
        "support": [{"on": "south"}, {"on": ["west", "east"], "displacement": {"x": 0}}],
        "load": [{"on": "north", "traction": "initial-stress"}, {"on": "north", "traction": [0, [[0, 0], [1, -PRESS]]]}],
        "probe": [{"name": "here", "at": probe}],
        "stage": [{"kind": "quasi-static", "time_step": 1, "steps": 1}],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("contact", "length", "height", "is_tied"),
    [(4, 92, 6, False), (4, 92, 100, False), (50, 10, 53, False), (40, 10, 60, True)],
    ids=["probe near both", "contact near the foot", "probe near the contact", "far"],
)
def test_bar_moves_as_its_closed_form(done, comm, contact, length, height, is_tied):  # noqa: F811
    """Above the contact sigma (y/E + 1/k'), of E/k = 0.01 ``length``; k' = k + sigma/aperture as it closes (Bandis 1983)."""
    stiffness = YOUNG / (0.01 * length)
    data = bar(contact, stiffness, [50, height])
    found, scene = done(data), Scene.from_data(data)
    node = comm.bcast(place(scene, read_split(scene)).probes["here"].point[1] if comm.rank == 0 else None)
    sought = -PRESS * (node / YOUNG + 1.0 / (stiffness + PRESS / APERTURE))
    assert found.plan[PART]["left_out"] == is_tied and node > contact
    assert found.probes["probe/here/displacement"][-1, 1] == pytest.approx(sought, rel=1e-2 if is_tied else 1e-6)


@pytest.mark.serial
def test_lengths_are_no_more_than_those_to_probes_and_supports():
    """1e10/(1e12 L) of fractures of 10 m, two of which are near."""
    found = rock(held=np.array([50.0, 5.0, np.inf, 50.0]), probed=np.array([[200.0, 50, 4, 50], [200, 50, 30, 50]]))
    np.testing.assert_allclose(compliance(found, inertia=False), [1e-3, 2e-3, 2.5e-3, 1e-3])


@pytest.mark.serial
def test_fractures_add_up_at_a_probe_and_before_a_support():
    """0.02 m of rock and 10 m long: over 100 m 100 m of it, a layer of 4 m, and at probes 5 m and 50 m away."""
    found = rock(stiffness=np.full(4, 5e11), held=np.array([4.0, np.inf, np.inf, np.inf]), probed=np.full((1, 4), 5.0))
    found.probed[0, 3] = 50.0
    np.testing.assert_allclose(together(found)[0], 0.02 * 10.0 / np.array([400.0, 1e4, 1e4, 1e4]))
    np.testing.assert_allclose(together(found)[1], 0.02 * 10.0 / np.array([50.0, 50.0, 50.0, 5000.0]))
    assert chosen(found).names == ("a", "b", "d")  # 0.004 each, and 0.00004; with c 0.01204
    near = rock(stiffness=np.full(4, 5e11), probed=np.full((1, 4), 5.0))
    assert chosen(near).names == ("a", "b") and chosen(near).compliance == pytest.approx(8e-3)


CRACK = """
Point(9) = {10, 2, 0, 1}; Point(10) = {12, 2, 0, 1}; Line(9) = {9, 10}; Line{9} In Surface{2};
Physical Curve("crack") = {9};
"""
FLUID = """
[fluid]
viscosity = 1e-3
specific_weight = 9810
[fracture.default]
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = 1e-3
friction_coefficient = 0.6
"""
ACTIONS = {
    "nothing": "",
    "well": '[[well]]\nname = "in"\nat = {fracture = "crack", end = "start"}\npressure = 1e6\n',
    "pressure": "[fracture.crack]\npressure = 1e6\n",
    "wave": '[[absorbing]]\non = "other top"\nwave = {velocity = [[0, 0], [1, 1e-3]]}\n',
    "no wave": '[[absorbing]]\non = "other top"\n',
}


@pytest.mark.parametrize(
    ("action", "loaded"), [("nothing", 1), ("well", 2), ("pressure", 2), ("wave", 2), ("no wave", 1)], ids=[*ACTIONS]
)
def test_what_loads_a_part(shared_tmp, comm, action, loaded):
    """Of two parts one is pulled; the other has a crack, and whatever acts in it."""
    if comm.rank == 0:
        (shared_tmp / "two.geo").write_text(TWO + CRACK)
        (shared_tmp / "two.toml").write_text(PAIR.replace("FEET", '["foot", "other foot"]') + FLUID + ACTIONS[action])
    comm.barrier()
    model = prepare(load(shared_tmp / "two.toml"), comm)
    idle, parts = comm.bcast(idle_pieces(model) if comm.rank == 0 else None)
    assert (parts.count, parts.loaded, idle.any()) == (2, loaded, loaded < 2)


@pytest.mark.parametrize("shear", [-4e6, 4e6])
def test_loads_add_to_the_shear_that_there_is(comm, shear):
    """Loads of E' gamma = 0.25 MPa may shear by twice that and take as much off the 10 MPa: 4.5/(0.6 9.5) is used."""
    amount = 0.25e6 * (1 - 0.25**2) / 1e10
    scene = Scene.from_data(
        scene_of(
            amount,
            fault=False,
            initial_stress={"xx": -1e7, "yy": -1e7, "zz": -5e6, "xy": shear},
            probe=[{"name": "rock", "at": [50, 65]}],  # far from all seams
        )
    )
    shut = find_locked(prepare(scene, comm), ReductionInput(scene, unknowns=tied.LEAST))
    assert shut.stress == pytest.approx(0.5e6)
    assert shut.use == pytest.approx(4.5 / (0.6 * 9.5))


def test_checkpoints_of_earlier_versions_keep_what_they_undid(comm, monkeypatch):
    monkeypatch.setattr(tied, "LEAST", 0)
    model = prepare(Scene.from_data(scene_of(1e-4)), comm)
    whole, facts = planned(model, {"tied fractures": "time 5: why"})
    assert whole.operators is model.operators and facts.undone == {PART: "time 5: why"}
    assert planned(model)[0].operators is not model.operators


@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["below", "above"])
def test_rock_on_either_side_is_watched(comm, monkeypatch, side):
    """Sheared on one side of seams at y = 15 alone, and less than 40 m from it, by 0.95 of the strength over G."""
    monkeypatch.setattr(tied, "LEAST", 0)
    model = prepare(Scene.from_data(scene_of(1e-4)), comm)
    refuse_imbalance(model)
    model, _ = planned(model)
    state, block = equilibrium_state(model), model.operators.blocks.solid
    watch_locked(model, state)
    first, last = state.motion.displacement.getOwnershipRange()
    number, away = block.unknown[:, 0], side * (block.points[:, 1] - 15.0)
    here = (number >= first) & (number < last)
    state.motion.displacement.getArray()[number[here] - first] = 0.95 * 0.6e7 / 4e9 * np.clip(away[here], 0.0, 40.0)
    with pytest.raises(ReductionInvalid, match=r"0\.95 of the strength of seam[012]"):
        watch_locked(model, state)
    state.destroy()
