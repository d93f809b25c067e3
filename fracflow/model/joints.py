"""The joints: one sparse jump operator G for all sections (2.3)-(2.9), and the laws that respond to its strains.

residual  G' W f(G u)      tangent  G' W D G
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fracflow._petsc import PETSc
from fracflow.elements import facet, joint
from fracflow.errors import InputError
from fracflow.laws import JOINT_LAWS, FlowLaw, JointLaw, LawStep, PlasticSlip, dilating, make_law, parameters_of
from fracflow.laws.base import INSTANT, JointResponse
from fracflow.laws.compiled import CompiledFriction, Evaluates, copy_of, fastest
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.layout import add_blocks, add_transposed, create_matrix, matrix_of, product
from fracflow.model.properties import along_fractures, initial_pressure, initial_stress, on_joints
from fracflow.model.solid import impedance_beside, nodal_layout, node_unknowns
from fracflow.model.state import SectionHistory, Sections
from fracflow.scene.scene import Scene
from fracflow.scene.units import STRESS
from fracflow.scene.unusual import slight

RESPONSE = (
    "traction", "tangent", "stored", "inelastic", "strength", "utilisation", "is_sliding", "is_open", "margin",
)  # fmt: skip
"""Fields of a ``JointResponse`` that ``Sections`` has, but for histories."""


@dataclass(frozen=True)
class SectionGroup:
    """Sections with equal numbers of unknowns: numbers (n,), their unknowns (n, k), and their rows of G (n, dim, k)."""

    sections: Ints
    unknowns: Ints
    jump: Floats


def jump_matrix(blocks: Blocks, points: Floats, expand: PETSc.Mat | None) -> PETSc.Mat:
    """(2.3)-(2.9) G for sections at natural coordinates (q,) or (q, 2). The caller destroys it. Collective."""
    block, dim, width = blocks.joints, blocks.sizes.dim, blocks.joints.bottom.shape[1]
    frame, _ = facet.frame(blocks.solid.points[block.bottom])
    shapes = facet.shapes(points, width)
    operators = joint.jump_operator(frame, shapes)
    count = len(block.ids) * len(points) * dim
    matrix = create_matrix(((count, blocks.comm.allreduce(count)), nodal_layout(blocks)), 2 * width * dim, blocks.comm)
    start = matrix.getOwnershipRange()[0]
    faces = node_unknowns(blocks, np.stack([block.bottom, block.top], axis=1))  # (joint, face, node, component)
    parts = operators.reshape(len(block.ids), len(points), dim, 2, width, dim)
    for point, shape in enumerate(shapes):
        first = start + (np.arange(len(block.ids)) * len(points) + point) * dim
        near = np.flatnonzero(shape)
        entries = 2 * len(near) * dim
        cols = faces[:, :, near].reshape(len(block.ids), entries)
        values = parts[:, point][:, :, :, near].reshape(len(block.ids), dim, entries)
        add_blocks(matrix, first[:, None] + np.arange(dim), cols, values)
    matrix.assemble()
    if expand is None:
        return matrix
    reduced = matrix.matMult(expand)
    matrix.destroy()
    return reduced


def entry_sizes(matrix: PETSc.Mat) -> PETSc.Mat:
    """The absolute values of a matrix, entry by entry. The caller destroys it. Collective."""
    indptr, indices, values = matrix.getValuesCSR()
    return matrix_of(matrix.getSizes(), (indptr, indices, np.abs(values)), matrix.getComm())


def section_groups(jump: PETSc.Mat, dim: int) -> tuple[SectionGroup, ...]:
    """Rows of G gathered by section; all rows of a section share their columns."""
    indptr, indices, values = jump.getValuesCSR()
    first, width = indptr[:-1:dim], np.diff(indptr)[::dim]
    groups = []
    for k in np.unique(width):
        chosen = np.flatnonzero(width == k)
        rows = (first[chosen, None] + np.arange(dim * k)).reshape(len(chosen), dim, k)
        groups.append(SectionGroup(chosen, indices[rows[:, 0]].astype(np.int64), values[rows]))
    return tuple(groups)


@dataclass(frozen=True)
class LawGroup:
    """Sections that follow one law: their numbers (n,), and the law with its parameters (n,)."""

    sections: Ints
    law: JointLaw


@dataclass(frozen=True)
class Massless:
    """Strains (s, dim) in which a wall has no mass; ``jump`` is G P, the strains of what carries its mass."""

    components: Bools
    jump: PETSc.Mat


@dataclass(frozen=True)
class Walls:
    """Input of flow laws at the joint ends: openings (j, 2) or None, slips (j, 2, dim-1), history (j, 2, ...), and step."""

    opening: Floats | None
    slip: Floats
    history: Mapping[str, Floats]
    step: LawStep
    plastic: PlasticSlip | None = None


@dataclass(frozen=True)
class Joints:
    """All joint sections of a rank; section = joint * rule points + point.

    jump      G: displacement unknowns -> strains, rows section * dim + component
    sizes     |G|, entry by entry
    weights   (s,) length or area a section stands for
    initial   (s, dim) initial effective traction, joint frame [stress]
    groups    sections by unknowns, for the tangent
    laws      sections by law
    natural   natural coordinates of a joint's sections
    massless  where walls have no mass of their own; None where all have
    """

    dim: int
    jump: PETSc.Mat
    sizes: PETSc.Mat
    weights: Floats
    initial: Floats
    groups: tuple[SectionGroup, ...]
    laws: tuple[LawGroup, ...]
    natural: Floats
    massless: Massless | None = None

    @property
    def points(self) -> int:
        """Sections of a joint."""
        return len(self.natural)

    @property
    def dilate(self) -> bool:
        """Whether slip opens any of them, on any rank."""
        return any("dilation" in group.law.history for group in self.laws)

    def initial_history(self) -> SectionHistory:
        """Histories of all laws at the initial state."""
        return tuple(group.law.initial_history(len(group.sections), self.dim) for group in self.laws)

    def strain(self, displacement: PETSc.Vec) -> Floats:
        """(2.4)-(2.9) Strains (s, dim) of this rank's sections, joint frame [length]. Collective."""
        return product(self.jump, displacement).reshape(-1, self.dim)

    def carried(self, displacement: PETSc.Vec) -> Floats:
        """Strains (s, dim) of walls without mass, if they moved as the nodes that carry their mass. Collective."""
        jump = self.jump if self.massless is None else self.massless.jump
        return product(jump, displacement).reshape(-1, self.dim)

    def moved(self, displacement: PETSc.Vec) -> Floats:
        """Sums of sizes (s, dim) of the displacements whose differences are the strains [length]. Collective."""
        size = displacement.copy()
        size.abs()
        result = product(self.sizes, size).reshape(-1, self.dim)
        size.destroy()
        return result

    def openings(self, strain: Floats) -> Floats | None:
        """Normal jumps (j, k) at the joints' nodes of strains (s, dim); None for the one-point rule, which has none."""
        normal = strain[:, -1].reshape(-1, self.points)
        return None if self._to_nodes is None else np.asarray(normal @ self._to_nodes.T)

    @cached_property
    def _to_nodes(self) -> Floats | None:
        return facet.to_nodes(self.natural)

    def walls(self, sections: Sections, law: FlowLaw, step: LawStep = INSTANT) -> Walls:
        """The joint ends as a flow law sees them when ``step`` has led to those sections; slip of the section next to each."""
        slip = self._next_to_ends(sections.strain[:, :-1]) if law.knows_slip else np.zeros((0, 2, self.dim - 1))
        history = {name: self._next_to_ends(self.history(sections.history, name)) for name in law.reads}
        grows = law.roughness is not None and law.roughness.grows
        return Walls(self.openings(sections.strain), slip, history, step, self._plastic(sections) if grows else None)

    def _plastic(self, sections: Sections) -> PlasticSlip:
        """That next to the joint ends."""
        k_s = np.full(len(self.weights), np.nan)
        for group in (group for group in self.laws if group.law.slides):
            k_s[group.sections] = getattr(group.law, "shear_stiffness", np.nan)
        found = PlasticSlip.of(sections.inelastic[:, :-1], sections.tangent[:, :-1], k_s)
        return PlasticSlip(self._next_to_ends(found.slip), self._next_to_ends(found.by_strain))

    def _next_to_ends(self, values: Floats) -> Floats:
        return values.reshape(-1, self.points, *values.shape[1:])[:, [0, -1]]

    def evaluate(self, strain: Floats, history: SectionHistory, step: LawStep = INSTANT) -> Sections:
        """Response of the laws to strains (s, dim) after ``history``, which stays as it is."""
        count, dim = len(strain), self.dim
        if self._is_alone:
            return self.answered(strain, self._fastest[0].evaluate(strain, history[0], step))
        whole = {
            "traction": np.zeros((count, dim)),
            "tangent": np.zeros((count, dim, dim)),
            "stored": np.zeros(count),
            "inelastic": np.zeros((count, dim)),
            "strength": np.full(count, np.inf),
            "utilisation": np.zeros(count),
            "is_sliding": np.zeros(count, dtype=bool),
            "is_open": np.zeros(count, dtype=bool),
            "margin": np.full(count, np.inf),
        }
        new = []
        for group, law, before in zip(self.laws, self._fastest, history, strict=True):
            response = law.evaluate(strain[group.sections], before, step.of(group.sections))
            for name, values in whole.items():
                values[group.sections] = getattr(response, name)
            new.append(response.history)
        return Sections(strain=strain, blur=np.zeros((count, dim)), record=np.zeros(count), history=tuple(new), **whole)

    def answered(self, strain: Floats, response: JointResponse) -> Sections:
        """All sections at strains (s, dim) where one law answers for them, in their order."""
        count, whole = len(strain), {name: getattr(response, name) for name in RESPONSE}
        blur, record = np.zeros((count, self.dim)), np.zeros(count)
        return Sections(strain=strain, blur=blur, record=record, history=(response.history,), **whole)

    @cached_property
    def copy_of_law(self) -> CompiledFriction | None:
        """The compiled copy of the law that all sections follow, in their order; None where there is none."""
        return copy_of(self.laws[0].law, len(self.weights), self.dim) if self._is_alone else None

    @cached_property
    def _fastest(self) -> tuple[Evaluates, ...]:
        return tuple(fastest(group.law, len(group.sections), self.dim) for group in self.laws)

    @cached_property
    def _is_alone(self) -> bool:
        """Whether all sections follow one law, in their order."""
        return len(self.laws) == 1 and np.array_equal(self.laws[0].sections, np.arange(len(self.weights)))

    def with_status(self, history: SectionHistory, trial: SectionHistory) -> SectionHistory:
        """``history`` with the statuses of ``trial``: the histories from which the next iteration starts."""
        return tuple(
            {**start, **{name: reached[name] for name in group.law.status}}
            for group, start, reached in zip(self.laws, history, trial, strict=True)
        )

    def history(self, past: SectionHistory, name: str) -> Floats:
        """A history variable at all sections of this rank, (s,) or (s, dim-1); NaN where the law has none of that name."""
        shapes = {"shear": (len(self.weights), self.dim - 1), "scalar": (len(self.weights),)}
        kind = next((group.law.history[name].kind for group in self.laws if name in group.law.history), "scalar")
        values = np.full(shapes[kind], np.nan)
        for group, history in zip(self.laws, past, strict=True):
            if name in history:
                values[group.sections] = history[name]
        return values

    def have_changed(self, old: SectionHistory, new: SectionHistory) -> Bools:
        """Which (s,) of this rank's sections have another status in ``new`` than in ``old``."""
        if self._is_alone and self.laws[0].law.status:
            return self.laws[0].law.has_changed(old[0], new[0])
        changed = np.zeros(len(self.weights), dtype=bool)
        for group, before, after in zip(self.laws, old, new, strict=True):
            if group.law.status:
                changed[group.sections] = group.law.has_changed(before, after)
        return changed

    def step_limit(self, strain: Floats, increment: Floats, sections: Sections) -> float:
        """Largest fraction of an increment (s, dim) that every law of this rank allows after ``sections``; at most 1."""
        strain = sections.less_dilation(strain)
        limits = [group.law.step_limit(strain[g], increment[g]) for group in self.laws if len(g := group.sections)]
        return min([1.0, *(float(np.min(limit)) for limit in limits)])

    def may_close(self, strain: Floats, sections: Sections) -> Floats:
        """How far (s,) the law of each section lets it close in an iteration; inf where closure has no end [length]."""
        strain = sections.less_dilation(strain)
        closing, result = np.zeros_like(strain), np.zeros(len(strain))
        closing[:, -1] = -1.0
        for group in self.laws:
            result[group.sections] = group.law.step_limit(strain[group.sections], closing[group.sections])
        return result

    def change_at(self, strain: Floats, increment: Floats, sections: Sections) -> float:
        """Fraction of an increment (s, dim) at which the first section of this rank opens or closes; inf where none does."""
        strain = sections.less_dilation(strain)
        places = [group.law.change_at(strain[g], increment[g]) for group in self.laws if len(g := group.sections)]
        return min([np.inf, *(float(np.min(place)) for place in places)])

    def approach(self, strain: Floats, change: Floats, history: SectionHistory, step: LawStep) -> Floats:
        """Distances (s, 2) of this rank's sections from their next event, of friction and of contact; see ``JointLaw``."""
        result = np.full((len(strain), 2), np.inf)
        for group, before in zip(self.laws, history, strict=True):
            g = group.sections
            result[g] = group.law.approach(strain[g], change[g], before, step.of(g))
        return result

    def with_other_status(self, strain: Floats, history: SectionHistory, chosen: Bools) -> SectionHistory:
        """``history`` with the other status of friction at the chosen sections (s,)."""
        return tuple(
            group.law.with_other_status(strain[group.sections], before, chosen[group.sections])
            for group, before in zip(self.laws, history, strict=True)
        )

    def radiated(self, old: Sections, new: Sections, step: LawStep) -> Floats:
        """Energy (s,) that waves carry away of the work of tractions on the plastic slip of a step [energy/area]."""
        slip, found = np.linalg.norm((new.inelastic - old.inelastic)[:, :-1], axis=1), np.zeros(len(self.weights))
        for group in self.laws:
            found[group.sections] = group.law.radiated(slip[group.sections], step.of(group.sections))
        return found

    def force(self, traction: Floats, result: PETSc.Vec) -> None:
        """(2.15)-(2.19), (2.31) ``result`` += G' W f, f (s, dim): forces that resist, tension's +n on top. Collective."""
        add_transposed(self.jump, (self.weights[:, None] * traction).ravel(), result)

    def tangent(self, moduli: Floats) -> list[tuple[Ints, Floats]]:
        """(2.32) Blocks W g' D g of each group: unknowns (n, k), values (n, k, k)."""
        return [
            (g.unknowns, joint.tangent(g.jump[:, None], moduli[g.sections, None], self.weights[g.sections, None]))
            for g in self.groups
        ]


