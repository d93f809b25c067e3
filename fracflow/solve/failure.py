"""Messages on a step that did not converge: place, methods that were tried, remedy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.errors import Unsolved
from fracflow.laws.base import Bools
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.places import extent_of, place_text
from fracflow.model.properties import on_joints
from fracflow.remarks import counted
from fracflow.scene.scene import Scene
from fracflow.solve.fixed_point.contraction import worst_fracture
from fracflow.solve.floating import Floating
from fracflow.solve.linear import check_solution, true_residual
from fracflow.solve.problem import StepProblem
from fracflow.solve.residual import over_ranks
from fracflow.solve.stiffness import NEWTON_METHODS

MOST_PLACES = 5
SAME = 1e-6  # share of a motion that is none


WHY = {
    "DIVERGED_MAX_IT": "all that accuracy.max_iterations allows",
    "DIVERGED_FNORM_NAN": "a balance is not a number",
    "DIVERGED_LINEAR_SOLVE": "the linear solver did not converge",
    "DIVERGED_LINE_SEARCH": "no fraction of its step lowers the residual",
    "DIVERGED_FUNCTION_DOMAIN": "the joint laws have no response there",
    "DIVERGED_FUNCTION_COUNT": "all evaluations that PETSc's options allow",
    "DIVERGED_DTOL": "the residual grew beyond what PETSc's options allow",
}
CIRCLES = "the status of sections cycles between sticking and sliding"
FLOATING = "floating"  # kind of a failure
WHY_LINEAR = {
    "DIVERGED_MAX_IT": "all that PETSc's options allow",
    "DIVERGED_DTOL": "its residual grew beyond what PETSc's options allow",
    "DIVERGED_BREAKDOWN": "its basis broke down",
    "DIVERGED_NANORINF": "its residual is not a number",
    "DIVERGED_PCSETUP_FAILED": "its preconditioner could not be made",
}
"""PETSc's reasons in words."""


def why_stopped(snes: PETSc.SNES, is_short: bool = False) -> str:
    """Why Newton's method has stopped short, and its linear solver where that is why, in words.

    is_short  the step may be shorter, and is given fewer iterations
    """
    reasons, solver = PETSc.SNES.ConvergedReason, snes.getKSP()
    if is_short and snes.getConvergedReason() == reasons.DIVERGED_MAX_IT:
        return "the limit of a step that may be shorter"
    why = _in_words(snes.getConvergedReason(), reasons, WHY)
    if snes.getConvergedReason() != reasons.DIVERGED_LINEAR_SOLVE or solver.getConvergedReason() >= 0:
        return why
    how = _in_words(solver.getConvergedReason(), PETSc.KSP.ConvergedReason, WHY_LINEAR)
    return f"{why} in {solver.getIterationNumber()} iterations: {how}"


def _in_words(reason: int, reasons: type, words: Mapping[str, str]) -> str:
    names = [name for name, value in vars(reasons).items() if value == reason]
    known = [words[name] for name in names if name in words]
    return (known or [name.lower().replace("_", " ") for name in names] or ["for a reason that PETSc does not name"])[0]


def describe_failure(
    scene: Scene,
    problem: StepProblem,
    restless: Bools,
    flipped: Bools,
    why: str,
    iterations: int,
    loose: Floating | None = None,
) -> str:
    """The message of a SolveError, the same on every rank. Collective.

    restless, flipped  (s,) sections that last began or ended to slide, and to be open
    why                it stopped, in words
    loose              blocks that nothing else holds
    """
    blocks, accuracy, name = problem.operators.blocks, scene.accuracy, scene.method.newton
    weakness, start = NEWTON_METHODS[name].weakness, problem.state.sections
    slipped = fractures_of(blocks, start.is_sliding | start.inelastic.any(axis=1)) if weakness else ""
    cycling = [
        f"{counted(count, 'section')} keep{'s' * (count == 1)} changing between {between}: {places}; "
        for chosen, between in ((restless, "sticking and sliding"), (flipped, "open and closed"))
        if not slipped
        and (count := blocks.comm.allreduce(int(chosen.sum())))
        and (places := places_of(blocks, chosen, problem.operators.joints.natural))
    ]
    what = "Newton" if name == "newton" else f'method.newton = "{name}"'
    remedy = "try a smaller time_step" if name == "newton" else 'set method.newton = "newton"'
    if not slipped and why == WHY["DIVERGED_MAX_IT"]:
        remedy += ", or raise accuracy.max_iterations"
    if cycling and scene.method.line_search == "none":
        remedy += ', or set method.line_search = "energy"'
    if cycling and scene.method.overshoot != "hold":
        remedy += ', or set method.overshoot = "hold"'
    if cycling and problem.alphas.a0 == 0.0:
        remedy += ', or let them move in a stage of kind = "dynamic"'
    where = "".join(cycling)
    where += f"nothing else holds {_block(loose, _loose(loose)[0])}; " if cycling and loose is not None else ""
    where += f"{weakness} (slipped before: {slipped}); " if slipped else ""
    in_solid, in_flow = problem.residual.solid, max(problem.residual.flow, problem.residual.at_nodes)
    why = why if np.isfinite(in_solid) else WHY["DIVERGED_FNORM_NAN"]
    wanted = f"relative residual of the solid {in_solid:.2e}, of the flow {in_flow:.2e}"
    flow = np.abs(problem.flow_balance.getArray(readonly=True))
    solid = np.abs(problem.solid_balance.getArray(readonly=True))
    worse = in_solid > in_flow
    place = place_of(problem, np.where(worse, solid, 0.0), np.where(worse, 0.0, flow))
    wanted += f", wanted {accuracy.residual:.0e}, worst {place}"
    if why == CIRCLES:
        wanted = "the balances hold with each status tried, but none of these agrees with the solution"
    elif scene.method.newton_test == "out-of-balance" and accuracy.out_of_balance is not None:
        wanted = f"out-of-balance force {problem.residual.out_of_balance:.2e}, wanted {accuracy.out_of_balance:.0e}"
    return (
        f"time {problem.time:.6g}: {what} did not converge in {iterations} iterations"
        f" ({why}): {where}{wanted}; {remedy}"
    )


