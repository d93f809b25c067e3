"""Mont Terri Task B with other joints: k_n0 d_0 ten times smaller and larger, friction of 15 to 40 degrees; and in a network.

Each run of 807 s in steps of 3 s ends without a warning, with its books closed. ``one``, ``network`` or both may follow.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from _network import EXTENT, traces
from figures_benchmarks.cases.task_b import SCENE, STAGE, pumped

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.scene.toml import tomllib
from fracflow.simulation.run import run

APERTURE, STIFFNESS = 10e-6, 20e9  # of Task B: k_n0 d_0 = 0.2 MPa under 5.1 MPa
JOINTS = (
    (0.1 * APERTURE, STIFFNESS),
    (APERTURE, 0.1 * STIFFNESS),
    (APERTURE, STIFFNESS),
    (10.0 * APERTURE, STIFFNESS),
    (APERTURE, 10.0 * STIFFNESS),
)
DEGREES = (15.0, 25.0, 40.0)
IN_NETWORK = (22.0,)
BOOKS, MOST_HALVED = 1e-10, 5


@dataclass(frozen=True)
class Row:
    """How a run ended: steps, Newton iterations in all and at most in a step, halvings, books over the largest entry, CPU s."""

    name: str
    steps: int
    newton: int
    most: int
    halved: int
    books: float
    seconds: float
    why: str = ""

    @property
    def is_right(self) -> bool:
        """Whether it went through, with its books closed and hardly a halving."""
        return not self.why and self.books <= BOOKS and self.halved <= MOST_HALVED


def scene(aperture: float, stiffness: float, degrees: float, in_network: bool) -> dict[str, Any]:
    """The scene with such joints: one fault, or 20 fractures that cross and branch."""
    data = tomllib.loads(STAGE.format(step=3) + SCENE.replace("PUMPED", str(pumped())))
    friction = float(np.tan(np.radians(degrees)))
    data["fracture"] = {
        "default": {
            "normal_stiffness": stiffness,
            "shear_stiffness": stiffness,
            "aperture": aperture,
            "friction_coefficient": friction,
        }
    }
    data["output"] = {"pictures": False}
    if in_network:
        placed = {name: ((ends / EXTENT - 0.5) * 20.0).round(4) for name, ends in traces().items()}
        fractures = [{"name": name, "points": ends.tolist()} for name, ends in placed.items()]
        data["geometry"] |= {"size_at_fractures": 0.4, "fracture": fractures}
        inner = data["well"][0] | {"at": placed["down2"].mean(axis=0).tolist()}
        data["well"] = [inner, {"name": "out", "at": {"fracture": "across3", "end": "end"}, "pressure": "initial"}]
        del data["probe"]
    return data


def ran(name: str, data: dict[str, Any], folder: Path) -> Row:
    """Run a scene; a warning of Python's counts as a failure."""
    began, why = time.process_time(), ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            run(Scene.from_data(data, folder / "scene.toml"), folder / "run", MPI.COMM_SELF)
        except (SolveError, Warning) as error:
            why = f"{type(error).__name__}: {error}"
    found, seconds = read_history(folder / "run" / "history.h5"), time.process_time() - began
    halved, newton = (folder / "run" / "log.txt").read_text().count("step halved"), found["step/newton"]
    largest = max(np.abs(values).max() for key, values in found.items() if key.startswith("energy/"))
    books = float(np.abs(found["energy/residual"]).max() / largest)
    return Row(name, len(found["time"]) - 1, int(newton.sum()), int(newton.max()), halved, books, seconds, why)


def rows(which: list[str]) -> Iterator[Row]:
    """All runs of the chosen kinds, one after another."""
    for kind, angles in (("one", DEGREES), ("network", IN_NETWORK)):
        for degrees in angles if kind in which else ():
            for aperture, stiffness in JOINTS:
                about = f"{kind:8s}d0 {aperture * 1e6:5g} um, k_n {stiffness * 1e-9:4g} GPa/m, {degrees:g} degrees"
                with tempfile.TemporaryDirectory() as name:
                    yield ran(about, scene(aperture, stiffness, degrees, kind == "network"), Path(name))


def main() -> int:
    """Print a line for each run; exit code 1 if one is not right."""
    is_right = True
    for row in rows(sys.argv[1:] or ["one", "network"]):
        is_right &= row.is_right
        print(
            f"{row.name}: {row.steps} steps, {row.newton} iterations, {row.most} in one, {row.halved} halvings,"
            f" books {row.books:.1e}, {row.seconds:.1f} CPU s {row.why}",
            flush=True,
        )
    return int(not is_right)


if __name__ == "__main__":
    raise SystemExit(main())
