"""Explicit steps in one sweep: the equations, by PETSc as by compiled loops, on all ranks, and to the bit after a stop."""

from itertools import pairwise

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.model.balance import static_balance_of
from fracflow.model.mass import inverse_mass
from fracflow.output import read_history
from fracflow.output.checkpoint import read_arrays
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run
from fracflow.solve.explicit import ExplicitModel
from fracflow.solve.leapfrog import damping, in_a_row, joint_nodes, rock, section_work, steps
from fracflow.solve.leapfrog.compiled import library, members_of_steps
from fracflow.solve.leapfrog.damping import PlainDamping, SymmetricDamping
from fracflow.solve.leapfrog.in_a_row import StepsInARow
from fracflow.solve.leapfrog.joint_nodes import CompiledJointNodes, PlainJointNodes, Pushed
from fracflow.solve.leapfrog.local import LocalMatrix
from fracflow.solve.leapfrog.steps import Leapfrog

# triangles beside squares; supports that move and that do not, loads that change and that do not, sides with springs
SCENE = """
title = "all that acts in explicit steps without a fluid"
[rock.rock]
youngs_modulus = 40e9
poissons_ratio = 0.25
density = 2700
[rock.soft]
youngs_modulus = 20e9
poissons_ratio = 0.2
density = 2500
[mesh]
file = "mixed.msh"
[initial_stress]
xx = -30e6
yy = -30e6
xy = 16e6
unbalanced = "carried"
[[absorbing]]
on = ["west", "south"]
[[absorbing]]
on = ["east"]
wave = {kind = "s", velocity = [[0, 0], [0.02, 0.1], [0.05, 0.0]]}
[[load]]
on = ["north"]
traction = [[[0, 0], [0.02, 1e6], [0.05, 0]], 0]
[[load]]
on = ["north"]
traction = "initial-stress"
[[support]]
on = ["north"]
components = ["y"]
displacement = {y = [[0, 0], [0.03, 1e-3]]}
[fracture.fault]
law = "slip-weakening"
normal_stiffness = 500e9
shear_stiffness = 500e9
aperture = 1e-3
friction_coefficient = 0.6
dynamic_friction_coefficient = 0.4
slip_weakening_distance = 0.01
[fracture.fault.initial_shear_traction]
along = [0, 300, 310, 490, 500, 800]
value = [16e6, 16e6, 19e6, 19e6, 16e6, 16e6]
[method]
stepper = "explicit"
[output]
pictures = false
[[probe]]
name = "right"
at = [1250, 500]
on = "fault"
[[probe]]
name = "above"
at = [1000, 740]
[[stage]]
kind = "dynamic"
time_step = 12e-3
end = 0.09
"""
ALL = (rock, joint_nodes, damping, section_work)  # the guess has its own test, as its balance is closer
SIZES = {"acceleration": 100.0, "opening": 1e-3, "slip_rate": 1.0, "velocity": 1.0}


def write_mesh(path):
    """Quadrilaterals of 50 m below the fault, triangles above; the lowest are parallelograms, of two rocks."""
    across, up, side = 40, 20, 50.0
    x, y = (each.ravel() for each in np.meshgrid(np.arange(across + 1) * side, np.arange(up + 1) * side))
    is_free = (x > 0) & (x < side * across) & (y > 0) & (y < side * up) & (y != 500.0)
    shift = 0.15 * side * np.random.default_rng(1).uniform(-1.0, 1.0, (2, len(x)))
    low = y < 350.0
    shift[:, low] = 0.2 * (np.stack([y, x])[:, low] % (2.0 * side))
    shift *= is_free

    def at(i, j):
        return j * (across + 1) + i + 1

    cells = []
    for j in range(up):
        for i in range(across):
            a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
            rock = 2 if j < 6 and i % 5 == 1 else 1
            cells += [(3, rock, (a, b, c, d))] if j < up // 2 else [(2, 2, (a, b, c)), (2, 2, (a, c, d))]
    cells += [(1, 3, (at(i, 10), at(i + 1, 10))) for i in range(12, 28)]
    for number, row in ((4, 0), (5, up)):
        cells += [(1, number, (at(i, row), at(i + 1, row))) for i in range(across)]
    for number, column in ((6, 0), (7, across)):
        cells += [(1, number, (at(column, j), at(column, j + 1))) for j in range(up)]
    names = ["rock", "soft", "fault", "south", "north", "west", "east"]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{2 if n < 2 else 1} {n + 1} "{name}"' for n, name in enumerate(names)]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(x))]
    lines += [f"{n + 1} {p:.17g} {q:.17g} 0" for n, (p, q) in enumerate(zip(x + shift[0], y + shift[1], strict=True))]
    lines += ["$EndNodes", "$Elements", str(len(cells))]
    lines += [f"{n + 1} {k} 2 {group} {group} " + " ".join(map(str, c)) for n, (k, group, c) in enumerate(cells)]
    path.write_text("\n".join([*lines, "$EndElements", ""]))


