"""(4.8) The joint Jacobian against differences of the residual, on a network with a crossing, a T and an arc."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from physics.test_flow_with_slip import OpensBySlip

from fracflow._petsc import MPI, PETSc
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.network import FlowNetwork, StepBegin
from fracflow.errors import InputError, NotConverged
from fracflow.integrators import BDF2, HHT, BackwardEuler, GeneralisedAlpha, Newmark, Steady, Trapezoid
from fracflow.laws import FLOW_LAWS
from fracflow.model.compressibility import rate_by
from fracflow.model.state import PreviousStep
from fracflow.model.terms.term import Leaving, Term, TermStep
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.newton import Newton
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest, StepRule


@pytest.mark.parametrize("model", ["default", "report"])
@pytest.mark.parametrize("stepper", [Steady(), BackwardEuler(), Newmark()], ids=["steady", "backward-euler", "newmark"])
def test_jacobian_is_the_derivative(stepper, model):
    overrides = [f"model={model}", "method.tangent=consistent"]
    scene = load("meshes/crossings/scene.toml", overrides)
    prepared = prepare(scene, MPI.COMM_WORLD)
    state = equilibrium_state(prepared)
    problem = StepProblem(
        prepared.operators,
        state,
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads),
        StepRule(stepper.alphas(1e-3)),
    )
    check_around(scene, problem, np.random.default_rng(7 + MPI.COMM_WORLD.rank))
    problem.destroy()


@pytest.mark.parametrize(
    "stepper", [BackwardEuler(), BDF2(), Trapezoid(), Newmark(0.3, 0.6)], ids=lambda s: type(s).__name__
)
def test_jacobian_of_a_compressible_fluid(stepper):
    """C(u) p' with both its derivatives, of a fluid that gives far more than the walls, after rates of a step before."""
    scene = load("meshes/crossings/scene.toml", ["fluid.compressibility=1e-6", "method.tangent=consistent"])
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, random = equilibrium_state(prepared), np.random.default_rng(11 + MPI.COMM_WORLD.rank)
    rate, mean = state.pressure.duplicate(), state.pressure.duplicate()
    for vector in (rate, mean):
        vector.setArray(1e-5 * random.standard_normal(vector.getLocalSize()))
    state = replace(state, uptake=rate, previous_step=PreviousStep(2e-3, None, mean))
    alphas = stepper.alphas(1e-3, 2e-3)
    problem = StepProblem(
        prepared.operators, state, StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads), StepRule(alphas)
    )
    check_around(scene, problem, random)
    problem.destroy()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("exponent", [400.0, 1e6])
def test_a_trial_under_absurd_pressure_is_refused_by_name(exponent):
    """Newton's method may ask for it: densities overflow there, or their squares do."""
    scene = load("meshes/crossings/scene.toml", ["fluid.compressibility=1e-6"])
    prepared = prepare(scene, MPI.COMM_WORLD)
    request = StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads)
    problem = StepProblem(
        prepared.operators, equilibrium_state(prepared), request, StepRule(BackwardEuler().alphas(1e-3))
    )
    problem.pressure.set(exponent * 1e6)
    with pytest.raises(NotConverged, match=r"/compressibility, which must be at most 100"):
        problem.evaluate()
    problem.destroy()


def test_jacobian_of_a_conductance_that_knows_slip(monkeypatch):
    """Walls move by random amounts: slips of either sign change the flow, along joints that are turned too."""
    monkeypatch.setitem(FLOW_LAWS, "exact", OpensBySlip)
    scene = load("meshes/crossings/scene.toml", ["method.tangent=consistent", "method.conductance=exact"])
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, random = equilibrium_state(prepared), np.random.default_rng(5 + MPI.COMM_WORLD.rank)
    problem = StepProblem(
        prepared.operators,
        state,
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads),
        StepRule(Newmark().alphas(1e-3)),
    )
    check_around(scene, problem, random)
    assert problem.conduction.by_slip is not None
    problem.destroy()


