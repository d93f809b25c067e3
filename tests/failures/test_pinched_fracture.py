"""F2c: a slot pinches shut between well and outlet and opens again; what loses its outlet is named, and keeps its fluid."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import list_steps, read_history, read_step
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve import monolithic

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "pinched_fracture" / "scene.toml"


def test_it_goes_on_and_says_so(shared_tmp):
    """Up and down the same way: closed, the left slot gives back what it took up, for its fluid is incompressible."""
    run(load(SCENE, ["output.pictures=false"]), shared_tmp / "run")
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    middle, pressure = found["probe/middle/aperture"], found["probe/in/pressure"]
    assert np.flatnonzero(middle < 0.0).tolist() == [3, 4, 5]
    assert np.diff(middle)[2:4] == pytest.approx(np.diff(middle)[5:3:-1] * -1, rel=1e-9)
    assert pressure[6:8] == pytest.approx(pressure[2:0:-1], rel=1e-9)
    flow = found["probe/in/flow_rate"]
    assert flow[[1, 2, 6, 7, 8, 9]] == pytest.approx(1e-5, rel=1e-9)
    assert np.abs(flow[3:6]).max() < 1e-8 * 1e-5
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
    log = (shared_tmp / "run" / "log.txt").read_text()
    assert "time 3 s: slot pinched shut; the network has 5 parts" in log
    assert "time 3 s: no pressure is prescribed in cut, slot (3 nodes around (0.5, 0))" in log
    assert "time 6 s: slot conducts again" in log


@pytest.mark.parametrize("coupling", ["auto", "monolithic"])
@pytest.mark.parametrize("film", ["backward-euler", "bdf2"])
def test_with_storage_fluid_holds_it_open(shared_tmp, film, coupling):
    """Thin fluid runs out until it is too narrow for the rest, never through nothing; 1 mm in the end, whatever the rule.

    It opens within a step once it does: from shut walls no iteration leads there, so that no step may ask for halves.
    """
    options = ["output.pictures=false", f"method.flow_integrator={film}", "well.in.flow_rate=0", "fluid.viscosity=1e-6"]
    options += [f"method.coupling={coupling}", "accuracy.max_halvings=0"]
    run(load(SCENE, [*options, 'stage=[{kind="quasi-static", time_step=1, steps=9}]']), shared_tmp / "run")
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    time, aperture = found["time"], found["probe/middle/aperture"]
    assert aperture.min() > 0.0
    assert aperture[time == 2.0] == pytest.approx(2e-4, rel=0.02)  # 0.4 mm a second, as the load says
    assert aperture[time == 4.0] < 1e-5
    assert aperture[-1] == pytest.approx(1e-3, rel=1e-3)
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest


def test_pumping_on_is_named(shared_tmp):
    with pytest.raises(SolveError, match=r"time 3 s: flow rates of in add up to 1e-05 m\^3/s in cut, slot \(3 nodes"):
        run(load(SCENE, ["output.pictures=false", "well.in.flow_rate=1e-5"]), shared_tmp / "run")


def test_a_least_aperture_keeps_it_open_and_is_counted(shared_tmp):
    """Two elements of 0.5 m at 1e-5 m carry the whole flow at a drop of 12 mu L q/d^3 = 1.2e8 Pa."""
    least = "fracture.slot.minimum_hydraulic_aperture=1e-5"
    run(load(SCENE, ["output.pictures=false", least, "well.in.flow_rate=1e-12"]), shared_tmp / "run")
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    count, flow = found["step/minimum_aperture"], found["step/minimum_aperture_flow"]
    assert count[[0, 1, 2, 8, 9]].tolist() == [0] * 5 and count[4] == 4
    assert flow[4] == pytest.approx(1e-12, rel=1e-6)
    assert found["probe/in/pressure"][4] == pytest.approx(12e-3 * 1.0 * 1e-12 / 1e-15, rel=1e-4)
    assert "conducted by minimum_hydraulic_aperture" in (shared_tmp / "run" / "log.txt").read_text()


NAMED = r"time 1 s: the walls that are moved change the volume of slot \(7 nodes.*by -0\.0003 m\^2 per thickness"


@pytest.mark.parametrize("kind", ["quasi-static", "steady"])
def test_rigid_walls_do_not_squeeze_fluid_out_of_the_books(shared_tmp, kind):
    """Two supported blocks closed by a tenth of the slot between them, 3 long: incompressible fluid has no place to go."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "two.geo").write_text(TWO_BLOCKS)
        (shared_tmp / "scene.toml").write_text(SLOT + f'stage = [{{kind = "{kind}", time_step = 1, steps = 2}}]\n')
    comm.barrier()
    with pytest.raises(SolveError, match=NAMED):
        run(load(shared_tmp / "scene.toml"), shared_tmp / "run")
    drained = "well=[{name='out', at={fracture='slot', end='end'}, pressure=0}]"
    run(load(shared_tmp / "scene.toml", [drained]), shared_tmp / "drained")