@pytest.fixture
def scene(shared_tmp):
    """The scene, and its run by this rank alone."""
    if MPI.COMM_WORLD.rank == 0:
        write_mesh(shared_tmp / "mixed.msh")
        (shared_tmp / "scene.toml").write_text(SCENE)
    MPI.COMM_WORLD.barrier()
    return shared_tmp / "scene.toml"


def assert_alike(one, other, within):
    """Histories in two folders, over the largest value of the kind; accelerations over a typical one."""
    one, other = (read_history(folder / "history.h5") for folder in (one, other))
    largest = max(np.abs(values).max() for name, values in one.items() if name.startswith("energy/"))
    for name, values in one.items():
        if name.startswith("energy/"):
            assert np.abs(values - other[name]).max() <= within * largest, name
        if name.startswith("probe/"):
            kind = name.rsplit("/", 1)[-1]
            size = max(np.nanmax(np.abs(one[key]), initial=0.0) for key in one if key.endswith(kind))
            assert np.nanmax(np.abs(values - other[name]), initial=0.0) <= within * max(size, SIZES.get(kind, 0.0)), (
                name
            )


@pytest.mark.serial
@pytest.mark.parametrize("lacking", [(rock,), (joint_nodes, damping, section_work), ALL], ids=["rock", "joints", "all"])
def test_without_a_compiler(scene, tmp_path, monkeypatch, lacking):
    totals = run(load(scene), tmp_path / "sweep", MPI.COMM_SELF)
    history = read_history(tmp_path / "sweep/history.h5")
    energy = {name: np.abs(values).max() for name, values in history.items() if name.startswith("energy/")}
    largest = max(energy.values())
    assert totals.steps > 6 and energy["energy/residual"] < 1e-10 * largest
    for name in ("kinetic", "radiated", "damping", "work_incident", "work_boundaries", "friction"):
        assert energy[f"energy/{name}"] > 1e-6 * largest, name  # all of them act
    for module in lacking:
        monkeypatch.setattr(module, "library", lambda: None)
    run(load(scene), tmp_path / "petsc", MPI.COMM_SELF)
    assert_alike(tmp_path / "sweep", tmp_path / "petsc", 1e-12)


# a rigid block that turns beside rock that deforms, between a fluid that is compressible and dashpots
FLUID = """
[rock.soft]
youngs_modulus = 10e9
poissons_ratio = 0.25
density = 2500
[rock.stiff]
rigid = true
density = 2700
[mesh]
file = "blocks.geo"
[fracture.default]
normal_stiffness = 50e9
shear_stiffness = 20e9
aperture = 1e-3
friction_coefficient = 0.3
[initial_stress]
xx = -5e6
yy = -6e6
xy = 1.2e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
compressibility = 4.5e-10
[[support]]
on = "south"
[[absorbing]]
on = "east"
[[load]]
on = "north"
traction = [[[0, 0], [1e-3, 2e5]], 0]
[[load]]
on = ["north", "rest"]
traction = "initial-stress"
[[well]]
name = "in"
at = {fracture = "joint", end = "start"}
flow_rate = 2e-3
[[probe]]
name = "middle"
at = [2, 1]
on = "joint"
[[stage]]
kind = "dynamic"
time_step = 2e-5
steps = 4
[method]
stepper = "explicit"
[output]
pictures = false
"""
BLOCKS = """
Point(1) = {0, 0, 0}; Point(2) = {4, 0, 0}; Point(3) = {4, 1, 0};
Point(4) = {0, 1, 0}; Point(5) = {4, 2, 0}; Point(6) = {0, 2, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1}; Line(5) = {3, 5}; Line(6) = {5, 6}; Line(7) = {6, 4};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Curve Loop(2) = {-3, 5, 6, 7}; Plane Surface(2) = {2};
Physical Surface("soft") = {1}; Physical Surface("stiff") = {2};
Physical Curve("joint") = {3}; Physical Curve("south") = {1}; Physical Curve("north") = {6};
Physical Curve("east") = {2}; Physical Curve("rest") = {4, 5, 7};
Mesh.MeshSizeMax = 0.5;
"""