def test_jacobian_of_rough_walls_that_ride_up():
    """Slip opens joints, hydraulic apertures follow by half, and conductances grow with plastic slip; all joints slide."""
    table = {
        "dilation_angle_deg": 10, "dilation_distance": "'1 m'", "hydraulic_opening_ratio": 0.5, "slip_conductance": 5,
        "slip_conductance_distance": "'1 mm'",
    }  # fmt: skip
    sets = [f"fracture.default.{key}={value}" for key, value in table.items()]
    scene = load("meshes/crossings/scene.toml", ["method.tangent=consistent", *sets])
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, random = equilibrium_state(prepared), np.random.default_rng(5 + MPI.COMM_WORLD.rank)
    problem = StepProblem(
        prepared.operators,
        state,
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads),
        StepRule(Newmark().alphas(1e-3)),
    )
    way = np.ones((len(state.sections.strain), 1))
    problem.trial_status = tuple({**past, "sliding": way[: len(past["sliding"])]} for past in state.sections.history)
    check_around(scene, problem, random)
    assert problem.sections.is_sliding.any() and problem.conduction.by_slip.any()
    problem.destroy()


def test_jacobian_of_given_conductances_beside_walls_that_close():
    """Conductances of a scene do not change with the walls; those pressed into each other hold no fluid that compresses."""
    sets = ["fluid.compressibility=1e-6", "fracture.default.conductance=1e-9", "method.tangent=consistent"]
    scene = load("meshes/crossings/scene.toml", sets)
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, random = equilibrium_state(prepared), np.random.default_rng(3 + MPI.COMM_WORLD.rank)
    problem = StepProblem(
        prepared.operators,
        state,
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads),
        StepRule(BackwardEuler().alphas(1e-3)),
    )
    check_around(scene, problem, random)
    assert not problem.conduction.slope.any()
    problem.destroy()
    network = prepared.operators.network
    closed = network.compress(np.minimum(-network.aperture, -1e-9), np.full_like(network.aperture, 1e5))
    assert not (closed.held.any() or closed.weight.any() or closed.slope.any())


class Seeps(Term):
    """Fluid leaves with the square of its pressure over some size, and with the aperture, as fast as walls sweep it."""

    name = entry = "seeps"
    drains = True

    def __init__(self, size, speed):
        self.size, self.speed = size, speed

    def leaving(self, pressure, aperture, step):
        share = pressure / self.size
        return Leaving(*(self.speed * np.array([share**2 * aperture, 2.0 * share / self.size * aperture, share**2])))


def test_jacobian_of_what_leaves_by_pressure_and_aperture():
    scene = load("meshes/crossings/scene.toml", ["method.tangent=consistent"])
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, random = equilibrium_state(prepared), np.random.default_rng(3 + MPI.COMM_WORLD.rank)
    before, flow = prepared.operators, prepared.operators.flow
    pressure, seeps = before.scales.pressure, Seeps(before.scales.pressure, 1e3 * before.scales.length)
    resting, resting_end = flow.resting.copy(), flow.resting_end + 0.3 * pressure  # as deep down
    resting.shift(0.3 * pressure)
    flow = replace(flow, terms=(seeps,), resting=resting, resting_end=resting_end)
    operators = replace(before, flow=flow)
    problem = StepProblem(
        operators,
        state,
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads),
        StepRule(BackwardEuler().alphas(1e-3)),
    )
    check_around(scene, problem, random)
    rate, same = rate_by(operators, seeps, state), operators.layout.flow_vector()
    aperture = flow.apertures(state.motion.displacement, operators.joints.openings(state.sections.strain))
    flow.taken_up(flow.leaving(flow.driving(state.pressure), aperture, problem.term_step()).rate, same)
    assert rate.norm() > 0.0 and (rate - same).norm() <= 1e-14 * rate.norm(), "counted as it is solved for"
    sizes = [np.abs(values).max(initial=0.0) for values in problem.conduction.leaving]
    assert all(MPI.COMM_WORLD.allreduce(float(size), op=MPI.MAX) > 0.0 for size in sizes)
    problem.destroy()