@pytest.mark.parametrize("stage", ['"steady"', '"steady", time_step = 1', '"quasi-static", time_step = 1'])
def test_apertures_over_four_decades_conduct(shared_tmp, stage):
    """20 mm in a row with 2.5 um: 12 orders in d^3, and yet the wide one is drained by the thin one, at 12 mu L q/d^3.

    Flow from node to node along the wide one has four digits, whose errors would add up to that of the pressure.
    """
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(f"stage = [{{kind = {stage}, steps = 1}}]\n" + IN_A_ROW)
    comm.barrier()
    run(load(shared_tmp / "scene.toml"), shared_tmp / "run")
    comm.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")["probe/in/pressure"][-1]
    assert found == pytest.approx(12e-3 * (2 / 2.5e-6**3 + 2 / 0.02**3) * 1e-12, rel=1e-9)  # eps d_1^3/d_2^3 is 1.1e-4
    thinner = ["fracture.thin.aperture='20 nm'", "output.pictures=false"]
    with pytest.raises(
        SolveError, match=r"1e-12 m\^3/s in thin, wide \(5 nodes around \(2, 1\)\), which no pressure drains"
    ):
        run(load(shared_tmp / "scene.toml", thinner), shared_tmp / "thinner")


@pytest.mark.parametrize("kind", ["steady", "quasi-static"])
def test_pressures_on_both_sides_of_a_wide_fracture_and_a_narrow_one(shared_tmp, kind):
    """Flow is p/(12 mu sum L/d^3), of which eps d_1^3/d_2^3 is round-off: few digits are named, with what would do."""
    comm = MPI.COMM_WORLD
    text = IN_A_ROW.replace("flow_rate = 1e-12", "pressure = 8e5").replace("20 mm", "100 mm")
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(f'stage = [{{kind = "{kind}", time_step = 1, steps = 1}}]\n' + text)
    comm.barrier()
    named = (
        r"what wells with a pressure draw keeps 0\.0 digits, accuracy\.digits asks for 6: in wide, of conductance 0\.167.*"
        r"thin, of hydraulic aperture 1e-06.*: give a flow_rate in place of the pressure in wide, or in thin a"
        r" minimum_hydraulic_aperture of 0\.00019"
    )
    with pytest.raises(SolveError, match=named):
        run(load(shared_tmp / "scene.toml", ["fracture.thin.aperture='1 um'"]), shared_tmp / "thin")
    enough = ["fracture.thin.aperture='1 um'", "fracture.thin.minimum_hydraulic_aperture='0.19 mm'"]
    run(load(shared_tmp / "scene.toml", enough), shared_tmp / "enough")
    comm.barrier()
    found = read_history(shared_tmp / "enough" / "history.h5")
    power = 8e5**2 / (12e-3 * (2.0 / 0.19e-3**3 + 2.0 / 0.1**3))
    assert found["energy/work_wells"][-1] == pytest.approx(power, rel=1e-6)
    assert found["energy/viscous"][-1] == pytest.approx(power, rel=1e-6)


