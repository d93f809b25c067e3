"""F1: ahead of an open half of a joint two Gauss points oscillate at k_n h/E = 100; the scene is warned of, nodal is smooth."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.cli.app import app
from fracflow.integrators import Steady
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.request import StepRequest

pytestmark = pytest.mark.serial
SCENE = "meshes/failures/half_open_joint/scene.toml"


def _tractions(rule):
    """Normal tractions of the closed half's sections, from the tip of the open half on."""
    model = prepare(load(SCENE, [f"method.quadrature={rule}"]), MPI.COMM_SELF)
    refuse_imbalance(model)
    stepping, block = Stepping(model), model.operators.blocks.joints
    state, _ = stepping.step(equilibrium_state(model), StepRequest(1.0, 1.0, {}, stepping.model.loads), Steady())
    closed = np.flatnonzero(block.fracture == block.fractures.index("closed"))
    order = closed[np.argsort(block.along[closed, 0])]
    return state.sections.traction[:, -1].reshape(len(block.ids), -1)[order]


def _turns(values):
    return int((np.diff(np.sign(np.diff(values[:-2]))) != 0).sum())


def test_gauss_points_are_warned_of_and_oscillate():
    checked = CliRunner().invoke(app, ["check", SCENE, "--json"])
    number = json.loads(checked.output)["card"][0]
    assert number["out_of_range"] and number["where"] == "closed"
    assert number["value"] == pytest.approx(100 * (1 - 0.25**2), rel=1e-9)  # k_n h/E'
    assert '"gauss2" oscillate' in number["remedy"] and 'set method.quadrature = "nodal"' in number["remedy"]
    ends = _tractions("gauss2") @ np.array([[1 + 3**0.5, 1 - 3**0.5], [1 - 3**0.5, 1 + 3**0.5]]) / 2
    nodes = np.append(ends[:, 0], ends[-1, 1])
    assert nodes[:-1][1:] == pytest.approx(ends[:-1, 1], rel=1e-6)
    assert (
        _turns(nodes) == 4 and nodes[1] < 0.01 * nodes[0]
    )  # published: 4 turns, and 0.002 of the first at the second node


def test_the_nodal_rule_is_smooth():
    checked = CliRunner().invoke(app, ["check", SCENE, "--json", "--set", "method.quadrature=nodal"])
    assert not json.loads(checked.output)["card"][0]["out_of_range"]
    ends = _tractions("nodal")
    nodes = np.append(ends[:, 0], ends[-1, 1])
    assert _turns(nodes) == 0 and nodes.min() > 0
    assert nodes[1:7].min() / nodes[0] == pytest.approx(0.200, abs=0.001)  # published