def sealed(model, state, alphas):
    """The network, and loads without a pressure anywhere, for a step from a state; what the rows of its parts are."""
    network = FlowNetwork(model)
    network.update(state)
    loads = replace(model.loads, pressures=())
    return network, network.close(loads, alphas.a1 > 0.0, StepBegin(state, alphas))


@pytest.mark.parametrize(
    "stepper, firm",
    [(Steady(), 0.0), (Newmark(0.3, 0.6), 0.0), (Newmark(0.3, 0.6), 0.3)],
    ids=["keeps", "sums", "passes"],
)
def test_jacobian_where_a_part_keeps_or_sums_its_fluid(stepper, firm, monkeypatch):
    """A compressible fluid that nothing drains: a row with the walls and the pressures of the whole part.

    In a steady step it keeps the fluid; in one that stores next to nothing it is the sum of all balances, with what leaves.
    Flow from one such part to another is in both sums.
    """
    monkeypatch.setattr("fracflow.advance.network.FAINT", np.inf)
    monkeypatch.setattr("fracflow.advance.network.FIRM", firm)
    scene = load("meshes/crossings/scene.toml", ["fluid.compressibility=1e-6", "method.tangent=consistent"])
    prepared, random = prepare(scene, MPI.COMM_WORLD), np.random.default_rng(12 + MPI.COMM_WORLD.rank)
    alphas, before = stepper.alphas(1e-3), prepared.operators
    if alphas.a1 > 0.0:  # it loses fluid too, with pressures and apertures
        seeps = Seeps(before.scales.pressure, 1e3 * before.scales.length)
        prepared = replace(prepared, operators=replace(before, flow=replace(before.flow, terms=(seeps,))))
    operators, state = prepared.operators, equilibrium_state(prepared)
    network, closed = sealed(prepared, state, alphas)
    assert {closure.by for closure in closed.closures} == (set() if alphas.a1 > 0.0 else {"fluid"})
    assert (closed.summed is None) == (alphas.a1 == 0.0)
    joining = 0 if closed.summed is None else int(closed.summed.is_joining.sum())
    assert (MPI.COMM_WORLD.allreduce(joining) > 0) == (firm > 0.0)
    problem = StepProblem(operators, state, StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, closed), StepRule(alphas))
    check_around(scene, problem, random)
    problem.destroy()
    network.destroy()


@pytest.mark.parametrize(
    "stepper", [Newmark(0.3, 0.6), HHT(-0.3), GeneralisedAlpha(0.0)], ids=lambda s: type(s).__name__
)
def test_jacobian_of_weighed_balances_between_absorbing_sides(stepper):
    """M with its weight and C beside it: a step of the size that makes both matter, from a state that moves."""
    overrides = ["support=[]", "absorbing=[{on = ['west', 'east', 'south', 'north']}]", "method.tangent=consistent"]
    scene = load("meshes/crossings/scene.toml", overrides)
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, random = equilibrium_state(prepared), np.random.default_rng(13 + MPI.COMM_WORLD.rank)
    for vector, size in ((state.motion.velocity, 0.1), (state.motion.acceleration, 1e2)):
        vector.setArray(size * random.standard_normal(vector.getLocalSize()))
    alphas, loads = stepper.alphas(5e-4), prepared.loads
    problem = StepProblem(
        prepared.operators, state, StepRequest(5e-4, 5e-4, {"pumping": 1e-5}, loads), StepRule(alphas, (5e-4, 5e-4))
    )
    check_around(scene, problem, random)
    damps, weighs = (alphas.a1 * prepared.operators.damping.norm(), alphas.mass * prepared.operators.mass.norm())
    assert 1e-2 < damps / weighs < 1e2
    problem.destroy()


