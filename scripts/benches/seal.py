"""Cost of the seals of a run's files: seal.py [SCENE...] [--set KEY=VALUE] [--repeats N].

    scripts/bench seal
    scripts/bench seal meshes/injection_cycle/scene.toml --set 'stage.cycle.end="2 d"'

Each scene is run as it is, by default application 5.5 of the report, the README's first scene and two days of the injection
cycle. Counted is the CPU time in the functions that hash, over that of the run, from the mesh to the last file. The largest
share of several repeats counts.
Exit code 1 where seals take more than 2 % of a run.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from fracflow.output import history
from fracflow.scene.scene import load
from fracflow.simulation import files
from fracflow.simulation.run import run
from fracflow.storage import sealed

MOST = 0.02
SCENES = {
    "meshes/report_5_5/scene.toml": [],
    "meshes/three_fractures/scene.toml": [],
    "meshes/injection_cycle/scene.toml": ['stage.cycle.end="2 d"'],
}
HASHING = (
    (sealed, "pieces"), (sealed, "root_of"), (history, "chain"), (history, "chain_start"), (history, "digest"),
    (files, "scene_seal"),
)  # fmt: skip


class Clock:
    """CPU seconds of this thread in functions that it is put around."""

    def __init__(self) -> None:
        """At zero."""
        self.spent = 0.0

    def around(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its calls timed."""

        def timed(*args: Any) -> Any:
            began = time.thread_time()
            try:
                return function(*args)
            finally:
                self.spent += time.thread_time() - began

        return timed


@contextmanager
def clocked() -> Any:
    """A clock around all that makes and writes seals; none of these functions calls another."""
    clock = Clock()
    with ExitStack() as stack:
        for module, name in HASHING:
            stack.enter_context(patch.object(module, name, clock.around(getattr(module, name))))
        yield clock


def share_of(scene: str, settings: list[str]) -> tuple[float, float, int]:
    """CPU seconds of seals and of the run, and its steps."""
    with tempfile.TemporaryDirectory() as folder, clocked() as clock:
        began = time.process_time()
        totals = run(load(scene, settings), Path(folder) / "out")
        return clock.spent, time.process_time() - began, totals.steps


def main() -> int:
    """Measure and print; 1 where a share is too large."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("scenes", nargs="*")
    words.add_argument("--set", action="append", default=[], dest="settings")
    words.add_argument("--repeats", type=int, default=1)
    given = words.parse_args()
    scenes = {scene: given.settings for scene in given.scenes} or SCENES
    worst = 0.0
    for scene, settings in scenes.items():
        spent, whole, steps = max((share_of(scene, settings) for _ in range(given.repeats)), key=lambda s: s[0] / s[1])
        worst = max(worst, spent / whole)
        print(f"{scene} {' '.join(settings)}: {steps} steps, {whole:.2f} s, seals {spent:.3f} s, {spent / whole:.2%}")
    print(f"largest share {worst:.2%}, may be {MOST:.0%}")
    return int(worst > MOST)


if __name__ == "__main__":
    sys.exit(main())
