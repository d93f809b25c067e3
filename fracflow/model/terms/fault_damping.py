"""Damping of the cells at faults: of what slip sends out that the mesh cannot carry.

Mechanism   Friction rectifies what shakes walls at the frequencies of a few cells, in two ways.
            Across: where walls are not meshed as each other's mirror images, a rupture presses them together and apart
            too: the normal traction rings. Nothing damps it, and cells that grow away from the fault keep it there. A
            section advances while it is pressed less, and stays while it is pressed more. Slip creeps on behind the
            front; finer cells ring more often, and make it worse. Along: where a prescribed pressure takes strength
            away at once, each node let go comes too far, as a spring does, on mirror images too. It sticks there, since
            friction does not push it back. Sections then carry less than their strength, and the stress falls by more
            than it should. Laws without a slip length do the same. There the motion of single cells may be that of the
            scene's blocks, and slip depends on the mesh (see the pre-run checks). These are damped by a
            number alone.
Predictor   Across: ``asymmetry`` of the walls, and the rms of the normal traction behind the front, which grows as its square:
            slip is too large by up to mu_d times that rms over the stress drop. k_n has no part in it, so that neither softer
            joints nor a dashpot in them help: the joint only passes on what the cells do.
            Along: the fall of strength while a front passes a cell, over the stress drop. Above about 1 slip is 10 to 40 % too
            large, more behind slower fronts, and converges slowly or not at all. A smoother pressure helps from below 1 on.
            Pressures that diffuse from a well are smooth: damped and undamped slip approach each other with order 1.
Threshold   Across: an asymmetry of ``ALIKE``, far below what counts. Triangles of [geometry] have 0.01 to 0.4, and ring by some
            hundredths of the traction.
            Along: ``is_sudden``, a change of a prescribed pressure by ``QUICK`` of the normal traction in 1/omega_e: below any
            stress drop that counts, and far above that of pumping.
Remedy      F = sum of eta_e K_e v over LAYERS of cells (Day et al. 2005; Kelvin and Voigt), with eta_e = 2 xi/omega_e of a
            cell's fastest vibration omega_e: xi of the critical damping there, xi omega/omega_e of a wave of omega. One layer
            leaves twice the ringing of three, and xi below 0.2 leaves slip too large. A strip some cells wide takes off a wave
            what is of the order of the square of their size. A node let go by itself vibrates at 0.58 omega_e and takes more,
            ``SUDDEN``: none sticks again behind a front of 0.6 c_s then. On squares of 0.25, slip behind it is 4.7 % off for
            0.25, 1.4 % for 0.45; behind one of 0.3 c_s 12.8 and 4.9 % (``tests/reference/test_self_similar_crack.py``).
Onset       With the first section that slides or opens: nothing rectifies before, and waves that pass fractures that stick lose
            nothing. It is one for all fractures.
Order       In TPV205-2D slip is too small by 1.8, 0.79, 0.40 % (rms of seven places) at cells of 200, 100, 50 m that grow by
            0.3 of the distance from the fault: order 1. For a growth of 0.1: 1.75, 0.71, 0.27 and, at 25 m, 0.10 %, order 1.3
            to 1.4. Meshes are refined evenly only where growth falls with the cells: from 0.3 at 200 m on 1.8, 0.79, 0.27,
            0.08 %, orders 1.2, 1.5, 1.7 (``scripts/bench rupture_triangles``). A ratio of 0.2 is of order 1.4 at a growth of
            0.1. But it leaves slip 3.5 % too large at one place of cells of 50 m that grow by 0.3, where it creeps on; 0.1 on
            six layers 2.6 %. Damping of strains less their means over patches of cells leaves it 0.7 to 4.8 % too large there
            at a growth of 0.1. Damping slip along the fault by 0.15 of what is across 5 % at 100 m.
Few cells   A fault of 100 m slips at once, and comes to rest. Damping by 0.25 leaves slip 27, 9, 5, 2, 1 % too small with 5,
            10, 20, 40, 80 cells along it, by 0.45 29, 10, 6, 4, 2 %: about ``LOST`` over their number (``scripts/bench
            few_cells``). The log warns of faults with fewer cells than ``FEW``. By 0.1 slip is 19 % too small to 10 % too
            large with no order in it, as vibrations last: no loss is foretold for less than ``AUTO``.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from fracflow._petsc import MPI
from fracflow.elements import facet, solid
from fracflow.integrators import EXPLICIT
from fracflow.integrators.explicit import damped_rate
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.joints import Joints
from fracflow.model.mass import cell_rates
from fracflow.model.operators import Operators
from fracflow.model.solid import assembled, by_shape, deformable, elasticity, projected, rock_values, summed_at_nodes
from fracflow.model.terms.term import MeanDamping, Term
from fracflow.remarks import digits
from fracflow.scene.scene import Scene

AUTO = 0.25  # of the critical damping of a cell's fastest vibration
SUDDEN = 0.45  # the same, where strength falls at once
QUICK = 1e-3  # of a joint's initial normal traction: the change of pressure in 1/omega of its cells that is at once
ALIKE = 1e-3  # of ``asymmetry``: less makes no normal traction that counts
FEW = 20  # joints of a fault: the log warns of fewer
LOST = 1.0  # over their number: the part of slip that is lost
MOST_NAMES = 3  # faults that are named
LAYERS = 3  # of cells that are damped, counted from the fault by the nodes they share


class FaultDamping(Term):
    """The damping of a scene's cells at faults, in explicit steps."""

    name, entry = "damped", "damping"

    def __init__(self, operators: Operators, scene: Scene) -> None:
        """Nothing is made before a stage takes explicit steps."""
        self._made = cache(lambda: damping_at_faults(operators, scene))

    def mean_damping(self) -> MeanDamping | None:
        """D of the cells; None where none is damped. Collective."""
        return self._made()


