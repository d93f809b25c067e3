"""(2.40) The state a run starts from: at rest in equilibrium, or moved away from it as the scene says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.elements import facet
from fracflow.errors import InputError
from fracflow.laws.base import HELD
from fracflow.mesh.agreement import on_root
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.facets import outer_besides
from fracflow.mesh.places import place_text
from fracflow.model.balance import static_balance
from fracflow.model.energy import close_initial_balance, dissipated, empty_balance, update_balance
from fracflow.model.energy_motion import Scheme
from fracflow.model.joints import implied_tractions
from fracflow.model.operators import Operators
from fracflow.model.properties import body_force, initial_pressure, initial_stress, resting_pressure
from fracflow.model.setup import Model
from fracflow.model.solid import nodal_force
from fracflow.model.state import Forces, Motion, Sections, State
from fracflow.scene.materials import InitialMotion
from fracflow.scene.scene import Scene

EQUILIBRIUM = 1e-9  # of the natural force of a joint
ANYTHING = 1e30  # times the natural force: more than any joint has


def refuse_imbalance(model: Model) -> None:
    """Refuse an initial state out of balance; take up in the rock what two rules of integration differ by.

    Under a stress that changes with depth the joints' rule and the exact integral over the rock beside them differ. The
    difference, gradient times length squared a node, is an error of the mesh and must not start a motion. The operator
    ``prestress`` changes by it, also in a run that is restarted. It also changes by the imbalance of fractures where the scene
    lets the rock carry it. A scene with a stage ``equilibrate`` is left as it is. Raises InputError, on every rank.
    Collective.
    """
    if model.scene.equilibrates:
        return
    ops = model.operators
    motion, sections, pressure = _unmoved(model)
    balance, allowed = imbalance(model, motion.displacement, sections.traction, pressure), _slack(model)
    destroy(motion, pressure)
    model.loads.standing().release(balance)
    bad = np.abs(balance.getArray()) > EQUILIBRIUM * ops.scales.force + np.abs(allowed.getArray())
    count = ops.blocks.comm.allreduce(int(bad.sum()))
    names = [*_names_at(ops, np.flatnonzero(bad)), *(_unnamed_at(model, np.flatnonzero(bad)) if count else ())]
    if not count and allowed.norm() > 0.0:
        ops.prestress.axpy(-1.0, balance)
    destroy(balance, allowed)
    if count:
        raise InputError(
            f"{model.scene.source}: initial state: out of balance at {count} unknowns,"
            f" at {', '.join(names) or 'nodes inside the rock'}: a side that"
            " carries initial stress needs a name, and a [[support]] in these directions, [[absorbing]], or a [[load]] with"
            ' traction = "initial-stress"; on a'
            " fracture the initial tractions must be those of initial_stress and fluid.initial_pressure, or"
            ' initial_stress.unbalanced = "carried"; a [body_force] must balance the'
            f" gradient of initial_stress{_uncarried(model.scene)}{_on_top(model.scene)};"
            " or let a first [[stage]] with kind = 'equilibrate' find the state that is"
        )


def _on_top(scene: Scene) -> str:
    """That loads in numbers do not belong to the initial state, where a scene has some."""
    given = any(load.traction != "initial-stress" for load in scene.load)
    return "; a [[load]] in numbers comes on top of the initial state, from the first step on" if given else ""


def _uncarried(scene: Scene) -> str:
    """The force that is missing to div sigma_0 + b = 0, of each rock."""
    given = scene.initial_stress
    xy, yy = (given.gradient.xy, given.gradient.yy) if given is not None else (0.0, 0.0)
    found = []
    for name in scene.rock:
        force = body_force(scene, name)
        for component, slope, value in (("xy", xy, force[0]), ("yy", yy, force[1])):
            if abs(slope - value) > EQUILIBRIUM * max(abs(slope), abs(value)):
                found.append(f"gradient.{component} = {slope:.6g}, but the weight of {name} needs {value:.6g}")
    return f" ({'; '.join(found)})" if found else ""


def equilibrium_state(model: Model) -> State:
    """The state before the first step, of a model whose imbalance was refused or taken up. Collective.

    Fractures past their strength keep their initial tractions. Only a scene with a stage ``equilibrate``, or one whose rock
    carries the imbalance, has any here.
    """
    ops, scene = model.operators, model.scene
    motion, sections, pressure = _unmoved(model)
    controls = {name: control.initial for name, control in scene.control.items()}
    holding, friction = _holding(model, motion, sections, pressure), np.zeros(len(ops.joints.weights))
    energy = empty_balance(ops.terms, ops.joints.dilate, scene.is_unbounded and scene.has_dynamics)
    state = State(0.0, motion, pressure, sections, holding, controls, energy, friction=friction)
    memory = {term.name: term.memory() for term in ops.terms if term.has_memory}
    state = replace(state, left={term.name: 0.0 for term in ops.terms if term.drains}, memory=memory)
    return state if scene.initial is None else _moved(model, state)


def _unmoved(model: Model) -> tuple[Motion, Sections, PETSc.Vec]:
    ops, layout = model.operators, model.operators.layout
    motion = Motion(layout.solid_vector(), layout.solid_vector(), layout.solid_vector())
    pressure = layout.flow_vector()
    if ops.flow is not None:
        pressure.setArray(initial_pressure(model.scene, ops.blocks.flow.points))
    sections = ops.joints.evaluate(ops.joints.strain(motion.displacement), ops.joints.initial_history(), HELD)
    return motion, sections, pressure


def _holding(model: Model, motion: Motion, sections: Sections, pressure: PETSc.Vec) -> Forces:
    """Forces that hold a start: reactions of the supports, and any force that the loads lack to balance. Collective."""
    layout = model.operators.layout
    load = imbalance(model, motion.displacement, sections.traction, pressure)
    support, initial = load.copy(), layout.solid_vector()
    model.loads.standing().release(load)
    support.axpy(-1.0, load)
    model.loads.initial_force(initial)
    load.axpy(1.0, initial)
    initial.destroy()
    return Forces(load, support, layout.flow_vector(), layout.flow_vector())


def _moved(model: Model, state: State) -> State:
    """The start that [initial] describes; its energy above that at rest counts as added at the start. Collective."""
    ops, initial = model.operators, model.scene.initial
    assert initial is not None
    motion = Motion(ops.layout.solid_vector(), ops.layout.solid_vector(), ops.layout.solid_vector())
    _spread(model, "displacement", motion.displacement)
    _spread(model, "velocity", motion.velocity)
    pressure = state.pressure.copy()
    if initial.pressure is not None:
        pressure.setArray(initial.pressure + resting_pressure(model.scene, ops.blocks.flow.points))
    sections = ops.joints.evaluate(ops.joints.strain(motion.displacement), ops.joints.initial_history())
    forces = _holding(model, motion, sections, pressure)
    new = replace(state, motion=motion, pressure=pressure, sections=sections, forces=forces)
    energy = update_balance(ops, state, replace(new, forces=state.forces), 0.0, Scheme(storage=False))
    friction = state.friction + dissipated(state.sections, sections)
    state.destroy()
    return replace(new, energy=close_initial_balance(energy), friction=friction)


def _spread(model: Model, key: str, result: PETSc.Vec) -> None:
    """Write a displacement or velocity that is affine in each rock into the unknowns."""
    ops, initial = model.operators, model.scene.initial
    assert initial is not None
    block, dim = ops.blocks.solid, ops.blocks.sizes.dim
    first, last = result.getOwnershipRange()
    local = result.getArray()

    def write(numbers: np.ndarray, values: Floats) -> None:
        here = (numbers >= first) & (numbers < last)
        local[numbers[here] - first] = values[here]

    for number, name in enumerate(block.rocks):
        given = initial.rock.get(name, initial)
        nodes = np.unique(block.cells[block.cell_rock == number])
        nodes = nodes[(nodes >= 0)]
        nodes = nodes[block.body[nodes] < 0]
        write(block.unknown[nodes], _affine(given, key, block.points[nodes]))
        bodies = np.flatnonzero(block.body_rock == number)
        write(block.body_unknown[bodies, :dim], _affine(given, key, block.body_center[bodies]))
        gradient = np.array(getattr(given, f"{key}_gradient") or np.zeros((dim, dim)))
        spin = 0.5 * (gradient[1, 0] - gradient[0, 1])
        write(block.body_unknown[bodies, dim], np.full(len(bodies), spin))


def _affine(given: InitialMotion, key: str, points: Floats) -> Floats:
    base, gradient = getattr(given, key), getattr(given, f"{key}_gradient")
    value = np.zeros(points.shape) if base is None else np.broadcast_to(np.array(base), points.shape)
    return np.asarray(value if gradient is None else value + points @ np.array(gradient).T)


def imbalance(model: Model, displacement: PETSc.Vec, traction: Floats, pressure: PETSc.Vec) -> PETSc.Vec:
    """Inner forces of tractions (s, dim) less the initial loads, on all unknowns. The caller destroys it. Collective."""
    initial = model.operators.layout.solid_vector()
    model.loads.initial_force(initial)
    balance = static_balance(model.operators, displacement, traction, pressure, initial)
    initial.destroy()
    return balance


def _slack(model: Model) -> PETSc.Vec:
    """Difference that two rules of integration may have on each unknown. Collective.

    Over a joint of length L tractions linear between t_1 and t_2 give each end L (2 t_1 + t_2)/6, and L t_1/2 by the
    nodal rule: |t_2 - t_1| L/6 apart at most, likewise the pressures. A joint whose given tractions are not those that
    stress and pressure imply has no slack, unless the scene lets the rock carry what is missing.
    """
    ops, scene = model.operators, model.scene
    joints, dim, natural = ops.blocks.joints, ops.blocks.sizes.dim, ops.joints.natural
    ends = ops.blocks.solid.points[joints.bottom]
    frame, length = facet.frame(ends)
    stress = initial_stress(scene, ends)[..., :dim, :dim]
    change = np.abs(np.einsum("jki,ji->jk", stress[:, 1] - stress[:, 0], frame[:, -1]))
    change += np.abs(np.diff(initial_pressure(scene, ends), axis=1) * frame[:, -1])
    off = np.abs(ops.joints.initial - implied_tractions(ops.blocks, scene, natural))
    most = off.reshape(len(length), len(natural) * dim).max(axis=1, initial=0.0)
    is_implied = most <= EQUILIBRIUM * ops.scales.pressure
    faces, slack = np.concatenate([joints.bottom, joints.top], axis=1), change * (is_implied * length)[:, None] / 6.0
    if scene.carries_unbalanced:
        slack = np.full_like(slack, ANYTHING * ops.scales.force)
    share = np.broadcast_to(slack[:, None], (*faces.shape, dim))
    return nodal_force(ops.blocks, faces, share.copy(), ops.expand)


def _nodes_of(ops: Operators, bad: np.ndarray) -> Ints:
    """Nodes (n,) of this rank that have the given unknowns."""
    block, starts = ops.blocks.solid, ops.blocks.solid.unknown_starts[ops.blocks.comm.rank]
    return np.flatnonzero(np.isin(block.unknown[: block.owned] - starts, bad).any(axis=1))


def _unnamed_at(model: Model, bad: np.ndarray) -> tuple[str, ...]:
    """Outer curves without a name, and a place on them, where given unknowns of this rank lie on any. Collective."""
    block, comm, joints = model.operators.blocks.solid, model.operators.blocks.comm, model.operators.blocks.joints
    named = [block.side_facets, joints.bottom, joints.top]
    nodes = np.setdiff1d(_nodes_of(model.operators, bad), np.concatenate([facets.ravel() for facets in named]))
    spots = np.concatenate(comm.allgather(block.points[nodes[:1]]))
    is_on = np.zeros(len(block.points) + 1, dtype=bool)  # the last is padding
    for spot in spots:
        is_on[:-1] |= (block.points == spot).all(axis=1)
    numbers = np.append(block.node_ids, -1)
    cells, *known = (numbers[each[is_on[each].any(axis=1)]] for each in (block.cells, *named))
    here = is_on[:-1]
    around = comm.gather((cells, np.concatenate(known), block.node_ids[here], block.points[here]), root=0)
    ends = np.concatenate([block.points.min(axis=0, initial=np.inf), -block.points.max(axis=0, initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, ends, MPI.MIN)
    extent = float((-ends[len(ends) // 2 :] - ends[: len(ends) // 2]).max())

    def unnamed() -> tuple[str, ...]:
        if around is None or not len(spots):
            return ()
        cells, known, node, points = (np.concatenate(each) for each in zip(*around, strict=True))
        outer = points[np.isin(node, outer_besides(cells, known))]  # a facet at a place has all of its cells here
        on = spots[(spots[:, None] == outer).all(axis=2).any(axis=1)]
        return tuple(f"outer curves without a name, as at {place_text(at, extent)}" for at in on[:1, :2])

    found: tuple[str, ...] = comm.bcast(on_root(comm, unnamed), root=0)
    return found


def _names_at(ops: Operators, bad: np.ndarray) -> list[str]:
    """Sides, with what they lack in brackets, and fractures that have facets all of whose nodes lack balance. Collective.

    The ends of a side are those of other sides, too, which may lack nothing. Without such facets all at the nodes are named.

    bad  (n,) unknowns of this rank that lack balance
    """
    block, joints, layout = ops.blocks.solid, ops.blocks.joints, ops.layout
    kinds = [(block.side_facets, [block.sides[s] for s in block.side_of])]
    kinds += [(wall, [joints.fractures[f] for f in joints.fracture]) for wall in (joints.bottom, joints.top)]
    numbers = [block.unknown[facets][..., : ops.blocks.sizes.dim] for facets, _ in kinds]
    numbers = [np.where(each < 0, -1, layout.solid_numbers(each)) for each in numbers]  # -1 on rigid rock
    lacking = layout.marked(bad, bad[:0], numbers)
    whole, touched = set[tuple[str, str]](), set[tuple[str, str]]()
    for number, (_, names) in enumerate(kinds):
        for axis, lacks in zip("xyz", np.moveaxis(np.isin(numbers[number], lacking), -1, 0), strict=False):
            told = axis if number == 0 else ""
            whole |= {(names[k], told) for k in np.flatnonzero(lacks.all(axis=1))}
            touched |= {(names[k], told) for k in np.flatnonzero(lacks.any(axis=1))}
    whole, touched = (set().union(*layout.comm.allgather(each)) for each in (whole, touched))
    found = whole or touched
    axes = {name: ", ".join(sorted(axis for at, axis in found if at == name and axis)) for name, _ in found}
    return sorted(f"{name} ({along})" if along else name for name, along in axes.items())
