"""Terms whose laws stand outside the package, by one file and one line each: springs under a side, leak-off from fractures."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import winkler
from _launch import without_ranks

from fracflow.output import read_history
from fracflow.output.checkpoint import read_notes

pytestmark = pytest.mark.serial
PROGRAM = Path(__file__).with_name("laws_outside.py")
BLOCK = """
units = "none"
output.pictures = false
[rock.rock]
youngs_modulus = 50
poissons_ratio = 0
density = 2
{rigid}
[geometry]
domain = [0, 0, 4, 2]
size = 0.7
{fracture}
[[spring]]
on = "south"
normal_stiffness = 5
shear_stiffness = {shear}
[[load]]
on = "north"
traction = [{along}, -0.5]
[[probe]]
name = "top"
at = [4, 2]
[[stage]]
kind = "{kind}"
time_step = {step}
steps = 20
"""
CRACK = """
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 1]]
[fracture.crack]
law = "linear"
normal_stiffness = 10
shear_stiffness = 10
"""
X = np.array([0.0, 1.0, 1.5, 4.0])
FILM = winkler.SCENE.format(pressure=0)
LEAK = """
[[leak_off]]
on = "film"
coefficient = 0.25
far_pressure = 0.1
[[probe]]
name = "far"
at = [4, 0]
on = "film"
[[stage]]
kind = "{kind}"
time_step = 0.5
steps = 6
"""
WELL = '[[well]]\nname = "at {at}"\nat = [{at}, 0]\nflow_rate = {rate}\n'


def block(kind="quasi-static", step=1.0, rigid="", fracture="", along=0.0, shear=3, method=""):
    given = {"kind": kind, "step": step, "fracture": fracture, "along": along, "shear": shear}
    return method + BLOCK.format(rigid="rigid = true" if rigid else "", **given)


def film(kind, method="", wells=None):
    half = np.convolve(np.diff(X), [0.5, 0.5], "full") / X[-1]  # of a rate of 2 the share of each node: p is uniform
    wells = dict(zip(X.tolist(), 2.0 * half, strict=True)) if wells is None else wells
    return method + FILM + LEAK.format(kind=kind) + "".join(WELL.format(at=at, rate=q) for at, q in wells.items())


def seeping(kind, rate, wells):
    law = f'[[seepage]]\non = "film"\nrate = {rate}\n'
    return (
        film(kind, wells=wells)
        .replace("[[leak_off]]", law + "[[leak_off]]")
        .replace("coefficient = 0.25", "coefficient = 0")
    )


ABSORBING = '[[absorbing]]\non = ["west", "east"]\n'
DASHPOTS = (
    f'[[dashpot]]\non = ["west", "east"]\nnormal = 10\nshear = {np.sqrt(2 * 25)}\n'  # rho c_p, rho c_s of the block
)
EXPLICIT, CONDENSED = 'method.stepper = "explicit"\n', 'method.coupling = "condensed"\n'
SCENES = {
    "held": block(rigid="yes"),
    "parted": block(fracture=CRACK),
    "condensed": block(fracture=CRACK, method=CONDENSED),
    "swings": block("dynamic", 0.1, rigid="yes"),
    "swings explicit": block("dynamic", 0.1, rigid="yes", method=EXPLICIT),
    "stiff explicit": block("dynamic", 0.5, method=EXPLICIT).replace("stiffness = 5", "stiffness = 5000"),
    "slides": block(along=0.3, shear=0),
    "misspelt": block().replace("normal_stiffness", "normal_stifness"),
    "elsewhere": block().replace('"south"', '"below"'),
    "dry": block() + '[[leak_off]]\non = "crack"\ncoefficient = 1\n',
    "absorbed": block("dynamic", 0.1, along=0.3) + ABSORBING,
    "dashed": block("dynamic", 0.1, along=0.3) + DASHPOTS,
    "dashed explicit": block("dynamic", 0.1, along=0.3, method=EXPLICIT) + DASHPOTS,
    "absorbed explicit": block("dynamic", 0.1, along=0.3, method=EXPLICIT) + ABSORBING,
    "filled": film("quasi-static"),
    "filled condensed": film("quasi-static", CONDENSED),
    "filled in cycles": film("quasi-static", 'method.coupling = "fixed-point"\nmethod.fixed_point = "added-storage"\n'),
    "shaken": film("dynamic"),
    "shaken explicit": film("dynamic", EXPLICIT),
    "along": film("steady", wells={0.0: 2.0}),
    "seeps": seeping("steady", 0.5, {0.0: 2.0}),
    "seeps more": seeping("steady", 0.5, {0.0: 1.0}),
    "seeps for long": seeping("quasi-static", 0.125, {0.0: 2.0}).replace("conductance = 1\n", "conductance = 1e8\n"),
    "seeps from the start": seeping("dynamic", 0.5, {}),
}


class Ran:
    """Runs of a folder of scenes: histories, notes of checkpoints and failures by name, and what the schema says."""

    def __init__(self, folder, names, ranks=1):
        (folder / "film.msh").write_text(winkler.mesh(X), encoding="utf-8")
        for name in names:
            (folder / f"{name}.toml").write_text(SCENES[name], encoding="utf-8")
        launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        clean = without_ranks()
        words = [*launcher, sys.executable, str(PROGRAM), str(folder)]
        done = subprocess.run(words, env=clean, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        self.said = json.loads((folder / "said.json").read_text(encoding="utf-8"))
        done = [name for name in names if name not in self.said["failures"]]
        self.histories = {name: read_history(folder / name / "history.h5") for name in done}
        self.notes = {name: read_notes(folder / name / "checkpoint.h5") for name in done}

    def __getitem__(self, name):
        return self.histories[name]

    def closes(self, name, limit=1e-10):
        energies = {key: values for key, values in self[name].items() if key.startswith("energy/")}
        largest = max(np.abs(values).max() for values in energies.values())
        return np.abs(energies["energy/residual"]).max() <= limit * largest


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    return Ran(tmp_path_factory.mktemp("one"), SCENES)


def test_springs_alone_hold_a_block(ran):
    """F/k_n, and k_n u^2/2 times the length of the side in the energy balance."""
    assert ran["held"]["probe/top/displacement"][-1] == pytest.approx([0.0, -0.1], abs=1e-12)
    assert ran["held"]["energy/springs"][-1] == pytest.approx(0.5 * 5 * 0.1**2 * 4, rel=1e-11)
    assert ran["held"]["energy/rock_strain"][-1] == pytest.approx(0.0, abs=1e-12)
    assert ran.closes("held")


@pytest.mark.parametrize("name", ["parted", "condensed"])
def test_springs_in_series_with_a_joint_and_the_rock(ran, name):
    """u = F (1/k_n of the springs + 1/k_n of the joint + h/E), each with its share of the energy."""
    found, areas = ran[name], 0.5 * 0.5**2 * 4 * np.array([1 / 5, 1 / 10, 2 / 50])
    assert found["probe/top/displacement"][-1] == pytest.approx([0.0, -0.5 * (1 / 5 + 1 / 10 + 2 / 50)], abs=1e-11)
    stored = [found[f"energy/{entry}"][-1] for entry in ("springs", "joint_normal", "rock_strain")]
    assert stored == pytest.approx(areas, rel=1e-9)
    assert ran.closes(name)


@pytest.mark.parametrize(("name", "half_angle"), [("swings", np.arctan), ("swings explicit", np.arcsin)])
def test_frequency_on_springs(ran, name, half_angle):
    """omega^2 = k_n L/m; tan or sin of half the angle of a step is omega dt/2, by the rule."""
    angle = 2.0 * half_angle(0.5 * 0.1 * np.sqrt(5 * 4 / (2 * 8)))
    expected = -0.1 * (1.0 - np.cos(angle * np.arange(21)))
    assert ran[name]["probe/top/displacement"][:, 1] == pytest.approx(expected, abs=1e-11)
    assert ran.closes(name)


def test_stiff_springs_shorten_explicit_steps(ran):
    """With k_n a hundred times what the cells have the steps of the rock alone would not be stable."""
    assert np.abs(ran["stiff explicit"]["probe/top/displacement"]).max() < 0.1
    assert ran.closes("stiff explicit", 1e-9)


@pytest.mark.parametrize("rule", ["", " explicit"])
def test_dashpots_are_what_absorbing_sides_have(ran, rule):
    one, other = ran["absorbed" + rule], ran["dashed" + rule]
    assert other["probe/top/displacement"] == pytest.approx(one["probe/top/displacement"], rel=1e-9, abs=1e-13)
    assert other["energy/dashpots"] == pytest.approx(one["energy/radiated"], rel=1e-9)
    assert other["energy/springs"] == pytest.approx(one["energy/springs"], rel=1e-9)
    assert ran.closes("dashed" + rule) and one["energy/radiated"][-1] > 1e-3


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("slides", "has no support in x "),  # nothing along the side: the block is loose that way alone
        ("misspelt", 'spring.0.normal_stifness = 5: unknown key; did you mean "normal_stiffness"?'),
        ("elsewhere", 'spring.0.on = "below": not in the mesh; allowed: '),
        ("dry", "leak_off = [{on = "),
        ("seeps more", "flow rates of at 0.0, leak_off, seepage add up to -1 in film"),
        ("seeps from the start", "flow rates of leak_off, seepage add up to -2 from the first instant in film"),
    ],
)
def test_what_is_refused(ran, name, said):
    assert said in ran.said["failures"][name], ran.said["failures"][name]


def test_the_schema_has_the_keys(ran):
    rows = {key: (values, default, meaning) for key, values, default, meaning in ran.said["schema"]}
    assert rows["spring[].normal_stiffness"][:2] == ("[force/length**3]", "required")
    assert rows["spring[].shear_stiffness"][1] == "0.0"
    assert "Winkler" in rows["[spring[]]"][2] and rows["leak_off[].on"][2] == "names of fractures: one or a list"


@pytest.mark.parametrize("name", ["filled", "filled condensed", "filled in cycles"])
def test_what_flows_in_is_stored_or_leaks(ran, name):
    """L/k_n (p - p_before)/dt + c L (p - p_far) = Q by backward Euler; volumes and energies add up."""
    expected = [0.0]
    for _ in range(6):
        expected.append((2.0 + 4.0 * expected[-1] / 0.5 + 0.25 * 4.0 * 0.1) / (4.0 / 0.5 + 0.25 * 4.0))
    found = ran[name]
    assert found["probe/far/pressure"] == pytest.approx(expected, rel=1e-10)
    leaked = np.cumsum(0.5 * 0.25 * 4.0 * (np.array(expected) - 0.1)) + 0.5 * 0.25 * 4.0 * 0.1
    assert found["volume/leak_off"] == pytest.approx(leaked, rel=1e-10)
    assert found["volume/leak_off"] + 4.0 * found["probe/far/opening"] == pytest.approx(2.0 * found["time"], rel=1e-10)
    assert ran.notes[name]["left"] == {"leak_off": found["volume/leak_off"][-1]}
    assert ran.closes(name)


def test_explicit_steps_leak_as_implicit_ones(ran):
    """Nothing but the walls moves: both rules are the same, walls that ring included."""
    one, other = ran["shaken"], ran["shaken explicit"]
    assert other["probe/far/pressure"] == pytest.approx(one["probe/far/pressure"], rel=1e-9)
    assert other["volume/leak_off"] == pytest.approx(one["volume/leak_off"], rel=1e-9)
    assert ran.closes("shaken") and ran.closes("shaken explicit")


def test_leak_off_alone_settles_a_pressure(ran):
    """Steady, pumped at one end, drained by nothing else: (K + c L/2 at each end) p = Q, K of conductance 1/L each."""
    length, matrix = np.diff(X), np.zeros((4, 4))
    for i, here in enumerate(length):
        matrix[i : i + 2, i : i + 2] += np.array([[1, -1], [-1, 1]]) / here + 0.25 * here / 2 * np.eye(2)
    source = np.array([2.0, 0, 0, 0]) + 0.25 * 0.1 * np.convolve(length, [0.5, 0.5], "full")
    assert ran["along"]["probe/far/pressure"][-1] == pytest.approx(np.linalg.solve(matrix, source)[-1], rel=1e-10)
    assert ran["along"]["volume/leak_off"][-1] == pytest.approx(2.0 * 3.0, rel=1e-10)
    assert ran.closes("along")


def test_a_given_rate_leaves_the_level_open(ran):
    """As much seeps as is pumped: p' falls from 2 to 0 along the film, and what the springs let it hold stays."""
    flows = 2.0 - 0.5 * (X[1:] + X[:-1]) / 2.0  # in the middle of each element
    drops = np.concatenate([[0.0], np.cumsum(flows * np.diff(X))])
    share = np.convolve(np.diff(X), [0.5, 0.5], "full") / X[-1]
    assert ran["seeps"]["probe/far/pressure"][-1] == pytest.approx(share @ drops - drops[-1], rel=1e-10)
    assert ran["seeps"]["volume/seepage"][-1] == pytest.approx(2.0 * 3.0, rel=1e-12)
    assert ran.closes("seeps")


def test_a_given_rate_counts_where_little_is_stored(ran):
    """4 p = (2 - 4 0.125) t: all that the film stores is 1e-8 of what it conducts, so that its balances are summed."""
    found = ran["seeps for long"]
    assert found["probe/far/pressure"] == pytest.approx((2.0 - 0.5) * found["time"] / 4.0, rel=1e-7)
    assert found["volume/seepage"][-1] == pytest.approx(1.5, rel=1e-12)
    assert ran.closes("seeps for long")


@pytest.mark.starts_ranks
def test_on_two_ranks(tmp_path_factory):
    """The same to round-off."""
    names = ("held", "condensed", "swings explicit", "filled condensed")
    alone, found = (Ran(tmp_path_factory.mktemp("ranks"), names, ranks) for ranks in (1, 2))
    for name in names:
        for key in ("probe/top/displacement", "probe/far/pressure", "volume/leak_off", "energy/springs"):
            if key in alone[name]:
                assert found[name][key] == pytest.approx(alone[name][key], rel=1e-9, abs=1e-12), (name, key)
