"""Lengths of a scene that its mesh does not resolve; each rank looks at its own cells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fracflow.diagnostics import slip
from fracflow.diagnostics.joints import gather
from fracflow.diagnostics.number import CheckInput
from fracflow.diagnostics.thin_rock import thin_rock_lines
from fracflow.integrators import stepper_from
from fracflow.mesh.agreement import on_root
from fracflow.mesh.data import Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.plane.quality import BLUNT
from fracflow.mesh.rock_cells import RockCells
from fracflow.mesh.whole import share_of_blunt
from fracflow.reduction.mesh_size import SAME, WorstCell, needs, typical_length, worst_of
from fracflow.remarks import digits
from fracflow.scene.advice import GENTLE, is_for_explicit
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH

CARRIED = 2.0  # cells over joints, from which on waves of single joints do not get out
MOST_COARSE = 0.1  # share of the area in which cells are so large


def unresolved(
    scene: Scene, mesh: SplitMesh | None, wells: Mapping[str, tuple[int, ...]], cells: RockCells | None = None
) -> list[str]:
    """A line for each length that a mesh does not resolve, except those of the pre-run checks; on rank 0. Collective.

    mesh   on rank 0, else None
    cells  those of all ranks; without, those of the mesh, on one process
    """
    if cells is None:
        assert mesh is not None
        cells = RockCells.of(mesh)
    comm = cells.comm
    view = on_root(comm, lambda: None if mesh is None else CheckInput(scene, gather(scene, mesh, wells)))
    weak, drops = comm.bcast(None if view is None or mesh is None else (_weak_joints(view, mesh), _drops(view)), root=0)
    rock = RockSizes(
        worst_of(scene, cells),
        cells.exceeded_in(MOST_COARSE) if drops else 0.0,
        None if weak is None else weak.beside(cells),
    )
    return on_root(comm, lambda: [] if view is None or mesh is None else _unresolved(view, mesh, rock)) or []


@dataclass(frozen=True)
class RockSizes:
    """Sizes of the cells of all ranks: the worst, that which MOST_COARSE of the rock exceeds, growth beside fractures."""

    worst: WorstCell
    far: float
    beside: Beside | None


def unresolved_slip(scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> list[str]:
    """A line for each length of slip that a mesh does not resolve: those of the pre-run checks. On one process."""
    late = "how slip begins and how far it runs depends on the mesh in"
    coarse = slip.coarse_of_slip(scene, mesh, wells)
    return [f"mesh: {what} is not resolved: {late} {slip.of_fractures(names)}" for what, names in coarse.items()]


def _unresolved(view: CheckInput, mesh: SplitMesh, rock: RockSizes) -> list[str]:
    scene, unit = view.scene, view.unit(LENGTH)
    lines = []
    for need in needs(view, mesh, rock.worst):
        if need.is_listed and SAME * need.found > need.size:
            asked = f"{'joints' if need.along else 'cells'} of {need.size:.3g}{unit}"
            has = f"has {need.found:.3g}{unit}, {need.where}"
            lines.append(f"mesh: {need.what} is not resolved: it needs {asked}, and {has}")
    lines += [*thin_rock_lines(scene, mesh), *_blunt(mesh)]
    return [*lines, *_keeping_waves(view, rock.far), *_coarse_beside(view, rock.beside)]


def _blunt(mesh: SplitMesh) -> Iterator[str]:
    """A line where many cells are far from squares and equilateral triangles."""
    if mesh.points.shape[1] != 2 or is_unmeshed(mesh.cells):
        return
    share = share_of_blunt(mesh)
    if share > BLUNT:
        yield (
            f"mesh: {digits(100 * share)} % of the cells have a corner over 150 degrees: such cells are too stiff, and slip and"
            " opening may be far too small: mend the mesh, or let its sizes grow by less per length"
        )


def _drops(view: CheckInput) -> bool:
    """Whether strengths drop in events whose waves leave by absorbing sides."""
    return any(stage.kind == "auto" for stage in view.scene.stage) and bool(view.scene.absorbing) and view.drops.any()


def _keeping_waves(view: CheckInput, far: float) -> Iterator[str]:
    """A line where cells away from fractures do not carry the waves of sudden drops of strength, and nothing damps them.

    A drop at one joint moves two, h long each, and makes waves of 4 h. A cell carries none shorter than twice its own size.
    """
    scene = view.scene
    if not _drops(view) or stepper_from(scene.method.stepper, scene.method).damps:
        return
    fine = typical_length(view.joints.length)
    if far > CARRIED * fine:
        unit = view.unit(LENGTH)
        stepper = 'set method.stepper = "generalised-alpha" with rho_infinity = 0.5, which damps them, or '
        yield (
            f"mesh: a tenth of the rock has cells of {far:.3g}{unit} and more, over {CARRIED:g} times the joints of"
            f" {fine:.3g}{unit}: shorter waves of a strength that drops at once stay around the fractures, and events take"
            f" several times more steps: {'' if is_for_explicit(scene) else stepper}have cells below"
            f" {CARRIED * fine:.3g}{unit}"
        )


@dataclass(frozen=True)
class WeakJoints:
    """Joints (j,) where slip may run away.

    middle    (j, dim) [length]
    length    (j,) [length]
    fracture  (j,) of ``count`` ones
    reach     (j,) nucleation length [length]
    """

    middle: Floats
    length: Floats
    fracture: Ints
    reach: Floats
    count: int

    def beside(self, cells: RockCells) -> Beside:
        """How cells grow away from their nearest joint, between two joints and the reach away from it. Collective."""
        from scipy.spatial import cKDTree  # imports much

        away, nearest = cKDTree(self.middle).query(cells.middle)
        here = (away > 2.0 * self.length[nearest]) & (away < self.reach[nearest])
        away, own, size = away[here], nearest[here], cells.size[here]
        least = np.full(self.count, np.inf)
        np.minimum.at(least, self.fracture[own], self.reach[own])
        sums = [np.bincount(self.fracture[own], each, self.count) for each in (size - self.length[own], away)]
        grown, distance = cells.comm.allreduce(np.array(sums))
        return Beside(
            np.divide(grown, distance, out=np.zeros(self.count), where=distance > 0.0),
            np.min(cells.comm.allgather(least), axis=0),
        )


@dataclass(frozen=True)
class Beside:
    """Growth (f,) of cells beside each fracture over the distance, and the least reach (f,) there [length]."""

    growth: Floats
    reach: Floats


def _weak_joints(view: CheckInput, mesh: SplitMesh) -> WeakJoints | None:
    """Those of a scene in which slip begins in rock at rest; None without any."""
    may_run_away = any(stage.kind != "dynamic" for stage in view.scene.stage)
    if not view.weakens.any() or not may_run_away:
        return None
    joints = view.joints
    reach = np.nanmin(np.where(view.weakens, slip.nucleation_lengths(view), np.inf), axis=1)
    weak = np.flatnonzero(np.isfinite(reach))
    if not len(weak):
        return None
    middle = mesh.points[mesh.joint_bottom[weak]].mean(axis=1)
    return WeakJoints(middle, joints.length[weak], joints.fracture[weak], reach[weak], len(joints.names))


def _coarse_beside(view: CheckInput, beside: Beside | None) -> list[str]:
    """A line for each fracture whose joints may resolve where slip runs away, and the cells beside it not.

    Rock is too stiff by the square of the rate at which its cells grow away from a patch of the nucleation length.
    """
    if beside is None:
        return []
    geometry = view.scene.geometry
    remedy = "give a [mesh] whose cells grow by less there, or refine"
    if geometry is not None:
        is_gentle = geometry.growth is not None and geometry.growth <= GENTLE
        remedy = "refine" if is_gentle else f"geometry.growth = {GENTLE:g}, or refine"
    return [
        f"mesh: the nucleation length of {name} is not resolved in the rock beside it: within"
        f" {reach:.3g}{view.unit(LENGTH)} cells grow by {grows:.3g} of the distance, more than"
        f" {GENTLE:g}, which holds the fracture too stiffly and lets slip run away late: {remedy}"
        for name, grows, reach in zip(view.joints.names, beside.growth, beside.reach, strict=True)
        if grows > GENTLE
    ]
