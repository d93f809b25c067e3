"""The network: flow through the fractures, and its coupling with the motion of their walls.

Everything is per unit thickness, with the pressure as unknown. Ends: each joint has two, numbered joint * 2 + end.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fracflow._petsc import PETSc
from fracflow.elements import facet, flow
from fracflow.laws import FLOW_LAWS, Conductance, FlowLaw, Roughness, keys_of, parameters_of
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats
from fracflow.model.joints import Walls, jump_matrix
from fracflow.model.layout import add_blocks, add_transposed, create_matrix, create_vector, product
from fracflow.model.properties import along_fractures, resting_pressure
from fracflow.model.terms.term import Leaving, Term, TermStep
from fracflow.scene.scene import Scene
from fracflow.scene.units import STRESS

BOTH_WAYS = np.array([1.0, -1.0])  # out of the first end of an element, into the second
STORAGE = {
    "lumped": ("lumped", "lumped"),
    "consistent": ("consistent", "consistent"),
    "averaging": ("averaging", "averaging"),
    "report": ("consistent", "averaging"),
    "consistent-lumped": ("consistent", "lumped"),
}
"""Matrices of the pressure force and of the wall motion: one for both, or, as in the report's (2.37) with (3.16), two."""


def _array(vector: PETSc.Vec) -> Floats:
    """The values of this rank; the vector is freed. Collective."""
    values: Floats = vector.getArray().copy()
    vector.destroy()
    return values


def is_transposed(storage: str) -> bool:
    """Whether a pair is one matrix and its transpose: then what the fluid does to the walls they do to the fluid."""
    force, volume = STORAGE[storage]
    return force == volume


@dataclass(frozen=True)
class Compression:
    """Compressible fluid at the joint ends (j, 2) beyond the room between the walls.

    Counted, as flow rates are, in volumes at its initial pressure: s = d exp(c_f (p - p0)) is what a fracture holds.

    held    (s - d) L/2, nothing where the walls meet [volume per thickness]
    weight  its derivative by the pressure of its end, c_f s L/2
    slope   its derivative by the opening of its end
    """

    held: Floats
    weight: Floats
    slope: Floats


@dataclass(frozen=True)
class Conduction:
    """The network at an opening: conductances (j,), their slopes (j, 2), end pressures above rest (j, 2).

    ``by_slip`` (j, 2, dim-1) are slopes by slip, or None; ``compression`` is None where the fluid is incompressible,
    ``leaving`` where nothing leaves by terms.
    """

    conductance: Floats
    slope: Floats
    pressure: Floats
    compression: Compression | None = None
    leaving: Leaving | None = None
    by_slip: Floats | None = None

    def held(self) -> Conduction:
        """The same with conductances that do not change with the walls."""
        by_slip = None if self.by_slip is None else np.zeros_like(self.by_slip)
        return replace(self, slope=np.zeros_like(self.slope), by_slip=by_slip)

    def tangents(self, storing: float) -> tuple[Floats, Floats]:
        """Derivatives (j, 2, 2) of the outflow of each end: by the pressures of both, and by the openings of both.

        storing  b_1, by which a compressible fluid is taken up
        """
        here, between = np.arange(2), flow.conductivity(self.conductance)
        slope = flow.conductivity_tangent(self.slope, self.pressure)
        if self.compression is not None:
            between[:, here, here] += storing * self.compression.weight
            slope[:, here, here] += storing * self.compression.slope
        if self.leaving is not None:
            between[:, here, here] += self.leaving.by_pressure
            slope[:, here, here] += self.leaving.by_aperture
        return between, slope

    def of_ends(self, storing: float) -> tuple[Floats, Floats]:
        """The same (j, 2) of what each end takes up or loses itself, without flow from end to end."""
        here, alone = np.arange(2), replace(self, conductance=np.zeros_like(self.conductance))
        between, slope = alone.held().tangents(storing)
        return between[:, here, here], slope[:, here, here]


