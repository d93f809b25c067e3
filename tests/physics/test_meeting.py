"""Places of supports and wells: two that prescribe one unknown, and wells at points that the mesh names."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.reduction.prepare import prepare
from fracflow.remarks import bare
from fracflow.scene.scene import load

from .conftest import JOINT, ROCK

BLOCK = (
    ROCK
    + JOINT
    + """
fluid = {viscosity = 1e-3, initial_pressure = 1e6}
initial_stress = {xx = -5e6, yy = -5e6}
geometry = {domain = [0, 0, 4, 3], size = 1.5, fracture = [{name = "crack", points = [[1, 1], [3, 2]]}]}
stage = [{kind = "quasi-static", time_step = 1, steps = 1}]
[[support]]
on = ["south", "east"]
displacement = {x = 0}
[[support]]
on = "north"
displacement = {x = [[0, 0], [1, 1e-3], [2, 0]], y = 1e-3}
"""
)


def _notes(folder, *overrides, about="support."):
    file = folder / "scene.toml"
    if MPI.COMM_WORLD.rank == 0:
        first, _, rest = BLOCK.partition("\nfluid")  # tables of a line go before those with a heading
        lines, supports = ("fluid" + rest).split("[[support]]", 1)
        file.write_text(lines + first + "\n[[support]]" + supports, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return [note for note in prepare(load(file, list(overrides)), MPI.COMM_WORLD).placed.notes if about in note]


def test_supports_that_move_a_corner_in_two_ways_are_told(shared_tmp):
    """North and east meet at (4, 3), and differ in x between 0 and 2 s; east prescribes no y."""
    (note,) = _notes(shared_tmp)
    assert "support.1 (north)" in note and "support.0 (south, east)" in note
    assert "in x than" in note and "(4, 3)" in note and "first entry holds" in note


def test_supports_that_agree_at_their_corner_are_not_told(shared_tmp):
    """One affine motion, written as a table for north and as a gradient for east: u_x = 1e-4 y."""
    shear = "displacement_gradient = [[0, 1e-4], [0, 0]]"
    north = "support.1={on = 'north', displacement = {x = 3e-4, y = 0}}"
    assert _notes(shared_tmp, f"support.0={{on = 'east', {shear}}}", north) == []
    assert len(_notes(shared_tmp, f"support.0={{on = 'east', {shear}}}", north.replace("3e-4", "3.1e-4"))) == 1


@pytest.mark.parametrize(("other", "is_refused"), [("2 MPa", True), ("1 MPa", False)])
def test_two_pressures_at_one_node_are_refused(shared_tmp, other, is_refused):
    """Of the wells at one node, the last one named had its way, and nothing was said."""
    at = "at = {fracture = 'crack', end = 'start'}"
    wells = f"well=[{{name = 'in', {at}, pressure = '1 MPa'}}, {{name = 'too', at = [1, 1], pressure = '{other}'}}]"
    if is_refused:
        with pytest.raises(InputError, match=r"well\.too: at: sits on the node of well\.in"):
            _notes(shared_tmp, wells)
    else:
        assert not np.any(_notes(shared_tmp, wells, "support.1.displacement={x = 0}"))


def test_wells_that_come_to_share_a_node_are_told(shared_tmp):
    """Less than the snap apart they are one node; wells at one place were meant to be."""
    wells = "well=[{name = 'in', at = [1, 1], pressure = '1 MPa'}, {name = 'too', at = [1, 1], pressure = '1 MPa'},"
    wells += " {name = 'near', at = [1.001, 1.0005], flow_rate = 1e-6}]"
    found = _notes(shared_tmp, wells, about="share a node")
    assert [line.split(" share")[0] for line in found] == ["well.in and well.near", "well.too and well.near"]
    told = _notes(shared_tmp, wells, about="no effect")
    assert [line.partition(": its flow_rate has no effect")[0] for line in told] == ["well.near", "well.near"]
    assert "well.in, which" in told[0] and "well.too, which" in told[1]
    apart = _notes(shared_tmp, wells, "geometry.snap=1e-4", about="well")
    assert apart and not any("share a node" in line or "no effect" in line for line in apart)


@pytest.mark.parametrize(("at", "is_warned"), [("[1.8, 1.8]", True), ("[1.8, 1.41]", False)])
def test_a_well_or_probe_beside_its_fracture_is_told(shared_tmp, at, is_warned):
    """Less than a joint away it is taken onto the fracture, which a line in the log alone said."""
    wells = f"well=[{{name = 'in', at = {at}, pressure = '1 MPa'}}]"
    found = _notes(shared_tmp, wells, f"probe=[{{name = 'on it', at = {at}, on = 'crack'}}]", about="")
    told = [line.split(" ")[0] for line in found if "0.358 m beside the fracture: give a place on it" in line]
    assert told == (["well.in", "probe.on"] if is_warned else [])
    assert sum(line.startswith("note: well.in is on crack at") for line in found) == (not is_warned)


@pytest.mark.parametrize(("point", "place"), [(5, "(0, -2000)"), (6, "(0, 2000)")])
def test_a_well_at_a_named_point_says_where_it_is(point, place, shared_tmp):
    """Gmsh numbers points anew where curves cross: the number in a file may be another point than was meant."""
    meshes = Path(__file__).parents[2] / "meshes" / "report_5_4"
    if MPI.COMM_WORLD.rank == 0:
        text = (meshes / "fault.geo").read_text(encoding="utf-8")
        (shared_tmp / "fault.geo").write_text(f'{text}Physical Point("in") = {{{point}}};\n', encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    scene = load(
        meshes / "scene.toml",
        [f"mesh.file={str(shared_tmp / 'fault.geo')!r}", "well.0.at='in'"],
    )
    notes = prepare(scene, MPI.COMM_WORLD).placed.notes
    assert bare(notes[0]) == f"well.node2 is on fault at {place} ft" and len(notes) == len(scene.well) + 1
    assert notes[-1].startswith("well.node2: its flow_rate has no effect"), "the end of the fault keeps its pressure"
