"""The program from Python: load a scene, run it, open what a run left."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError, Interrupted, SolveError
from fracflow.output.events import COLUMNS, read_events
from fracflow.output.export import export_csv, frame
from fracflow.output.folder import check_own
from fracflow.output.history import read_history, read_units
from fracflow.output.quakeml import export_quakeml
from fracflow.output.status import read_status
from fracflow.scene.quantities import REGIMES
from fracflow.storage.files import read_text

if TYPE_CHECKING:
    from pandas import DataFrame

    from fracflow.output.convergence import Row
    from fracflow.scene.scene import Scene

__all__ = ["Run", "converge", "load", "open", "run"]

Arrays = dict[str, NDArray[Any]]
_TEXTS = ("fracture", "probe")
_EVENT = {
    name: "U8" if name == "kind" else np.int64 if name == "node" else float for name in COLUMNS if name not in _TEXTS
}


@dataclass(frozen=True)
class Run:
    """The results of a run in its ``folder``; n is the number of recorded states, the initial one included.

    Numbers are in the scene's own units. Histories are read when first asked for, and then kept: open a folder again
    to see how far a run has got meanwhile.
    """

    folder: Path

    @cached_property
    def history(self) -> Arrays:
        """All histories by their keys in history.h5: arrays (n, ...). Raises InputError if there is none."""
        return read_history(self.folder / "history.h5")

    @property
    def times(self) -> NDArray[np.float64]:
        """Time (n,) of each state; the states of a search for failure share theirs."""
        return self.history["time"]

    @property
    def energy(self) -> Arrays:
        """Energy balance by entry, (n,) each: running totals per unit thickness [force length / length]."""
        return self._part("energy/")

    @property
    def steps(self) -> Arrays:
        """Cost and outcome of each step, (n,) each: dt, stage, kind, newton, ...; meanings in ``scene.quantities``."""
        return self._part("step/")

    @property
    def regimes(self) -> NDArray[np.str_]:
        """Regime (n,) of each step: steady, quasi-static, dynamic (with inertia) or equilibrate."""
        return np.array(REGIMES)[self.history["step/kind"].astype(int)]

    @property
    def probes(self) -> tuple[str, ...]:
        """Names of the probes, in alphabetical order."""
        keys = (key.removeprefix("probe/") for key in self.history if key.startswith("probe/"))
        return tuple(sorted({key.rpartition("/")[0] for key in keys}))

    def probe(self, name: str) -> Arrays:
        """Histories of a probe by quantity. Raises InputError for an unknown name.

        The command ``fracflow schema`` prints all
        quantities with dimension and meaning at probe[].quantities. Scalars are (n,); vectors (n, 2), x and y; of slip and
        shear traction (n,), in space (n, 2) along the fracture; strain and stress (n, 4), xx, yy, zz, xy. Tension is positive,
        tractions are effective.
        """
        found = self._part(f"probe/{name}/")
        if not found:
            raise InputError(f"{self.folder}: has no probe {name!r} (it has: {', '.join(self.probes) or 'none'})")
        return found

    @property
    def wells(self) -> tuple[str, ...]:
        """Names of the wells, in alphabetical order; none in runs of versions that wrote no histories of wells."""
        return tuple(
            sorted({key[len("well/") :].rpartition("/")[0] for key in self.history if key.startswith("well/")})
        )

    def well(self, name: str) -> Arrays:
        """Histories (n,) of a well: pressure, rate, volume and injectivity. Raises InputError for an unknown name.

        The rate [length**3/time] is the mean over the step that led to each state, positive into the network. The volume
        [length**3] is the sum of rate times dt since the start. The injectivity [length**5/(force time)] is the rate over
        pressure less initial pressure, nan where that is zero. All are over the whole flow_depth. A well with a limit of its
        pressure also has limit: 0 off it, 1 where its pressure is kept at it, 2 where the well is shut.
        """
        found = self._part(f"well/{name}/")
        if not found:
            raise InputError(f"{self.folder}: has no well {name!r} (it has: {', '.join(self.wells) or 'none'})")
        return found

    @property
    def volumes(self) -> Arrays:
        """Volumes (n,) since the start in the whole network, over the whole flow_depth [length**3].

        Wells have injected and withdrawn; fractures have stored; by_fracture_pressures came from prescribed pressures of
        fractures. Each term by which fluid leaves has one. They leave unaccounted a volume that is round-off.
        """
        return self._part("volume/")

    @property
    def events(self) -> NDArray[Any]:
        """The events of slip and opening: a structured array (events,).

        kind ("slip" or "open"), fracture, node, probe, x, y [length], start and end [time] (end nan while under
        way), slip [length], peak_slip_rate [length/time]. start is the instant where it begins if steps are cut there, else
        the beginning of the step in which it slips or opens. start_latest is the end of that step (nan in rows of kind
        "event"); end is that of the first step without it. A stage auto has kind "event" too, from the first section that
        slides to the last that sticks. It has place of the first, largest slip, and, nan in other rows, sections, length,
        mean_slip [length] and mean stress_drop [stress] of its rupture, which is all that slips over a hundredth of the largest
        slip; moment G slip length [stress length**2] and magnitude (with output.event_length) of all slip; energies radiated by
        absorbing sides, dissipated by friction, dropped at the return to rest [force length / length]. unclosed is the share of
        them that the energy balance lacks; injected is the net volume that wells brought before it [length**3]. An event under
        way at the end has its values so far. Raises InputError if there is no events.csv.
        """
        rows = read_events(self.folder / "events.csv")
        longest = {key: max([1, *(len(row[key]) for row in rows)]) for key in _TEXTS}
        dtype = np.dtype([*_EVENT.items(), *((key, f"U{size}") for key, size in longest.items())])
        values = [tuple(np.nan if row[key] is None else row[key] for key in dtype.names or ()) for row in rows]
        return np.array(values, dtype=dtype)

    @property
    def status(self) -> str:
        """How the run stands: running, ended, stopped, failed or cut off (killed); empty where the folder does not state it."""
        return read_status(self.folder).word

    @property
    def plan(self) -> list[dict[str, Any]]:
        """The decision record: what was modelled or left out, by which criterion. Raises InputError without plan.json."""
        return self._planned("decisions")

    @property
    def card(self) -> list[dict[str, Any]]:
        """The pre-run checks: ten numbers with limit, place and remedy. Raises InputError without plan.json."""
        return self._planned("card")

    def _planned(self, key: str) -> list[dict[str, Any]]:
        path = self.folder / "plan.json"
        try:
            found: list[dict[str, Any]] = json.loads(read_text(path, "name the folder of a run"))[key]
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError(f"{path}: is no readable plan ({error}); name the folder of a run") from error
        return found

    @property
    def units(self) -> dict[str, str]:
        """Names of the units of length, force and time, empty for a scene without; "shown_time" that of its stages."""
        return read_units(self.folder / "history.h5")

    @property
    def scene(self) -> Scene:
        """The scene as it was run, with every default."""
        return load(self.folder / "scene.toml")

    def frame(self, table: str = "history") -> DataFrame:
        """A pandas table: "history" has a row a state, "events" a row an event.

        Columns of the history are the keys of history.h5, time first; of vectors and tensors there is one a component, such
        as "probe/NAME/displacement_x". ``frame().attrs["units"]`` has the unit of each. Raises InputError without pandas.
        """
        if table == "events":
            rows = self.events
            return frame({name: rows[name] for name in rows.dtype.names or ()})
        if table != "history":
            raise InputError(f'Run.frame: "{table}" is no table; name "history" or "events"')
        return frame({"time": self.times, **self.history}, self.units)

    def export_quakeml(self, file: str | Path) -> int:
        """Write the events as QuakeML and return their number; see ``fracflow export --quakeml``."""
        return export_quakeml(self.folder, file)

    def export_csv(self, output: str | Path | None = None) -> list[Path]:
        """Write the histories as CSV and return the files; see ``fracflow export --csv``."""
        return export_csv(self.folder, output)

    def _part(self, prefix: str) -> Arrays:
        return {
            key[len(prefix) :]: values
            for key, values in self.history.items()
            if key.startswith(prefix) and "/" not in key[len(prefix) :].removeprefix("control/")
        }


def load(path: str | Path, overrides: tuple[str, ...] | list[str] = (), trust: bool = False) -> Scene:
    """Read a scene; ``overrides`` are as with --set: "path.to.key=value". Raises InputError of one line.

    With ``trust`` Gmsh runs the scene's .geo as it is, whatever that does; without, only what makes geometry.
    """
    from fracflow.scene.scene import load

    return load(path, list(overrides), trust)


def run(scene: Scene, out: str | Path | None = None, trust: bool = False) -> Run:
    """Run a scene and give what it left in the folder ``out``, by default runs/<name of the scene>.

    Under mpirun every rank must call it, and may use what it gives. An earlier run in the folder is replaced; no
    pictures are drawn (``fracflow picture FOLDER``). ``trust`` is as in ``load``.
    Raises, on every rank, InputError, SolveError (``open`` gives what was reached), DiskError and Interrupted.
    """
    from fracflow._petsc import MPI
    from fracflow.simulation.run import run

    folder = Path("runs") / scene.name if out is None else Path(out)
    failure: SolveError | Interrupted | None = None
    try:
        run(scene.with_trust() if trust else scene, folder, MPI.COMM_WORLD)
    except (SolveError, Interrupted) as error:
        failure = error
    MPI.COMM_WORLD.barrier()  # no rank reads before rank 0 has closed the files
    if failure is not None:
        raise failure
    return Run(folder)


def converge(
    scene: Scene, out: str | Path | None = None, levels: int = 3, trust: bool = False
) -> tuple[Run, list[Row]]:
    """Run a scene on ``levels`` meshes, each with cells and time steps half as large as the one before, and compare.

    Leaves the runs in level-0, level-1, ... of the folder ``out``, by default runs/<name of the scene>-converge, beside
    converge.csv, converge.json and converge.png. Runs that are complete there are not made again. Gives the finest run,
    and for each quantity its observed order and estimated error, in the scene's units. A warning is given where these
    are not reliable. Under mpirun every rank must call it. ``trust`` is as in ``load``. Raises as ``run`` does.
    """
    from fracflow._petsc import MPI
    from fracflow.simulation.refinement import converge

    folder = Path("runs") / f"{scene.name}-converge" if out is None else Path(out)
    comm, scene = MPI.COMM_WORLD, scene.with_trust() if trust else scene
    rows = comm.bcast(converge(scene, folder, levels, lambda level: level.run(), comm))
    return Run(folder / f"level-{levels - 1}"), rows


def open(folder: str | Path) -> Run:
    """Open the folder of a run, finished, stopped or still under way. Raises InputError if it holds none."""
    if not (Path(folder) / "history.h5").is_file():
        raise InputError(f"{folder}: holds no run of fracflow; name the folder of one")
    check_own(Path(folder))
    return Run(Path(folder))