@pytest.mark.serial
@pytest.mark.parametrize("kind", ["rock", "fluid"])
def test_steps_are_those_of_the_equations(scene, tmp_path, kind):
    """u_new = u + dt v + dt^2/2 a + S M^-1 (r_new - r), v_new = v + dt (a + a_new)/2, M a = r - K u."""
    file, dt = scene, 1e-3
    if kind == "fluid":
        (tmp_path / "blocks.geo").write_text(BLOCKS)
        (file := tmp_path / "fluid.toml").write_text(FLUID)
        dt = 2e-5
    wanted = load(file, [] if kind == "fluid" else ["stage.0.time_step=1e-3", "stage.0.end=4e-3"])
    model = prepare(wanted, MPI.COMM_SELF)
    ops, held, found, left = model.operators, model.loads.held, [], []
    inverse, free = inverse_mass(ops, held), np.ones(ops.layout.solid_count, dtype=bool)
    free[held] = False

    def look(step):
        state, pull = step.state, ops.layout.solid_vector()
        ops.joints.force(state.sections.traction, pull)
        if ops.flow is not None:
            ops.flow.pressure_load.scale(-1.0)
            ops.flow.pressure_load.multAdd(state.pressure, pull, pull)
            ops.flow.pressure_load.scale(-1.0)
        pushed = state.forces.load.getArray() - pull.getArray()
        inertia, static = ops.layout.solid_vector(), static_balance_of(ops, state)
        ops.mass.mult(state.motion.acceleration, inertia)
        found.append((state.time, *(each.copy() for each in state.motion.values()), pushed))
        size = np.abs(ops.joints.weights).max() * np.abs(state.sections.traction).max()
        left.append(inertia.getArray() + static.getArray())  # what the initial state leaves is carried
        assert np.abs(left[-1] - left[0])[free].max() < 1e-10 * size

    run(wanted, tmp_path / "run", MPI.COMM_SELF, progress=look)
    assert len(found) >= 4 and (kind == "rock" or np.abs(left[-1])[free].max() < 1e-3)
    for (_, u, v, a, r), (_, u_new, v_new, a_new, r_new) in pairwise(found):
        change, moved = ops.layout.solid_vector(), ops.layout.solid_vector()
        change.setArray(r_new - r)
        inverse.mult(change, moved)
        expected = dt * v + 0.5 * dt**2 * a + 0.25 * dt**2 * moved.getArray()
        assert np.abs(u_new - u - expected)[free].max() < 1e-10 * np.abs(expected).max()
        speed = 0.5 * dt * (a + a_new)
        assert np.abs(v_new - v - speed)[free].max() < 1e-10 * np.abs(v_new).max()
    history = read_history(tmp_path / "run/history.h5")
    largest = max(np.abs(values).max() for name, values in history.items() if name.startswith("energy/"))
    assert np.abs(history["energy/residual"]).max() < 1e-10 * largest