def implied_tractions(blocks: Blocks, scene: Scene, natural: Floats) -> Floats:
    """(2.14) Effective tractions (s, dim) that the initial stress and the initial pressure make, joint frame [stress]."""
    place = section_places(blocks, natural)
    traction = tractions_of(blocks, initial_stress(scene, place), len(natural))
    traction[:, -1] += initial_pressure(scene, place)
    return traction


def section_places(blocks: Blocks, natural: Floats) -> Floats:
    """Where sections at natural coordinates (q,) or (q, 2) of this rank's joints are (s, dim) [length]."""
    return on_joints(blocks.solid.points[blocks.joints.bottom], natural).reshape(-1, blocks.sizes.dim)


def tractions_of(blocks: Blocks, stress: Floats, points: int) -> Floats:
    """(2.14) Tractions (s, dim) that a stress (s, 3, 3) makes at the sections, so many a joint, joint frame [stress]."""
    dim, frame = blocks.sizes.dim, facet.frame(blocks.solid.points[blocks.joints.bottom])[0]
    return joint.traction_from_stress(np.repeat(frame, points, axis=0), stress[:, :dim, :dim])


def initial_tractions(blocks: Blocks, scene: Scene, natural: Floats) -> Floats:
    """Initial effective tractions (s, dim): those implied (2.14), or what the fractures' tables give in their place."""
    traction = implied_tractions(blocks, scene, natural)
    keys = ("initial_normal_traction", "initial_shear_traction")
    normal, shear = (along_fractures(blocks, scene, key, natural).ravel() for key in keys)
    traction[:, -1] = np.where(np.isnan(normal), traction[:, -1], normal)
    traction[:, :-1] = np.where(np.isnan(shear)[:, None], traction[:, :-1], shear[:, None])
    if scene.equilibrates:
        traction[traction[:, -1] > 0.0] = 0.0  # a joint carries no tension: it starts open, and the tension is released
    return traction