def fault_damping(operators: Operators, scene: Scene) -> tuple[FaultDamping, ...]:
    """The term of a scene with explicit steps that has this damping."""
    wanted = scene.method.stepper in EXPLICIT and scene.method.fault_damping
    return (FaultDamping(operators, scene),) if wanted else ()


def damping_at_faults(operators: Operators, scene: Scene) -> MeanDamping | None:
    """Damping of the cells at joints that can slip; None where there are none, or the scene has none. Collective.

    With "auto" only at walls that are not mirror images of each other, as normal tractions of the others do not ring. Also at
    those that lose strength at once, which excites any walls.
    """
    blocks, wanted = operators.blocks, scene.method.fault_damping
    if not wanted:
        return None
    joints, rates = can_slip(operators.joints), cell_rates(blocks, scene)
    damped = joints
    if wanted == "auto":
        uneven, sudden = joints & (asymmetry(blocks, scene) > ALIKE), joints & is_sudden(operators, scene, rates)
        damped = uneven | sudden
        ratios = np.where(cells_near(blocks, uneven, LAYERS), AUTO, 0.0)
        ratios[cells_near(blocks, sudden, LAYERS)] = SUDDEN
    else:
        ratios = np.where(cells_near(blocks, joints, LAYERS), wanted, 0.0)
    ratios[rates <= 0.0] = 0.0
    largest = float(blocks.comm.allreduce(float(ratios.max(initial=0.0)), op=MPI.MAX))
    if largest == 0.0:
        return None
    chosen = np.flatnonzero(ratios)
    moduli, points, time = elasticity(blocks, scene), blocks.solid.points, np.zeros(len(rates))
    time[chosen] = 2.0 * ratios[chosen] / np.sqrt(rates[chosen])

    def kernel(cells: Ints, nodes: Ints) -> Floats:
        return time[cells, None, None] * solid.stiffness(points[nodes], moduli[cells])

    matrix = assembled(blocks, chosen, kernel, 20)
    scale = np.ones(len(rates))
    for ratio in np.unique(ratios[chosen]).tolist():
        scale[ratios == ratio] = damped_rate(ratio)
    words = f"cells at faults are damped from the first slip on, method.fault_damping = {largest:g}"
    doubt = few_cells(blocks, damped & (largest >= AUTO))
    return MeanDamping(projected(matrix, operators.expand), scale, largest, words, doubt)


def few_cells(blocks: Blocks, damped: Bools) -> str:
    """A warning on fractures with few of the damped joints (j,), whose slip is too small; empty without any. Collective."""
    names = blocks.joints.fractures
    counts = blocks.comm.allreduce(np.bincount(blocks.joints.fracture[damped], minlength=len(names)))
    few = sorted((int(count), name) for count, name in zip(counts, names, strict=True) if 0 < count < FEW)
    if not few:
        return ""
    told = ", ".join(
        f"{name} ({count} cells, about {digits(100.0 * min(1.0, LOST / count))} %)" for count, name in few[:MOST_NAMES]
    )
    more = f" and {len(few) - MOST_NAMES} more" if len(few) > MOST_NAMES else ""
    return (
        f"method.fault_damping takes slip of faults with few cells: {told}{more}; give at least {FEW} cells along each"
    )


def can_slip(joints: Joints) -> Bools:
    """Which of this rank's joints (j,) have a law that lets them slide."""
    slides = np.zeros(len(joints.weights), dtype=bool)
    for group in joints.laws:
        slides[group.sections] = group.law.slides
    return slides.reshape(-1, joints.points).any(axis=1)