@pytest.mark.serial
@pytest.mark.skipif(library() is None, reason="loops are not compiled here")
def test_compiled_passes_are_those_of_numpy(scene):
    """Each pass over the nodes of joints, and damping, of motions and tractions at random; and they are in use."""
    model, rng = prepare(load(scene), MPI.COMM_SELF), np.random.default_rng(7)
    leapfrog = Leapfrog(ExplicitModel(model.scene, model.operators, model.loads), model.scene, model.loads)
    nodes, there = leapfrog.nodes, leapfrog.nodes.rock
    fast, plain = CompiledJointNodes(nodes), PlainJointNodes(nodes)
    assert type(leapfrog.run.passes) is CompiledJointNodes
    for values in (there.u, there.v, there.f):
        values[:] = rng.normal(size=values.shape)
    p, s = len(nodes.pushed), len(model.operators.joints.weights)
    before, after = rng.normal(size=(2, s, 2))
    force, added, old, new = rng.normal(size=(4, p))

    def passed(way):
        moved = way.predicted(there.v, 0.3)
        step, start = Pushed(force.copy(), added.copy(), moved), there.u.copy()
        jump = way.jump(moved)
        sizes, forced = way.pull(step, before, after, 0.2 / nodes.inverse.max()), np.ones(len(nodes.places_forced))
        way.resist(after, forced)
        way.shift(step.added)
        way.place(forced)
        shifted, there.u[:] = there.u.copy(), start
        return [
            jump,
            sizes,
            *step,
            forced,
            shifted,
            there.e.copy(),
            way.accelerated(),
            np.array(way.gain(force, old, new)),
        ]

    for one, other in zip(passed(fast), passed(plain), strict=True):
        assert np.abs(one - other).max() <= 1e-13 * np.abs(other).max() and np.abs(other).max() > 0.0
    parts = there, fast, leapfrog.joints.guess, *nodes.damping.values()
    given = dict.fromkeys(("sections_all", "pushed_all", "first_ghost", "ghosts"), 0)
    given |= {name: value for part in parts for name, value in part.given().items()}
    row = StepsInARow(nodes, given, None)
    assert members_of_steps() - given.keys() - in_a_row.OF_A_ROW - row.given == set()
    with pytest.raises(AssertionError, match=r"lacks bridge$"):
        StepsInARow(nodes, given | {"bridge": 1}, None)
    (symmetric,) = nodes.damping.values()
    assert type(symmetric) is SymmetricDamping
    (term,) = [found for term in model.operators.terms if (found := term.mean_damping()) is not None]
    whole = PlainDamping(LocalMatrix(term.matrix, symmetric.numbers, square=True, by_nodes=True))
    moved, last, taken = rng.normal(size=(3, len(symmetric.numbers)))
    found = [(*way.damp(moved, 0.3, last, rest := taken.copy()), rest) for way in (symmetric, whole)]
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() <= 1e-13 * np.abs(other).max() and np.abs(other).max() > 0.0


def longer(scene):
    """The same with more steps between states, beside it; for one rank to write."""
    file = scene.with_name("rupture.toml")
    file.write_text(SCENE.replace("12e-3", "30e-3").replace("end = 0.09", "end = 0.3"))
    return file


def are_all_but_the_first(taken):
    """Loops take all steps but that in which damping begins, with the first slip."""
    return taken[0][1] == 0 and len(taken) > 1 and all(count == done > 1 for count, done in taken[1:])


def stop(step):
    if step.state.time > 0.05:
        raise KeyboardInterrupt