def check_around(scene, problem, random):
    """Displacements around a tenth of f_n0/k_n0 and pressures around a tenth of f_n0; the prescribed stays."""
    matrix = JoinedMatrix(problem.operators, problem.loads)
    newton = Newton(scene, matrix, "monolithic")
    newton.problem = problem
    newton._pack(problem)
    unknowns = newton.unknowns.copy()
    unknowns.setArray(unknowns.getArray() + 1e-1 * random.standard_normal(unknowns.getLocalSize()))
    newton._unpack(unknowns)
    check_derivative(newton, random)
    newton.destroy()
    matrix.destroy()


def check_derivative(newton, random):
    """The Jacobian times a random direction against a central difference of both balances, at the trial of ``newton``."""
    problem, matrix, layout = newton.problem, newton.matrix, newton.matrix.layout
    point, step, plus, minus, product = (layout.joined_vector() for _ in range(5))
    newton._pack(problem)
    newton.unknowns.copy(point)
    local = random.standard_normal(step.getLocalSize())
    here = layout.start + np.arange(step.getLocalSize())
    local[np.isin(here, matrix.fixed)] = 0.0
    step.setArray(local)
    newton._function(newton.snes, point, product)
    newton._jacobian(newton.snes, point, matrix.matrix, matrix.matrix)
    matrix.matrix.mult(step, product)
    h = 1e-6
    newton._function(newton.snes, point + h * step, plus)
    newton._function(newton.snes, point - h * step, minus)
    difference = (plus - minus) * (0.5 / h)
    assert product.norm() > 0.0
    middle = layout.solid_count
    for part in (slice(None, middle), slice(middle, None)):
        wrong = np.abs(difference.getArray()[part] - product.getArray()[part]).max(initial=0.0)
        size = layout.comm.allreduce(np.abs(product.getArray()[part]).max(initial=0.0), op=MPI.MAX)
        assert layout.comm.allreduce(wrong, op=MPI.MAX) <= 2e-7 * size
    check_refilled(newton, point)
    newton._function(newton.snes, point, product)


def check_refilled(newton, point):
    """A matrix that has seen another state equals one that is filled for the first time: nothing of that state is left."""
    filled, once, balances = (
        newton.matrix,
        JoinedMatrix(newton.matrix.operators, newton.problem.loads),
        point.duplicate(),
    )
    for matrix, share in ((filled, 1.0 + 1e-3), (filled, 1.0), (once, 1.0)):
        newton.matrix = matrix
        newton._function(newton.snes, share * point, balances)
        newton._jacobian(newton.snes, share * point, matrix.matrix, matrix.matrix)
    newton.matrix = filled
    found, wanted = (each.matrix.getValuesCSR()[2] for each in (filled, once))
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14 * np.abs(wanted).max(initial=0.0))
    once.destroy()


def test_few_rows_at_once_make_the_same_matrix(monkeypatch):
    """Pattern, values and what stands without the joints; afterwards the state is in the matrix again."""
    model = prepare(load("meshes/crossings/scene.toml"), MPI.COMM_WORLD)
    request = StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, model.loads)
    problem = StepProblem(model.operators, equilibrium_state(model), request, StepRule(Newmark().alphas(1e-3)))
    problem.evaluate()
    found = []
    for rows in (10**6, 7):
        monkeypatch.setattr("fracflow.solve.pattern.ROWS_AT_ONCE", rows)
        matrix = JoinedMatrix(model.operators, model.loads)
        filling = problem.alphas, problem.sections.tangent, problem.conduction, problem.flow_scale()
        matrix.fill(*filling)
        before = matrix.matrix.getValuesCSR()
        with matrix.standing() as stands:
            alone = stands.getValuesCSR()
        found.append((*before, alone[2], *matrix.matrix.getValuesCSR()))
        matrix.destroy()
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)
    assert all(np.array_equal(one, other) for one, other in zip(found[0][:3], found[0][4:], strict=True))
    changes = int((found[0][2] != found[0][3]).sum())
    assert model.operators.layout.comm.allreduce(changes) > 0
    problem.destroy()