def law_groups(blocks: Blocks, scene: Scene, initial: Floats, natural: Floats) -> tuple[LawGroup, ...]:
    """One group a law, its parameters as arrays (n,) over its sections; initial tractions (s, dim), natural (q,)."""
    block = blocks.joints
    tables = [scene.fracture_named(name) for name in block.fractures]
    fracture = np.repeat(block.fracture, len(natural))
    choices = {
        "coupled_tangent": scene.method.tangent == "consistent",
        "strength_when_open": scene.method.open_strength == "cohesion",
        "radiates": scene.method.radiation_damping == "auto",
    }
    groups = []
    for name in sorted({table.law for table in tables}):
        sections = np.flatnonzero(np.array([table.law == name for table in tables], dtype=bool)[fracture])
        given: dict[str, Any] = {
            "initial_normal_traction": initial[sections, -1],
            "initial_shear_traction": initial[sections, :-1],
        }
        for field in parameters_of(JOINT_LAWS[name]):
            if field.name in choices:
                given[field.name] = choices[field.name]
            elif field.name == "wave_impedance":
                given[field.name] = np.repeat(impedance_beside(blocks, scene), len(natural))[sections]
            elif "key" in field.metadata and field.metadata["key"].choices:
                given[field.name] = np.array([getattr(table, field.name) or "" for table in tables])[fracture[sections]]
            elif field.name not in given:
                key = "friction" if field.name == "friction_coefficient" else field.name
                given[field.name] = along_fractures(blocks, scene, key, natural).ravel()[sections]
        law = make_law(name, **given)
        if any(table.law == name and table.dilates for table in tables):
            angle, distance = (
                along_fractures(blocks, scene, key, natural).ravel()[sections]
                for key in ("dilation_angle_deg", "dilation_distance")
            )
            law = dilating(law, angle, distance)
        groups.append(LawGroup(sections, law))
    return tuple(groups)