@dataclass(frozen=True)
class Flow:
    """Operators of the network.

    opening     displacement unknowns -> normal jump at the joint ends
    pick        pressures of the flow nodes -> joint ends
    pressure_load  B of (2.38): pressures -> forces on the solid unknowns
    storage_coupling  B_F of (3.20): its transpose makes volume rates of velocities; the same as B but for the report's pair
    feedback    the displacements, by columns, that the balance of each flow node may depend on
    aperture    (j, 2) initial aperture d0 at the ends [length]
    least       (j, 2) minimum hydraulic aperture, for conduction only [length]
    length      (j,) [length]
    law         conductance of the elements by the state of their walls
    given       (j,) conductance times length that the scene gives in place of the law; NaN where it does not
    resting     pressure of the fluid at rest, its change with depth, at the flow nodes; else zero [stress]
    resting_end (j, 2) the same at the joint ends [stress]
    slipping    displacement unknowns -> tangential jumps at the joint ends, rows end * (dim-1) + component; of laws that know
                slip only
    counted     the pressure above rest at which volumes of a compressible fluid are counted [stress]
    terms       by which fluid leaves
    unit        what messages write behind a pressure
    """

    opening: PETSc.Mat
    pick: PETSc.Mat
    pressure_load: PETSc.Mat
    storage_coupling: PETSc.Mat
    feedback: PETSc.Mat
    aperture: Floats
    least: Floats
    length: Floats
    given: Floats
    resting: PETSc.Vec
    resting_end: Floats
    law: FlowLaw
    viscosity: float
    compressibility: float = 0.0
    counted: float = 0.0
    terms: tuple[Term, ...] = ()
    slipping: PETSc.Mat | None = None
    unit: str = ""

    def apertures(self, displacement: PETSc.Vec, opening: Floats | None = None) -> Floats:
        """(3.1b) d = d0 + opening at the joint ends (j, k) [length]; ``opening`` if it is known better. Collective."""
        return self.aperture + self._openings(displacement, opening)

    def _openings(self, displacement: PETSc.Vec, known: Floats | None) -> Floats:
        return product(self.opening, displacement).reshape(self.aperture.shape) if known is None else known

    def conduct(self, displacement: PETSc.Vec, pressure: PETSc.Vec, walls: Walls, step: TermStep) -> Conduction:
        """(3.14e,f) Conductances of all elements between these walls, with the end pressures that drive. Collective."""
        opening = self._openings(displacement, walls.opening)
        found, driving = self._conductance(opening, walls), self.driving(pressure)
        return Conduction(
            found.value,
            found.by_opening,
            driving,
            self.compress(self.aperture + opening, driving) if self.compressibility > 0.0 else None,
            self.leaving(driving, self.aperture + opening, step),
            found.by_slip,
        )

    def _conductance(self, opening: Floats, walls: Walls) -> Conductance:
        """Of the law, or what the scene gives in its place; by the hydraulic opening, and by plastic slip where it grows."""
        rough = self.law.roughness
        hydraulic = opening if rough is None else rough.ratio * opening
        found = self.law.conductance(hydraulic, walls.slip, walls.history, walls.step)
        value, slope, by_slip = found.value, found.by_opening, found.by_slip
        if self._has_given:
            by_law = np.isnan(self.given)
            value = np.where(by_law, value, self.given / self.length)
            slope = np.where(by_law[:, None], slope, 0.0)
            by_slip = None if by_slip is None else np.where(by_law[:, None, None], by_slip, 0.0)
        if rough is None:
            return Conductance(value, slope, by_slip)
        slope = slope * rough.ratio
        if walls.plastic is None:
            return Conductance(value, slope, by_slip)
        factor, by_strain = rough.factor(walls.plastic)
        with_slip = value[:, None, None] * by_strain
        by_slip = with_slip[..., :-1] + (0.0 if by_slip is None else factor[:, None, None] * by_slip)
        return Conductance(factor * value, factor[:, None] * slope + with_slip[..., -1], by_slip)

    @cached_property
    def _has_given(self) -> bool:
        """Whether the scene gives any conductance of this rank."""
        return not np.isnan(self.given).all()

    def leaving(self, driving: Floats, aperture: Floats, step: TermStep) -> Leaving | None:
        """Fluid that leaves by terms at pressures above rest and apertures (j, 2); None without such terms."""
        found = [term.leaving(driving + self.resting_end, aperture, step) for term in self.terms]
        return Leaving(*(sum(parts) for parts in zip(*found, strict=True))) if found else None

    def at_least(self, displacement: PETSc.Vec, opening: Floats | None = None) -> np.ndarray:
        """Which joint ends (j, 2) conduct by their minimum hydraulic aperture, being closed further. Collective."""
        by_law = np.isnan(self.given)[:, None]
        rough, wide = self.law.roughness, self.apertures(displacement, opening)
        if rough is not None:
            wide = rough.aperture + rough.ratio * (wide - self.aperture)
        return (self.least > 0.0) & (wide < self.least) & by_law

    def compress(self, aperture: Floats, driving: Floats) -> Compression:
        """Fluid beyond the room at apertures (j, 2) under pressures above rest (j, 2)."""
        half = 0.5 * self.length[:, None] * (aperture > 0.0)
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow here is refused with the trial
            denser = np.expm1(self.compressibility * (driving - self.counted))
            held = half * aperture * denser
            return Compression(held, self.compressibility * (half * aperture + held), half * denser)

    def potential(self, driving: Floats) -> Floats:
        """Work of a volume as it is counted, int dp/(s/d), at pressures above rest (...) [stress]: those, without c_f."""
        if self.compressibility == 0.0:
            return driving
        lighter = np.expm1(self.compressibility * (self.counted - driving))
        return self.counted - lighter / self.compressibility

    def taken_up(self, at_ends: Floats, result: PETSc.Vec) -> None:
        """``result`` += volume rates (j, 2) at the joint ends, brought to the flow nodes. Collective."""
        add_transposed(self.pick, at_ends.ravel(), result)

    def at_nodes(self, at_ends: Floats) -> Floats:
        """Volume rates (j, 2) at the joint ends, brought to this rank's flow nodes (n,). Collective."""
        result = self.resting.duplicate()
        result.set(0.0)
        self.taken_up(at_ends, result)
        return _array(result)

    def swept(self, moved: PETSc.Vec) -> Floats:
        """Volumes (n,) at this rank's flow nodes that walls open as they move, or their rates. Collective."""
        result = self.resting.duplicate()
        self.storage_coupling.multTranspose(moved, result)
        return _array(result)

    def at_ends(self, nodes: PETSc.Vec) -> Floats:
        """Values of the flow nodes at the joint ends (j, k). Collective."""
        return product(self.pick, nodes).reshape(self.aperture.shape)

    def driving(self, pressure: PETSc.Vec) -> Floats:
        """Pressures above those at rest at the joint ends (j, 2) [stress]. Collective."""
        return self.at_ends(pressure) - self.resting_end

    def outflow(self, state: Conduction, result: PETSc.Vec) -> None:
        """(3.20) ``result`` += K_F p, flow from each flow node into its elements, and outflow by terms. Collective."""
        through = flow.element_flow(state.conductance, state.pressure)
        sent = through[:, None] * BOTH_WAYS
        self.taken_up(sent if state.leaving is None else sent + state.leaving.rate, result)