@pytest.mark.parametrize("stepper", [Steady(), BackwardEuler(), Newmark()], ids=["steady", "backward-euler", "newmark"])
def test_jacobian_where_joints_open_slide_and_pinch(stepper):
    """The same with sections open, sliding, and narrower than the minimum hydraulic aperture, all at once."""
    stiff = ("normal_stiffness=200 GPa/m", "shear_stiffness=100 GPa/m", "minimum_hydraulic_aperture=0.25 mm")
    overrides = [f"fracture.default.{key}" for key in stiff]
    scene = load("meshes/crossings/scene.toml", overrides)
    prepared = prepare(scene, MPI.COMM_WORLD)
    state, comm = equilibrium_state(prepared), prepared.operators.layout.comm
    problem = StepProblem(
        prepared.operators,
        state,
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, prepared.loads),
        StepRule(stepper.alphas(1e-3)),
    )
    matrix = JoinedMatrix(prepared.operators, prepared.loads)
    newton = Newton(scene, matrix, "monolithic")
    newton.problem, newton._is_start = problem, False
    random = np.random.default_rng(11 + comm.rank)
    # two walls part or close by 0.28 mm at most: none is crushed, which 0.3 mm would do
    problem.pressure.setArray(1e6 + 1e6 * random.random(prepared.operators.layout.flow_count))
    problem.move(random.uniform(-1e-4, 1e-4, prepared.operators.layout.solid_count))
    problem.evaluate()
    problem.change_statuses()
    check_derivative(newton, random)
    flow, sections = prepared.operators.flow, problem.sections
    is_pinched = flow.apertures(problem.displacement) < flow.least
    counts = [sections.is_open.sum(), sections.is_sliding.sum(), is_pinched.sum(), (~is_pinched).sum()]
    assert comm.allreduce(np.array(counts)).min() >= 5, counts
    newton.destroy()
    matrix.destroy()
    problem.destroy()


def test_flow_volume_balance():
    """(3.18) Summed over the network, the walls' volume rate is the length integral of the opening rate, to round-off."""
    scene = load("meshes/crossings/scene.toml")
    prepared = prepare(scene, MPI.COMM_WORLD)
    ops = prepared.operators
    assert ops.flow is not None
    speed, rates = ops.layout.solid_vector(), ops.layout.flow_vector()
    speed.setArray(np.random.default_rng(3 + ops.layout.comm.rank).standard_normal(speed.getLocalSize()))
    ops.flow.storage_coupling.multTranspose(speed, rates)
    ends = ops.flow.opening.createVecLeft()
    ops.flow.opening.mult(speed, ends)
    walls = (ends.getArray().reshape(-1, 2).sum(axis=1) * ops.flow.length / 2).sum()
    assert np.isclose(rates.sum(), ops.layout.comm.allreduce(walls), rtol=1e-12)
    pressure, out = ops.layout.flow_vector(), ops.layout.flow_vector()
    pressure.setArray(np.random.default_rng(4 + ops.layout.comm.rank).standard_normal(pressure.getLocalSize()))
    conduction = ops.flow.conduct(
        speed * 0.0, pressure, ops.joints.walls(equilibrium_state(prepared).sections, ops.flow.law), TermStep()
    )
    ops.flow.outflow(conduction, out)
    size = ops.layout.comm.allreduce(np.abs(out.getArray()).sum())
    assert abs(out.sum()) <= 1e-13 * size  # what leaves one node enters another


def test_default_pair_is_a_transpose_and_the_reports_is_not():
    """Design: one matrix in both; the report's (2.37) with (3.16) are not transposes of one another."""
    for model, same in (("default", True), ("report", False)):
        ops = prepare(load("meshes/crossings/scene.toml", [f"model={model}"]), MPI.COMM_WORLD).operators
        assert ops.flow is not None
        apart = ops.flow.pressure_load.copy()
        apart.axpy(-1.0, ops.flow.storage_coupling, ops.flow.pressure_load.__class__.Structure.DIFFERENT)
        assert (apart.norm() == 0.0) is same