def test_ranks_agree(scene, shared_tmp, taken, monkeypatch):
    """With all that acts, and where loops take all steps in a row, or stop on one rank before the others would."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        longer(scene)
        for name in ("scene", "rupture"):
            run(load(scene.with_name(f"{name}.toml")), shared_tmp / f"{name} one", MPI.COMM_SELF)
    comm.barrier()
    taken.clear()
    file = scene.with_name("rupture.toml")
    run(load(file), shared_tmp / "rupture all", comm)
    assert library() is None or are_all_but_the_first(taken)
    with pytest.raises(KeyboardInterrupt):
        run(load(file, ["output.checkpoint_every=1"]), shared_tmp / "parts", comm, progress=stop)
    resume(shared_tmp / "parts", comm)
    taken.clear()
    monkeypatch.setattr(
        StepsInARow, "_most_pressed", lambda self, sections: -1.0000001 * sections.traction[:, 1].min(initial=0.0)
    )
    run(load(file), shared_tmp / "rupture mixed", comm)
    assert library() is None or any(done < count for count, done in taken)
    assert len(set(comm.allgather(tuple(taken)))) == 1
    run(load(scene), shared_tmp / "scene all", comm)
    if comm.rank == 0:
        for name in ("scene all", "rupture all", "rupture mixed"):
            assert_alike(shared_tmp / f"{name.split()[0]} one", shared_tmp / name, 1e-12)
        whole, parts = (read_history(shared_tmp / name / "history.h5") for name in ("rupture all", "parts"))
        for name, values in whole.items():
            assert np.array_equal(values, parts[name], equal_nan=True), name
        largest = max(np.abs(values).max() for name, values in whole.items() if name.startswith("energy/"))
        assert np.abs(whole["energy/residual"]).max() < 1e-10 * largest
    comm.barrier()


@pytest.mark.serial
def test_goes_on_to_the_bit(scene, tmp_path):
    run(load(scene), tmp_path / "whole", MPI.COMM_SELF)
    with pytest.raises(KeyboardInterrupt):
        run(load(scene, ["output.checkpoint_every=1"]), tmp_path / "parts", MPI.COMM_SELF, progress=stop)
    resume(tmp_path / "parts", MPI.COMM_SELF)
    whole, parts = (read_history(tmp_path / name / "history.h5") for name in ("whole", "parts"))
    for name, values in whole.items():
        assert np.array_equal(values, parts[name], equal_nan=True), name


@pytest.mark.serial
@pytest.mark.skipif(library() is None, reason="loops are not compiled here")
def test_steps_in_a_row(scene, tmp_path, taken, monkeypatch):
    """They are those that Python takes one by one, also where they stop for some of these, and go on to the bit."""
    file, reports = longer(scene), {"rows": [], "single": [], "brief": []}

    def made(name):
        run(load(file), tmp_path / name, MPI.COMM_SELF, progress=lambda step: reports[name].append(step.report))

    made("rows")
    assert are_all_but_the_first(taken)
    at_once, loops = [], library().fracflow_steps
    with monkeypatch.context() as few:
        few.setattr(in_a_row, "MOST_AT_ONCE", 6e3)
        few.setattr(library(), "fracflow_steps", lambda given, *some: at_once.append(some) or loops(given, *some))
        with pytest.raises(KeyboardInterrupt):
            run(load(file, ["output.checkpoint_every=1"]), tmp_path / "parts", MPI.COMM_SELF, progress=stop)
        resume(tmp_path / "parts", MPI.COMM_SELF)
    assert {count for count, end in at_once if not end} == {1, 3}  # one after a refusal
    assert max(count for count, _ in at_once) == 3
    taken.clear()
    rows, tables = [], in_a_row.loads_at
    with monkeypatch.context() as few:
        few.setattr(StepsInARow, "_most_pressed", lambda self, sections: -1.0000001 * sections.traction[:, 1].min())
        few.setattr(in_a_row, "loads_at", lambda *given: rows.append(given[-1]) or tables(*given))
        run(load(file), tmp_path / "mixed", MPI.COMM_SELF)
    assert sum(rows) <= 1.7 * sum(max(done, 1) for _, done in taken)  # few are lost where steps are refused
    assert any(0 < done < count for count, done in taken) and any(not done for _, done in taken)
    taken.clear()
    begin = StepsInARow.__init__
    with monkeypatch.context() as brief:  # the loops find no balance of sections that take more iterations
        brief.setattr(
            StepsInARow, "__init__", lambda self, nodes, given, *more: begin(self, nodes, given | {"most": 1}, *more)
        )
        made("brief")
    assert any(0 < done < count for count, done in taken) and any(not done for _, done in taken)
    monkeypatch.setattr(steps, "steps_in_a_row", lambda *given: None)
    made("single")
    for name in ("rows", "brief"):
        for found, one in zip(reports[name], reports["single"], strict=True):
            assert (found.newton, found.solved) == (one.newton, one.solved)
            assert 0.0 < found.solid_residual < 1e-12, name
    single, rows, parts = (read_history(tmp_path / name / "history.h5") for name in ("single", "rows", "parts"))
    largest = max(np.abs(values).max() for name, values in single.items() if name.startswith("energy/"))
    assert np.abs(rows["energy/residual"]).max() < 1e-10 * largest
    for name in ("kinetic", "radiated", "damping", "friction", "work_boundaries", "work_incident"):
        assert np.abs(single[f"energy/{name}"]).max() > 1e-6 * largest, name  # all of them act
    kept = read_arrays(tmp_path / "single" / "checkpoint.h5")
    for name in ("rows", "mixed", "brief"):
        assert_alike(tmp_path / "single", tmp_path / name, 1e-13)
        found = read_arrays(tmp_path / name / "checkpoint.h5")
        for key in ("friction", "sections/record", "sections/blur"):
            assert np.abs(kept[key]).max() > 0.0, key
            assert found[key] == pytest.approx(kept[key], rel=1e-11, abs=1e-12 * np.abs(kept[key]).max()), key
    for name, values in rows.items():
        assert np.array_equal(values, parts[name], equal_nan=True), name