def test_of_a_part_that_a_flow_rate_feeds_few_digits_are_told_and_not_refused(shared_tmp):
    """Pumped from nothing the first step moves next to nothing."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(RAMPED)
    comm.barrier()
    run(load(shared_tmp / "scene.toml"), shared_tmp / "fed")
    comm.barrier()
    told = [line for line in (shared_tmp / "fed" / "log.txt").read_text().splitlines() if "digits so far" in line]
    assert len(told) == 1 and "time 25 µs" in told[0] and "in wide" in told[0]


@pytest.mark.parametrize("end, rate, refused", [("apart", 1e-12, True), ("thin", 1e-12, False), ("thin", 0, True)])
def test_a_flow_rate_speaks_for_the_part_that_it_feeds(shared_tmp, end, rate, refused):
    """Two given pressures in a row as above; a third well feeds a fracture apart, or the row, or is shut."""
    comm = MPI.COMM_WORLD
    text = IN_A_ROW.replace("flow_rate = 1e-12", "pressure = 8e5").replace("20 mm", "100 mm").replace("2.5 um", "1 um")
    text = text.replace("[[3, 1], [5, 1]]}", '[[3, 1], [5, 1]]}, {name = "apart", points = [[2, 3], [4, 3]]}')
    third = f'{{name = "third", at = {{fracture = "{end}", end = "start"}}, flow_rate = {rate}}}'
    outlet = '{name = "fourth", at = {fracture = "apart", end = "end"}, pressure = 0}'
    text = text.replace("well = [", f"well = [\n  {third},\n  {outlet},") + 'apart.aperture = "1 mm"\n'
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text('stage = [{kind = "steady", time_step = 1, steps = 1}]\n' + text)
    comm.barrier()
    if refused:
        with pytest.raises(SolveError, match=r"keeps 0\.0 digits, accuracy\.digits asks for 6: in wide.* for thin"):
            run(load(shared_tmp / "scene.toml"), shared_tmp / "run")
    else:
        run(load(shared_tmp / "scene.toml"), shared_tmp / "run")


RAMPED = """
output.pictures = false
rock.rock = {youngs_modulus = 30e9, poissons_ratio = 0.22, density = 2600}
initial_stress = {xx = -10e6, yy = -12e6, xy = 0}
fluid = {viscosity = 1e-3, initial_pressure = 1e6, compressibility = 1e-8, flow_depth = 3}
absorbing = [{on = ["west", "south", "east", "north"]}]
stage = [{kind = "dynamic", time_step = 2.5e-5, steps = 4}]
[[well]]
name = "in"
at = {fracture = "thin", end = "end"}
flow_rate = [[0, 0], [2e-3, 2e-2]]
[[well]]
name = "out"
at = {fracture = "wide", end = "start"}
pressure = "initial"
[geometry]
domain = [0, 0, 100, 80]
size = 12
size_at_fractures = 6
[[geometry.fracture]]
name = "wide"
points = [[15, 40], [50, 40]]
[[geometry.fracture]]
name = "thin"
points = [[50, 40], [85, 40]]
[fracture]
default = {law = "linear", normal_stiffness = 50e9, shear_stiffness = 20e9}
wide.aperture = "1 mm"
thin.aperture = "0.3 mm"
"""

IN_A_ROW = """
output.pictures = false
rock.rock.rigid = true
fluid.viscosity = 1e-3
support = [{on = "rock", components = ["x", "y", "rotation"]}]
well = [
  {name = "in", at = {fracture = "wide", end = "start"}, flow_rate = 1e-12},
  {name = "out", at = {fracture = "thin", end = "end"}, pressure = 0},
]
probe = [{name = "in", at = {fracture = "wide", end = "start"}}]
[geometry]
domain = [0, 0, 6, 4]
size = 1
size_at_fractures = 0.5
fracture = [{name = "wide", points = [[1, 1], [3, 1]]}, {name = "thin", points = [[3, 1], [5, 1]]}]
[fracture]
default = {law = "linear", normal_stiffness = 1e12, shear_stiffness = 1e12}
wide.aperture = "20 mm"
thin.aperture = "2.5 um"
"""


@pytest.mark.parametrize("kind", ["quasi-static", "steady"])
def test_a_block_afloat_in_a_moat_takes_no_room(shared_tmp, kind):
    """Its walls move, and enclose the same fluid: the mean pressure stays, here with as much pumped in as out.

    Two ways of two sides each, of length 2: each carries q/2 with 12 mu L (q/2)/d^3 from well to well.
    """
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "two.geo").write_text(ISLAND)
        (shared_tmp / "scene.toml").write_text(MOAT + f'stage = [{{kind = "{kind}", time_step = 1, steps = 2}}]\n')
    comm.barrier()
    run(load(shared_tmp / "scene.toml"), shared_tmp / "run")
    comm.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    first, last = found["probe/a/pressure"][-1], found["probe/b/pressure"][-1]
    if kind == "steady":
        assert first - last == pytest.approx(12e-3 * 2 * 0.5e-7 / 1e-9, rel=1e-3)
        assert 0.5 * (first + last) == pytest.approx(1e5, abs=1e-4)
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest


TWO_BLOCKS = """
Point(1)={0,0,0}; Point(2)={3,0,0}; Point(3)={3,1,0}; Point(4)={0,1,0}; Point(5)={3,2,0}; Point(6)={0,2,0};
Line(1)={1,2}; Line(2)={2,3}; Line(3)={4,3}; Line(4)={4,1}; Line(5)={3,5}; Line(6)={5,6}; Line(7)={6,4};
Curve Loop(1)={1,2,-3,4}; Plane Surface(1)={1}; Curve Loop(2)={3,5,6,7}; Plane Surface(2)={2};
Mesh.MeshSizeMin=0.5; Mesh.MeshSizeMax=0.5;
Physical Surface("lower")={1}; Physical Surface("upper")={2}; Physical Curve("slot")={3};
"""
SLOT = """
mesh.file = "two.geo"
output.pictures = false
rock = {lower.rigid = true, upper.rigid = true}
fluid.viscosity = 1e-3
fracture.slot = {law = "linear", normal_stiffness = 1e9, shear_stiffness = 1e9, aperture = "1 mm"}
support = [
  {on = "lower", components = ["x", "y", "rotation"]},
  {on = "upper", displacement = {x = 0, y = [[0, 0], [1, "-0.1 mm"]], rotation = 0}},
]
"""
ISLAND = """
Point(1)={0,0,0}; Point(2)={3,0,0}; Point(3)={3,3,0}; Point(4)={0,3,0};
Point(11)={1,1,0}; Point(12)={2,1,0}; Point(13)={2,2,0}; Point(14)={1,2,0};
Line(1)={1,2}; Line(2)={2,3}; Line(3)={3,4}; Line(4)={4,1};
Line(11)={11,12}; Line(12)={12,13}; Line(13)={13,14}; Line(14)={14,11};
Curve Loop(1)={1,2,3,4}; Curve Loop(2)={11,12,13,14}; Plane Surface(1)={1,2}; Plane Surface(2)={2};
Mesh.MeshSizeMin=0.5; Mesh.MeshSizeMax=0.5;
Physical Surface("host")={1}; Physical Surface("island")={2}; Physical Curve("moat")={11,12,13,14};
"""
MOAT = """
mesh.file = "two.geo"
output.pictures = false
rock = {host.rigid = true, island.rigid = true}
fluid = {viscosity = 1e-3, initial_pressure = 1e5}
fracture.moat = {law = "linear", normal_stiffness = 1e9, shear_stiffness = 1e9, aperture = "1 mm", initial_normal_traction = 0}
support = [{on = "host", components = ["x", "y", "rotation"]}]
load = [{on = "island", force = [100, 0]}]
well = [{name = "a", at = [1, 1], flow_rate = 1e-7}, {name = "b", at = [2, 2], flow_rate = -1e-7}]
probe = [{name = "a", at = [1, 1]}, {name = "b", at = [2, 2]}]
"""

WEDGE = """
mesh.file = "two.geo"
output.pictures = false
rock = {lower.rigid = true, upper.rigid = true}
fluid = {viscosity = 1e-3, compressibility = 4.5e-10}
fracture.slot = {law = "linear", normal_stiffness = 1e9, shear_stiffness = 1e9, aperture = "1 mm"}
probe = [{name = "left", at = {fracture = "slot", end = "start"}}]
well = [{name = "out", at = {fracture = "slot", end = "end"}, pressure = [[0, 0], [1, 0], [3, 2e6]]}]
support = [
  {on = "lower", components = ["x", "y", "rotation"]},
  {on = "upper", displacement = {x = 0, y = [[0, 0], [1, "-0.6 mm"]], rotation = [[0, 0], [1, 0.3e-3]]}},
]
"""
"""Walls that are moved until they meet at the left end of the slot, by 0.05 mm."""


def test_walls_that_meet_leave_no_fluid_there(shared_tmp):
    """Nothing is stored at that node and nothing comes: its pressure stays, and the rest fills as if it were not there.

    While the fluid has mass, walls that press it into nothing are named, for it has nowhere to go.
    """
    comm = MPI.COMM_WORLD
    stages = (
        'stage = [{kind = "%s", time_step = 0.25, steps = 4}, {kind = "quasi-static", time_step = 0.5, steps = 4}]\n'
    )
    if comm.rank == 0:
        (shared_tmp / "two.geo").write_text(TWO_BLOCKS)
        (shared_tmp / "scene.toml").write_text(stages % "steady" + WEDGE)
        (shared_tmp / "pressed.toml").write_text(stages % "quasi-static" + WEDGE)
    comm.barrier()
    run(load(shared_tmp / "scene.toml"), shared_tmp / "run")
    comm.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    assert found["probe/left/aperture"][-1] == pytest.approx(-5e-5, rel=1e-6)
    assert found["probe/left/pressure"][4:] == pytest.approx(found["probe/left/pressure"][4], abs=1e-6)
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
    _, fields, _ = read_step(list_steps(shared_tmp / "run", "fractures")[-1][1])
    aperture, pressure = np.ravel(fields["aperture"]), np.ravel(fields["pressure"])
    assert pressure[aperture > 0.0] == pytest.approx(2e6, rel=1e-3)
    named = (
        r"time 1 s: the walls that are moved change the volume of slot \(1 nodes.*, or give minimum_hydraulic_aperture"
    )
    with pytest.raises(SolveError, match=named):
        run(load(shared_tmp / "pressed.toml"), shared_tmp / "pressed")


def test_another_linear_solver_is_tried_where_the_first_fails_and_nowhere_else(shared_tmp, monkeypatch):
    """Shut walls leave a matrix that LU does not solve; iterations that are too few have nothing to do with it."""
    made, newton = [], monolithic.Newton
    monkeypatch.setattr(monolithic, "Newton", lambda *given: made.append(given[2]) or newton(*given))
    few = ["output.pictures=false", "accuracy.max_iterations=2", "accuracy.max_halvings=0"]
    with pytest.raises(SolveError, match="did not converge in 2 iterations"):
        run(load(SCENE, few), shared_tmp / "few")
    assert made and "monolithic" not in made
    run(load(SCENE, ["output.pictures=false", "stage.0.steps=4"]), shared_tmp / "run")
    assert "monolithic" in made
