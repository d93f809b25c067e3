"""A run repeated on finer meshes with shorter steps, to estimate the errors of its results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.agreement import on_root
from fracflow.mesh.locate import RockPlace
from fracflow.mesh.split import tip_count
from fracflow.mesh.store import load_mesh
from fracflow.model.setup import place
from fracflow.output.convergence import Row, compare, write
from fracflow.output.convergence_plot import draw
from fracflow.output.folder import MARKER, check_folder, holds
from fracflow.reduction.decision import ReductionInput
from fracflow.reduction.inertia import asks_period
from fracflow.reduction.locked_fractures import LEAST, why_none
from fracflow.reduction.prepare import with_sizes
from fracflow.scene.method import MOST_REFINED
from fracflow.scene.scene import Scene
from fracflow.simulation.levels import Spot, at_level, order_in_time
from fracflow.simulation.observer import Observer
from fracflow.simulation.run import OnStep, has_ended, resume, run
from fracflow.simulation.totals import Totals
from fracflow.storage.files import no_plain_file

LEAST_LEVELS, MOST_LEVELS = 2, 8
OWN = ("converge.csv", "converge.json", "converge.png")


@dataclass(frozen=True)
class Level:
    """A run of the family, of which ``found`` exists: "nothing", "a part" or "all"."""

    number: int
    scene: Scene
    folder: Path
    found: str
    comm: MPI.Comm

    def run(self, progress: Observer | OnStep | None = None) -> Totals:
        """Run the rest of it. Raises InputError, SolveError and Interrupted, on every rank. Collective."""
        if self.found == "nothing":
            return run(self.scene, self.folder, self.comm, progress)
        return resume(self.folder, self.comm, progress)


def check_levels(count: int, what: str) -> None:
    """Raise InputError, naming ``what``, for a number of levels that cannot be compared."""
    if not LEAST_LEVELS <= count <= MOST_LEVELS:
        raise InputError(f"{what} {count}: must be a number of levels from {LEAST_LEVELS} to {MOST_LEVELS}")


def levels(scene: Scene, folder: Path, count: int, comm: MPI.Comm = MPI.COMM_WORLD) -> Iterator[Level]:
    """The runs of the family, coarsest first; each must be run before the next is drawn from the iterator. Collective.

    Those of an earlier family of the same scene are gone on with. Raises InputError, on every rank.
    """
    if scene.refine + count - 1 > MOST_REFINED:
        most = f"with {count} levels cells are cut more than {MOST_REFINED} times"
        raise InputError(f"{scene.source}: refine = {scene.refine}: {most}; lower it, or the number of levels")
    on_root(comm, lambda: _check(folder))
    scene = with_sizes(scene, comm)
    ties = not why_none(ReductionInput(scene, unknowns=LEAST))
    if ties or asks_period(scene):  # levels would differ by omitted parts; without inertia steps are not halved
        scene = scene.model_copy(update={"model": "full"})
    spots: dict[str, Spot] = {}
    for number in range(count):
        here = folder / f"level-{number}"
        if number == 1:
            spots = comm.bcast(on_root(comm, lambda: _spots(scene, folder / "level-0")), root=0)
        finer = at_level(scene, number, spots)
        found = comm.bcast(on_root(comm, partial(_found, finer, here)), root=0)
        yield Level(number, finer, here, found, comm)


def conclude(scene: Scene, folder: Path, count: int) -> list[Row]:
    """Compare the levels and write ``converge.csv``, ``converge.json`` and ``converge.png``. On one process."""
    order, folders = order_in_time(scene), [folder / f"level-{number}" for number in range(count)]
    tips = has_tips(folder)
    rows = compare(folders, order, tips)
    write(rows, folder, order, folders, tips)
    draw(rows, folder)
    return rows


def has_tips(folder: Path) -> bool:
    """Whether fractures end inside the rock, on the mesh of the coarsest level. On one process."""
    return tip_count(load_mesh(folder / "level-0" / "mesh.h5")) > 0


def converge(scene: Scene, folder: Path, count: int, each: Callable[[Level], object], comm: MPI.Comm) -> list[Row]:
    """Run all levels by ``each``, then compare them; the rows are on rank 0 only. Collective."""
    check_levels(count, "levels =")
    for level in levels(scene, folder, count, comm):
        each(level)
    comm.barrier()
    return on_root(comm, lambda: conclude(scene, folder, count)) or []


def _check(folder: Path) -> None:
    """Raise InputError where a family of runs cannot be written."""
    if (folder / MARKER).exists():
        raise InputError(f"{folder}: holds a single run; name another folder for its refinement")
    inside = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    if not any(name.startswith("level-") for name in inside) and not inside <= set(OWN):
        raise InputError(f"{folder}: holds files that are no run's; name a new or empty folder")
    for name in inside:
        if (name.startswith("level-") or name in OWN) and (folder / name).is_symlink():
            raise InputError(no_plain_file(folder / name))
    check_folder(folder / "level-0")


def _found(scene: Scene, folder: Path) -> str:
    """The results of a scene in its folder, empty where its mesh file has changed since."""
    check_folder(folder)
    if not (folder / "checkpoint.h5").is_file() or not holds(folder, scene.dump_toml(folder.resolve())):
        return "nothing"
    if scene.mesh_path is not None and scene.mesh_path.stat().st_mtime > (folder / "mesh.h5").stat().st_mtime:
        return "nothing"
    return "all" if has_ended(folder) else "a part"


def _spots(scene: Scene, folder: Path) -> dict[str, Spot]:
    """Where probes and wells that are asked for by coordinates sit on the mesh of the coarsest level."""
    mesh = load_mesh(folder / "mesh.h5")
    placed = place(scene, mesh)
    spots: dict[str, Spot] = {}
    for well in scene.well:
        if isinstance(well.at, tuple) and well.name in placed.wells:
            spots[f"well.{well.name}"] = _pair(mesh.points[mesh.flow_origin[placed.wells[well.name][0]]]), None
    for probe in scene.probe:
        found = placed.probes[probe.name]
        rock = mesh.rocks[mesh.cell_rock[found.cells[0]]] if isinstance(found, RockPlace) else None
        if isinstance(probe.at, tuple):
            spots[f"probe.{probe.name}"] = _pair(found.point), probe.on or rock
    return spots


def _pair(point: Iterable[float]) -> tuple[float, float]:
    x, y = (float(value) for value in point)
    return x, y