def assemble_flow(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> Flow:
    """(2.28)-(2.29), (2.34)-(2.36), (3.17)-(3.19) B and B_F, and the network of a scene with a fluid. Collective."""
    assert scene.fluid is not None
    comm, block, dim = blocks.comm, blocks.joints, blocks.sizes.dim
    corners = blocks.solid.points[block.bottom]
    width = corners.shape[1]
    ends = np.arange(width * len(block.ids)).reshape(-1, width)
    end_layout = (ends.size, width * blocks.sizes.joints)
    node_layout = (len(blocks.flow.ids), blocks.sizes.flow_nodes)

    normal = create_matrix((end_layout, (ends.size * dim, width * blocks.sizes.joints * dim)), 1, comm)
    first = normal.getOwnershipRange()[0]
    rows = (first + ends).reshape(-1, 1)
    add_blocks(normal, rows, rows * dim + dim - 1, np.ones((rows.size, 1, 1)))
    normal.assemble()
    natural = facet.RULES["nodal"][width].natural
    jump = jump_matrix(blocks, natural, expand)
    opening = normal.matMult(jump)
    normal.destroy()
    grows = any(scene.fracture_named(name).conducts_by_slip for name in block.fractures)
    slipping = _along(jump, dim) if grows or FLOW_LAWS[scene.method.conductance].knows_slip else None
    jump.destroy()

    pick = create_matrix((end_layout, node_layout), 1, comm)
    add_blocks(pick, rows, block.flow.reshape(-1, 1), np.ones((rows.size, 1, 1)))
    pick.assemble()
    _, length = facet.frame(corners)

    def weighted(kind: str) -> PETSc.Mat:
        matrix = create_matrix((end_layout, node_layout), width, comm)
        numbers = first + ends
        add_blocks(matrix, numbers, block.flow, flow.storage_matrix(kind, corners))
        matrix.assemble()
        coupling = opening.transposeMatMult(matrix)
        matrix.destroy()
        return coupling

    kinds = STORAGE[scene.method.storage]
    push = weighted(kinds[0])
    squeeze = push if kinds[0] == kinds[1] else weighted(kinds[1])
    around = push if kinds[0] == "consistent" else weighted("consistent")
    feedback = around.transpose(PETSc.Mat())  # by its few rows: by displacements even empty rows take memory
    if around is not push:
        around.destroy()
    keys = ("aperture", "minimum_hydraulic_aperture")
    aperture, least = (along_fractures(blocks, scene, key, natural) for key in keys)
    resting = create_vector(node_layout, comm)
    resting.setArray(resting_pressure(scene, blocks.flow.points))
    return Flow(
        opening,
        pick,
        push,
        squeeze,
        feedback,
        aperture,
        least,
        length,
        along_fractures(blocks, scene, "conductance", np.zeros(1))[:, 0],
        resting,
        product(pick, resting).reshape(-1, width),
        flow_law(blocks, scene, aperture, least, length),
        scene.fluid.viscosity,
        scene.fluid.compressibility,
        scene.fluid.initial_pressure,
        slipping=slipping,
        unit=scene.unit_system.behind(STRESS),
    )


def flow_law(blocks: Blocks, scene: Scene, aperture: Floats, least: Floats, length: Floats) -> FlowLaw:
    """The law that the scene chooses, its own parameters as arrays (j, 2) at the joint ends."""
    assert scene.fluid is not None
    kind = FLOW_LAWS[scene.method.conductance]
    own: dict[str, Any] = {}
    for each in parameters_of(kind):
        if each.name in keys_of(kind):
            given = along_fractures(blocks, scene, each.name, np.array([-1.0, 1.0]))
            own[each.name] = given if each.default is MISSING else np.where(np.isnan(given), each.default, given)
    if not any(scene.fracture_named(name).is_rough for name in blocks.joints.fractures):
        return kind(aperture, least, length, scene.fluid.viscosity, **own)
    keys = ("hydraulic", "hydraulic_opening_ratio", "slip_conductance", "slip_conductance_distance")
    rough = Roughness(*(along_fractures(blocks, scene, key, np.array([-1.0, 1.0])) for key in keys))
    return kind(rough.aperture, least, length, scene.fluid.viscosity, roughness=rough, **own)


def _along(jump: PETSc.Mat, dim: int) -> PETSc.Mat:
    """The tangential rows of jumps."""
    first, last = jump.getOwnershipRange()
    rows = np.arange(first, last)
    chosen = PETSc.IS().createGeneral(rows[rows % dim < dim - 1].astype(PETSc.IntType), comm=jump.getComm())
    found = jump.createSubMatrix(chosen)
    chosen.destroy()
    return found