def check_step(solver: PETSc.KSP, step: PETSc.Vec, balance: PETSc.Vec, problem: StepProblem, name: str) -> None:
    """Refine a step, or raise Unsolved, on every rank, with the place of the largest residual. Collective."""
    try:
        check_solution(solver, step, balance, f"time {problem.time:.6g}: {name}")
    except Unsolved as error:
        _, left = true_residual(solver.getOperators()[0], step, balance)
        middle = problem.operators.layout.solid_count
        solid, flow = np.split(np.abs(left.getArray()), [middle])
        left.destroy()
        raise Unsolved(
            f"{error}; largest {place_of(problem, solid, flow)}: look at supports, stiffness and aperture there, or"
            " take a smaller time_step"
        ) from error


def place_of(problem: StepProblem, solid: Floats, flow: Floats) -> str:
    """Where the larger of two vectors (n,) of this rank's unknowns is largest: "in" a fracture or "at" a point. Collective."""
    ops = problem.operators
    solid, flow = (np.where(np.isfinite(each), each, np.inf) for each in (solid, flow))
    here = [float(each.max(initial=0.0)) for each in (solid, flow)]
    in_rock, in_flow = over_ranks(here, ops.layout.comm)
    if in_flow >= in_rock and ops.flow is not None:
        return f"in {worst_fracture(ops, np.where(np.isinf(flow), 1e300, flow))}"
    sizes = ops.layout.solid_vector()
    sizes.setArray(np.where(np.isinf(solid), 1e300, solid))
    nodal = ops.nodal(sizes)
    at_nodes = np.abs(nodal.getArray()).reshape(-1, ops.blocks.sizes.dim).max(axis=1, initial=0.0)
    destroy(sizes, nodal)
    worst = int(at_nodes.argmax()) if len(at_nodes) else -1
    joints = ops.blocks.joints
    faces = np.any(np.concatenate([joints.bottom, joints.top], axis=1) == worst, axis=1)
    on = f"in {joints.fractures[joints.fracture[faces.argmax()]]} " if faces.any() else ""
    mine = (float(at_nodes[worst]), tuple(ops.blocks.solid.points[worst]), on) if worst >= 0 else (-1.0, (), "")
    _, point, on = max(ops.layout.comm.allgather(mine))
    return f"{on}at ({', '.join(f'{x:.4g}' for x in point)})"


