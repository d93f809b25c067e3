"""Each decision says by which criterion it was taken, and none is taken that would save nothing."""

import json

import pytest
from test_kept_factors import INJECTION, SLIDING, load_text
from typer.testing import CliRunner

from fracflow.cli.app import app
from fracflow.diagnostics.number import Number
from fracflow.reduction import ReductionInput, as_lines, decide

pytestmark = pytest.mark.serial
DRY = SLIDING.partition("[[stage]]")[0]
EXPLICIT = """
[method]
stepper = "explicit"
[[stage]]
kind = "dynamic"
time_step = "DT"
steps = 10
"""


def decisions(text, card=(), **facts):
    return {each.part: each for each in decide(ReductionInput(load_text(text), **facts).with_card(card))}


def test_fluid_parts_that_hardly_matter_are_kept_where_that_costs_nothing():
    """d^3 kappa^2 k_tot, dt = 1000 tau_d and k_n d/K_f = 1e-5 would allow all three to be left out."""
    weak = [
        Number("coupling, transient", "", 1e-4),
        Number("coupling, steady", "", 1e-4),
        Number("pressure ringing", "", 500.0),
    ]
    weak.append(Number("fluid compressibility", "", 1e-5))
    found = decisions(
        INJECTION.replace("viscosity", "compressibility = 4e-10\nviscosity"), weak, unknowns=1000, pressures=10
    )
    for part in ("wall-to-flow coupling", "fracture storage", "compressibility"):
        assert found[part].value < found[part].limit
        assert not found[part].left_out and found[part].saves.startswith("nothing: kept")


def test_dry_scene_leaves_out_the_flow():
    found = decisions(SLIDING)
    assert found["flow"].left_out and not decisions(INJECTION)["flow"].left_out
    assert "fracture storage" not in found


def test_what_was_undone_is_told():
    (stage,) = [each.stage for each in decide(ReductionInput(load_text(SLIDING))) if each.part == "inertia"]
    back = decisions(SLIDING, undone={f"inertia, {stage}": "time 2: 0.5"})["inertia"]
    assert not back.left_out and as_lines([back])[0].endswith("undone at time 2: 0.5")


def test_check_prints_decisions_sizes_and_cost(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(INJECTION)
    done = CliRunner().invoke(app, ["check", str(file)])
    assert done.exit_code == 0, done.output
    for word in ("fracture storage", "may err by", "left out", "displacement unknowns", "memory, about", "CPU s: "):
        assert word in done.output
    told = json.loads(CliRunner().invoke(app, ["check", str(file), "--json"]).output)
    keys = {
        "part",
        "left_out",
        "criterion",
        "value",
        "limit",
        "error",
        "saves",
        "stage",
        "undone",
        "asked",
        "added",
        "verdict",
    }
    assert all(set(each) == keys for each in told["plan"])


@pytest.mark.parametrize(("step", "cut"), [("0.5 ms", ""), ("5 ms", " in 5 parts of 1 ms")])
def test_explicit_steps_are_told_without_factorisations(tmp_path, step, cut):
    """A step longer than the critical one is taken in parts, and nothing is factorised."""
    (tmp_path / "scene.toml").write_text(f"{DRY}{EXPLICIT}".replace("DT", step))
    found = json.loads(CliRunner().invoke(app, ["check", str(tmp_path / "scene.toml"), "--json"]).output)
    assert not [each["part"] for each in found["plan"] if "factor" in each["part"] or "condensed" in each["part"]]
    sizes = found["sizes"]
    assert sizes["explicit steps"].startswith(f"10 steps of {step}{cut}; critical time step of the rock ")
    (told,) = [value for key, value in sizes.items() if key.startswith("time of the steps")]
    assert f"{50 if cut else 10} explicit parts" in told and "factorisation" not in told
    assert "steps from which a condensed rock pays" not in sizes


def test_explicit_steps_of_events_alone_have_no_count(tmp_path):
    text = (
        f"{DRY}{EXPLICIT}".replace("DT", "5 ms").replace('"dynamic"', '"auto"').replace("steps = 10", 'end = "50 ms"')
    )
    (tmp_path / "scene.toml").write_text(text)
    told = CliRunner().invoke(app, ["check", str(tmp_path / "scene.toml")]).output
    assert "events, in explicit parts of about" in told and "0 explicit parts" not in told


def test_rock_without_cells_is_not_condensed():
    """It has the unknowns of its joints alone: the plan says nothing of a choice that it has not."""
    domain = "domain = [[0, 0], [100, 0], [100, 100], [0, 100]]\nsize = 25"
    held = '[[support]]\non = ["east", "west", "north", "south"]\n'
    unmeshed = INJECTION.replace(domain, 'domain = "unbounded"\nsize_at_fractures = 25').replace(held, "")
    assert [
        "rock, condensed to its joints" in decisions(text, unknowns=1000, pressures=10, jumps=12)
        for text in (INJECTION, unmeshed)
    ] == [True, False]
