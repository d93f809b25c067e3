"""`scripts/bench seal` on a small scene: what it counts; no times are asserted."""

import sys

import pytest
import seal

pytestmark = pytest.mark.serial
SCENE = """
rock.rock = {youngs_modulus = "50 GPa", poissons_ratio = 0.25}
support = [{on = ["west", "east", "south", "north"]}]
stage = [{kind = "steady", steps = 3}]
geometry = {domain = [0, 0, 10, 10], size = 5, fracture = [{name = "a", points = [[2, 5], [8, 5]]}]}
fracture.a = {law = "linear", normal_stiffness = "50 GPa/m", shear_stiffness = "20 GPa/m"}
"""


def test_seals_of_every_file_are_counted(tmp_path, monkeypatch, capsys):
    (tmp_path / "scene.toml").write_text(SCENE)
    with seal.clocked():
        assert seal.history.chain is not seal.sealed.chain and seal.sealed.pieces.__name__ == "timed"
    spent, whole, steps = seal.share_of(str(tmp_path / "scene.toml"), [])
    assert 0.0 < spent < whole and steps >= 3
    monkeypatch.setattr(seal, "share_of", lambda *_: (0.05, 1.0, 3))
    monkeypatch.setattr(sys, "argv", ["seal", "a.toml"])
    assert seal.main() == 1 and "5.00%" in capsys.readouterr().out