def describe_floating(scene: Scene, problem: StepProblem, floating: Floating, slack: float) -> str:
    """Name the floating block with the largest net force, and that force; the same on every rank. Collective.

    slack  a net force that is none [force per thickness]
    """
    motions = floating.motions
    force = floating.net_force(problem.solid_balance)
    push = (motions @ (motions.T @ force.ravel())).reshape(-1, 3)
    loose = _loose(floating)
    worst = int(loose[np.abs(push[loose]).max(axis=1).argmax()])
    system = scene.unit_system
    unit = f" {system.force}/{system.length}" if system.length else ""
    size = float(np.linalg.norm(push[worst, :2]))
    if size > slack:
        way = push[worst, :2] / size
        main = int(np.abs(way).argmax())
        along = f"{'-+'[int(way[main] > 0)]}{'xy'[main]}" if abs(way[main]) > 0.999 else f"({way[0]:.3g}, {way[1]:.3g})"
        pushed = f"net force {size:.4g}{unit} in {along}"
    elif abs(push[worst, 2]) > slack:
        pushed = f"net moment {push[worst, 2] * floating.frames.size[worst]:.4g} {system.force or ''}".rstrip()
    else:
        pushed = "no net force just now, and no support that fixes its position"
    more = f" (and {len(loose) - 1} more blocks with it)" if len(loose) > 1 else ""
    remedy = (
        "lower the load, or give geometry a domain with sides"
        if scene.is_unbounded
        else "hold it by a [[support]] or [[tie]], lower the load"
    )
    return (
        f"time {problem.time:.6g}: {_block(floating, worst)} has no support in {_free_ways(motions[3 * worst : 3 * worst + 3])}"
        f" ({_around(floating, problem, worst)}): {pushed}{more}; there is no equilibrium: {remedy},"
        f' {"and" if scene.is_unbounded else "or"} let it move in a stage of kind = "dynamic"'
    )


def _loose(floating: Floating) -> Ints:
    """Numbers of the blocks that float."""
    share = np.abs(floating.motions).max(axis=1, initial=0.0).reshape(-1, 3)
    return np.flatnonzero(share.max(axis=1) > SAME)


def _block(floating: Floating, piece: int) -> str:
    """Name of a block."""
    block, middle = floating.operators.blocks.solid, floating.frames.middle[piece]
    rock = block.rocks[block.piece_rock[piece]]
    return f'block {piece} (rock "{rock}", centred at ({middle[0]:.4g}, {middle[1]:.4g}))'


def _free_ways(motions: Floats) -> str:
    """Directions in which one block moves among the motions (3, k)."""
    vectors, sizes, _ = np.linalg.svd(motions, full_matrices=False)
    ways = vectors[:, sizes > SAME]
    if ways.shape[1] == 1 and np.abs(ways[:2]).max() > SAME and np.abs(ways[:, 0]).max() < 0.999:
        x, y, turn = ways[:, 0]
        return f"direction ({x:.3g}, {y:.3g})" + (" while it turns" if abs(turn) > SAME else "")
    return ", ".join(np.array(["x", "y", "rotation"])[np.abs(ways).max(axis=1) > SAME])


def _around(floating: Floating, problem: StepProblem, piece: int) -> str:
    """Numbers of open and of sliding joints around a block, in words. Collective."""
    sections, points = problem.sections, len(floating.natural)
    here = np.any(floating.sides == piece, axis=1) & (floating.sides[:, 0] != floating.sides[:, 1])
    loose = sections.is_open | sections.is_sliding  # one end of a joint may be open and the other slide
    is_open, slides = (part.reshape(-1, points).all(axis=1) for part in (sections.is_open, loose))
    counts = np.array([here.sum(), (here & is_open).sum(), (here & slides & ~is_open).sum()])
    joints, open_, sliding = (int(n) for n in floating.operators.layout.comm.allreduce(counts))
    if not joints:
        return "no joints around it"
    if open_ == joints:
        return f"all {joints} joints open" if joints > 1 else "its joint is open"
    if sliding == joints:
        return f"all {joints} joints slide" if joints > 1 else "its joint slides"
    return f"of {joints} joints {open_} open and {sliding} sliding"


def places_of(blocks: Blocks, chosen: Bools, natural: Floats) -> str:
    """Fractures and places, over all ranks, of the first of the chosen sections (s,). Collective."""
    ends = blocks.solid.points[blocks.joints.bottom]
    points, extent = on_joints(ends, natural).reshape(-1, ends.shape[-1]), extent_of(blocks.solid.points)
    here = [
        (blocks.joints.fractures[blocks.joints.fracture[s // len(natural)]], place_text(points[s], extent))
        for s in np.flatnonzero(chosen)
    ]
    found = sorted({place for part in blocks.comm.allgather(here) for place in part})
    listed = ", ".join(f"{name} at {place}" for name, place in found[:MOST_PLACES])
    return listed + (f" and {len(found) - MOST_PLACES} more places" if len(found) > MOST_PLACES else "")


def fractures_of(blocks: Blocks, chosen: Bools) -> str:
    """Names, over all ranks, of the fractures that have one of the chosen sections (s,). Collective."""
    points = max(1, len(chosen) // max(1, len(blocks.joints.ids)))
    here = {blocks.joints.fractures[f] for f in blocks.joints.fracture[np.flatnonzero(chosen) // points]}
    return ", ".join(sorted(set().union(*blocks.comm.allgather(here))))