def test_rigid_motion_opens_nothing():
    """Translation and (linearised) rotation of the whole body: no joint strain, no force of the rock."""
    ops = prepare(load("meshes/crossings/scene.toml"), MPI.COMM_WORLD).operators
    block = ops.blocks.solid
    points = block.points[: block.owned]
    for motion in (
        np.tile([1.0, 0.0], (len(points), 1)),
        np.tile([0.0, 1.0], (len(points), 1)),
        points[:, ::-1] * [-1, 1],
    ):
        u, force = ops.layout.solid_vector(), ops.layout.solid_vector()
        u.setArray(motion.ravel())
        assert np.abs(ops.joints.strain(u)).max(initial=0.0) <= 1e-12 * np.abs(motion).max(initial=1.0) * 100
        ops.stiffness.mult(u, force)
        diagonal = ops.stiffness.getDiagonal().max()[1]
        assert force.norm(3) <= 1e-12 * diagonal * 200


def test_a_collection_of_garbage_leaves_the_solver_its_test():
    """Handles in cycles, as tracebacks of failed steps leave them, are no owners of what PETSc calls back."""
    scene = load("meshes/report_5_5/scene.toml")
    model = prepare(scene, MPI.COMM_WORLD)
    matrix = JoinedMatrix(model.operators, model.loads)
    newton = Newton(scene, matrix, "monolithic")
    cycle: list = [newton.snes.getKSP(), newton.snes]
    cycle.append(cycle)
    del cycle
    gc.collect()
    assert newton.snes.getKSP().getAttr("__converged__") is not None
    assert newton.snes.getAttr("__function__") is not None
    newton.destroy()
    matrix.destroy()


@pytest.mark.parametrize("refused", ["balances", "step"])
def test_a_refusal_is_raised_once_snes_has_ended(refused, monkeypatch):
    """Raised within, it would leave a vector locked in newer PETSc; here the next solve of the same step converges."""
    scene = load("meshes/crossings/scene.toml")
    model = prepare(scene, MPI.COMM_WORLD)
    state = equilibrium_state(model)
    request = StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, model.loads)
    problem = StepProblem(model.operators, state, request, StepRule(BackwardEuler().alphas(1e-3)))
    matrix = JoinedMatrix(model.operators, model.loads)
    newton = Newton(scene, matrix, "whole-lu")

    def refuse(*_, **__):
        raise NotConverged("as it was told")

    with monkeypatch.context() as patch, pytest.raises(NotConverged, match="as it was told"):
        if refused == "balances":
            patch.setattr(StepProblem, "evaluate", refuse)
        else:
            patch.setattr("fracflow.solve.newton.check_step", refuse)
        newton.solve(problem)
    assert newton.snes.getConvergedReason() < 0
    assert newton.solve(problem).newton > 0
    problem.destroy()
    newton.destroy()
    matrix.destroy()


def test_types_of_the_command_line_are_those_of_all_matrices_and_vectors(comm):
    options, scene = PETSc.Options(), load("meshes/crossings/scene.toml")
    stiff = prepare(scene, comm).operators.stiffness
    try:
        options["mat_type"], options["vec_type"] = "aijperm", "standard"
        model = prepare(scene, comm)
        ops, matrix = model.operators, JoinedMatrix(model.operators, model.loads)
        rank = "seq" if comm.size == 1 else "mpi"
        assert {each.getType() for each in (ops.stiffness, ops.mass, matrix.matrix)} == {f"{rank}aijperm"}
        assert ops.layout.joined_vector().getType() == rank
        assert ops.stiffness.norm() == pytest.approx(stiff.norm(), rel=1e-14)
        matrix.destroy()
        for name, kind, why in (("mat_type", "baij", "family aij"), ("vec_type", "nothing", "Unknown vector type")):
            options[name] = kind
            with pytest.raises(InputError, match=f"PETSc option -{name} {kind}: .*{why}"):
                prepare(scene, comm)
            options.delValue(name)
    finally:
        options.delValue("mat_type")
        options.delValue("vec_type")