def is_sudden(operators: Operators, scene: Scene, rates: Floats) -> Bools:
    """Which of this rank's joints (j,) lose strength at once, by a pressure that changes in 1/omega of the cells there.

    rates  (m,) omega^2 of the local cells, 0 where rigid [1/time^2]
    Collective.
    """
    blocks, joints = operators.blocks, operators.blocks.joints
    change = np.zeros(len(joints.bottom))
    for name, table in scene.fracture.items() if scene.has_flow else ():
        if table.pressure is not None:
            here = np.isin(joints.fracture, [i for i, each in enumerate(joints.fractures) if scene.is_of(each, name)])
            change[here] = table.pressure.fastest(joints.along[here]).max(axis=1, initial=0.0)
    cells, at, values = np.flatnonzero(rates > 0.0), [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    for group, nodes in by_shape(blocks.solid.cells[cells]):
        at.append(nodes.ravel())
        each = np.repeat(1.0 / np.sqrt(rates[cells[group]]), nodes.shape[1])
        values.append(np.column_stack([each, np.ones(len(each))]))
    total, count = summed_at_nodes(blocks, np.concatenate(at), np.concatenate(values)).T
    mean = total / np.maximum(count, 1.0)
    brief = np.maximum(mean[joints.bottom], mean[joints.top]).max(axis=1, initial=0.0)
    pressed = np.abs(operators.joints.initial[:, -1]).reshape(-1, operators.joints.points).max(axis=1, initial=0.0)
    return change * brief > QUICK * pressed


def asymmetry(blocks: Blocks, scene: Scene) -> Floats:
    """How far both walls of each joint (j,) are from mirror images: 0 for these, at most 1. Collective.

    The larger, of both ends, of |m+ - m-|/(m+ + m-) and of |K+ - R K- R|/(|K+| + |K-|), with mass and 2 x 2 stiffness of a
    wall's node and the reflection R = 1 - 2 n n'. A wall on rigid rock stands beside its own image, by the mean K of its two
    nodes: slip opens it as far as that couples both.
    """
    block, joints, dim = blocks.solid, blocks.joints, blocks.sizes.dim
    moduli, density = elasticity(blocks, scene), rock_values(blocks, scene, "density")
    cells, at, values = deformable(blocks, scene), [np.zeros(0, dtype=np.int64)], [np.zeros((0, dim**2 + 1))]
    for group, nodes in by_shape(block.cells[cells]):
        here, width = cells[group], nodes.shape[1]
        stiff = solid.stiffness(block.points[nodes], moduli[here]).reshape(-1, width, dim, width, dim)
        own = np.einsum("kaiaj->kaij", stiff).reshape(-1, dim**2)
        mass = solid.mass_lumped(block.points[nodes], density[here])
        at.append(nodes.ravel())
        values.append(np.column_stack([own, mass.ravel()]))
    whole = summed_at_nodes(blocks, np.concatenate(at), np.concatenate(values))
    normal = facet.frame(block.points[joints.bottom])[0][:, -1]
    mirror = (np.eye(dim) - 2.0 * normal[:, :, None] * normal[:, None, :])[:, None]
    below, above = (whole[nodes, :-1].reshape(*nodes.shape, dim, dim) for nodes in (joints.bottom, joints.top))
    light, heavy = (whole[nodes, -1] for nodes in (joints.bottom, joints.top))
    alone, own = (light == 0.0) | (heavy == 0.0), (below + above).mean(axis=1, keepdims=True)
    stiff = np.where(alone, _difference(own, mirror @ own @ mirror), _difference(below, mirror @ above @ mirror))
    mass = np.where(alone, 0.0, _difference(light[..., None, None], heavy[..., None, None]))
    is_split = joints.bottom != joints.top
    return np.where(is_split, np.maximum(stiff, mass), 0.0).max(axis=1, initial=0.0)


def _difference(one: Floats, other: Floats) -> Floats:
    """|a - b|/(|a| + |b|) of matrices (..., k, k); 0 where both are 0."""
    size = np.linalg.norm(one, axis=(-2, -1)) + np.linalg.norm(other, axis=(-2, -1))
    return np.linalg.norm(one - other, axis=(-2, -1)) / np.where(size > 0.0, size, 1.0)


def cells_near(blocks: Blocks, chosen: Bools, layers: int) -> Bools:
    """Which of this rank's cells (m,) lie within some layers of the chosen joints (j,) of all ranks. Collective."""
    block = blocks.solid
    marked, near = np.zeros(len(block.points), dtype=bool), np.zeros(len(block.cells), dtype=bool)
    marked[blocks.joints.bottom[chosen]] = marked[blocks.joints.top[chosen]] = True
    for _ in range(layers):
        here = np.flatnonzero(marked)
        marked = summed_at_nodes(blocks, here, np.ones((len(here), 1)))[:, 0] > 0.0
        near = (marked[block.cells] & (block.cells >= 0)).any(axis=1)
        reached = block.cells[near]
        marked[reached[reached >= 0]] = True
    return near
