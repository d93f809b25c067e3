"""Laws of terms from outside the package, each with the one line that registers it; and runs of scenes with them.

python laws_outside.py FOLDER     runs FOLDER/NAME.toml in FOLDER/NAME; what failed, and the schema, in said.json
"""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from fracflow.laws import TERM_LAWS, Leakage, TermLaw
from fracflow.laws.base import key


@dataclass(frozen=True)
class Springs(TermLaw):
    """Springs between sides and a ground that does not move (Winkler 1867)."""

    normal_stiffness: float = field(metadata=key("k_n across the side", "force/length**3", at_least=0.0))
    shear_stiffness: float = field(default=0.0, metadata=key("k_s along the side", "force/length**3", at_least=0.0))

    places: ClassVar[str] = "sides"
    entry: ClassVar[str] = "springs"

    def stiffness(self, dim):
        return np.diag([*[self.shear_stiffness] * (dim - 1), self.normal_stiffness])


@dataclass(frozen=True)
class LeakOff(TermLaw):
    """Fluid that seeps into the rock beside a fracture, c (p - p_far) per area."""

    coefficient: float = field(metadata=key("c", "length**3/(force*time)", at_least=0.0))
    far_pressure: float = field(default=0.0, metadata=key("p_far", "force/length**2"))

    places: ClassVar[str] = "fractures"
    entry: ClassVar[str] = "leak_off"

    def leakage(self, pressure, aperture):
        slope = np.full(len(pressure), self.coefficient)
        return Leakage(slope * (pressure - self.far_pressure), slope, np.zeros(len(pressure)))


@dataclass(frozen=True)
class Seepage(TermLaw):
    """Fluid that seeps into the rock beside a fracture at a given rate, whatever the pressure."""

    rate: float = field(metadata=key("q, volume rate per area", "length/time"))

    places: ClassVar[str] = "fractures"
    entry: ClassVar[str] = "seepage"

    def leakage(self, pressure, aperture):
        none = np.zeros(len(pressure))
        return Leakage(none + self.rate, none, none)


@dataclass(frozen=True)
class Dashpots(TermLaw):
    """Dashpots between sides and a ground that does not move."""

    normal: float = field(metadata=key("across the side", "force*time/length**3", at_least=0.0))
    shear: float = field(metadata=key("along the side", "force*time/length**3", at_least=0.0))

    places: ClassVar[str] = "sides"
    entry: ClassVar[str] = "dashpots"

    def damping(self, dim):
        return np.diag([*[self.shear] * (dim - 1), self.normal])


TERM_LAWS["spring"] = Springs
TERM_LAWS["dashpot"] = Dashpots
TERM_LAWS["leak_off"] = LeakOff
TERM_LAWS["seepage"] = Seepage


def main(folder):
    from fracflow._petsc import MPI
    from fracflow.errors import InputError, SolveError
    from fracflow.scene.scene import Scene, load
    from fracflow.scene.schema import rows
    from fracflow.simulation.run import run

    failures = {}
    for scene in sorted(folder.glob("*.toml")):
        try:
            run(load(scene), scene.with_suffix(""), MPI.COMM_WORLD)
        except (InputError, SolveError) as error:
            failures[scene.stem] = str(error)
    if MPI.COMM_WORLD.rank == 0:
        said = {"failures": failures, "schema": list(rows(Scene.json_schema()))}
        (folder / "said.json").write_text(json.dumps(said), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