def refuse_bad_start(blocks: Blocks, groups: tuple[LawGroup, ...], initial: Floats, points: int, scene: Scene) -> None:
    """Raise InputError, on every rank, that lists fractures under initial tension or past their strength. Collective.

    initial (s, dim) tractions. A fracture past its strength may slip as a dynamic stage begins, where that carries it.
    """
    carried = scene.carries_unbalanced
    fracture = np.repeat(blocks.joints.fracture, points)
    tension = set(fracture[initial[:, -1] > 1e-12 * np.abs(initial).max(initial=0.0)].tolist())
    failed: set[int] = set()
    for group in () if carried or blocks.comm.allreduce(len(tension)) else groups:
        unstrained = np.zeros((len(group.sections), initial.shape[1]))
        response = group.law.evaluate(unstrained, group.law.initial_history(*unstrained.shape))
        failed.update(fracture[group.sections[response.is_sliding | (response.utilisation >= 1.0)]].tolist())
    names = blocks.joints.fractures
    bad_tension = sorted({names[i] for part in blocks.comm.allgather(tension) for i in part})
    bad_failed = sorted({names[i] for part in blocks.comm.allgather(failed) for i in part})
    if bad_tension:
        most = max(blocks.comm.allgather(float(initial[:, -1].max(initial=0.0))))
        units = "".join(f"; {line}" for line in slight(scene))
        raise InputError(
            f"initial state: effective normal traction is tensile on {', '.join(bad_tension)}, by up to {most:.3g}"
            f"{scene.unit_system.behind(STRESS)}: compress the rock (initial_stress; compression is negative), lower"
            " fluid.initial_pressure, give initial_normal_traction <= 0, or let a first [[stage]] with kind ="
            f' "equilibrate" open them{units}'
        )
    if bad_failed:
        raise InputError(
            f"initial state: initial shear traction reaches the strength of {', '.join(bad_failed)}: lower the shear"
            " stress (initial_stress), raise friction or cohesion, or let a first [[stage]] with kind ="
            ' "equilibrate" make them slip'
        )


def assemble_joints(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> Joints:
    """Operators and laws of the joints. Collective."""
    corners = blocks.solid.points[blocks.joints.bottom]
    sections = facet.RULES[scene.method.quadrature][corners.shape[1]]
    xi, weights = sections.natural, facet.section_sizes(corners, sections).ravel()
    initial = initial_tractions(blocks, scene, xi)
    groups = law_groups(blocks, scene, initial, xi)
    if not scene.equilibrates:
        refuse_bad_start(blocks, groups, initial, len(xi), scene)
    jump = jump_matrix(blocks, xi, expand)
    sizes = entry_sizes(jump)
    return Joints(blocks.sizes.dim, jump, sizes, weights, initial, section_groups(jump, blocks.sizes.dim), groups, xi)
