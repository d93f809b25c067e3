"""CPU before the first step, beside that of the packages that a run cannot do without.

    scripts/bench startup [--pairs N] [--most RATIO] [--modules] [--run-only] [--parts]

The base is a Python that imports NumPy, mpi4py, petsc4py and h5py, and ends. In each pair it takes turns with
``fracflow run``, up to the record of its initial state: of a scene with a mesh file, and of one whose traces are meshed. Then
follow ``fracflow check`` of the first, ``--version`` and ``--help``. CPU is that of the user and the system, without Gmsh,
which runs in a process of its own. A run of one step is counted whole: with its end, Gmsh and all other processes.
The least of all pairs is printed: a busy machine only adds. Bytecode is kept, as pip does.
Exit 1 where the ratio of the first run is above --most.

    --modules   lists what has been imported at the first step, by package, and how much beside the base
    --run-only  leaves out all but the base and the first run
    --parts     shares of the first run: the base, other packages that it imports, modules of fracflow, and its work, which is
                what it takes once all is imported; besides, how much would be left if modules of fracflow took no time
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCENE, TRACES = ROOT / "meshes/r01_inclined_joint/scene.toml", ROOT / "meshes/three_fractures/scene.toml"
FIRST = "run, to its first step"
BASE = "import os, numpy, mpi4py.MPI, petsc4py.PETSc, h5py; os._exit(shown())"
RUN = """
import fracflow.cli.app as app
begin = app.keep_imports
def begin_once_imported():
    from fracflow.simulation.recorder import Recorder
    Recorder.record = lambda *_: os._exit(shown())
    begin()
app.keep_imports = begin_once_imported
app.main()
"""
WHOLE = "import atexit; atexit.register(shown)\nfrom fracflow.cli.app import main\nmain()"
WITH_OTHERS = WHOLE.replace("(shown)", "(shown, True)")
IMPORTED = """
import gc, importlib, os, sys
gc.disable()  # as the program does
for name in sys.argv[1].split():
    try:
        importlib.import_module(name)
    except ImportError:  # made by the package that it belongs to
        pass
os._exit(shown())
"""
SHOWN = """
import os, sys
def shown(with_others=False):
    import resource
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)[: 1 + with_others]
    used = sum(each.ru_utime + each.ru_stime for each in map(resource.getrusage, whose))
    os.write(2, f"\\n{used} {' '.join(sys.modules)}".encode())
    return 0
"""


def cpu(code: str, words: list[str], kept: str) -> tuple[float, list[str]]:
    """CPU [s] of a Python that ends in ``shown``, and the modules that it has imported."""
    from fracflow._petsc import find_petsc_dir

    given = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    given |= {"PYTHONPYCACHEPREFIX": kept, "PYTHONPATH": str(ROOT), "PETSC_DIR": find_petsc_dir() or ""}
    given = given if given["PETSC_DIR"] else {key: value for key, value in given.items() if key != "PETSC_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", SHOWN + code, *words], env=given, cwd=kept, capture_output=True, text=True, check=True
    )
    time, *modules = done.stderr.splitlines()[-1].split()
    return float(time), modules


def least(ways: dict[str, tuple[str, list[str]]], pairs: int, kept: str) -> dict[str, float]:
    """CPU [s] of each way, the least of so many times in turns."""
    found = [[cpu(*way, kept)[0] for way in ways.values()] for _ in range(pairs)]
    return {name: min(each) for name, each in zip(ways, zip(*found, strict=True), strict=True)}


def print_parts(modules: list[str], pairs: int, kept: str) -> None:
    """Where the CPU of the first run goes, in parts that add up; ``modules`` it has imported by its first step."""
    others = [name for name in modules if name.partition(".")[0] != "fracflow" and name != "__main__"]
    ours = ["fracflow._petsc", *(name for name in modules if name.partition(".")[0] == "fracflow")]
    ways = {
        "base": (BASE, []),
        "other packages": (IMPORTED, [" ".join(["fracflow._petsc", *others])]),
        "modules of fracflow": (IMPORTED, [" ".join([*others, *ours])]),
        "work": (RUN, ["run", str(SCENE), "-o", "run"]),
    }
    times, before = least(ways, pairs, kept), 0.0
    for name, until in times.items():
        print(f"  {name:22s} {until - before:6.3f} s {(until - before) / times['base']:6.2f}")
        before = until
    bound = times["work"] - times["modules of fracflow"] + times["other packages"]
    print(f"  {len(ours) - 1} modules; without any of their time {bound / times['base']:.2f}")


def main() -> None:
    """Measure, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--most", type=float, default=1.5)
    parser.add_argument("--modules", action="store_true")
    parser.add_argument("--run-only", action="store_true")
    parser.add_argument("--parts", action="store_true")
    given = parser.parse_args()
    ways = {"base": (BASE, []), FIRST: (RUN, ["run", str(SCENE), "-o", "run"])}
    if not given.run_only:
        ways |= {
            "run of traces, likewise": (RUN, ["run", str(TRACES), "-o", "traces"]),
            "run of one step, whole": (
                WITH_OTHERS,
                ["run", str(SCENE), "-o", "whole", "--set", "stage.0.steps=1", "--set", "output.pictures=false"],
            ),
            "check": (WHOLE, ["check", str(SCENE)]),
            "--version": (WHOLE, ["--version"]),
            "--help": (WHOLE, ["--help"]),
        }
    with tempfile.TemporaryDirectory() as kept:
        found = {name: cpu(*way, kept)[1] for name, way in ways.items()}  # which compiles
        times = least(ways, given.pairs, kept)
        if given.parts:
            print_parts(found[FIRST], given.pairs, kept)
    for name, seconds in times.items():
        print(f"{name:24s} {seconds:6.3f} s {seconds / times['base']:6.2f}")
    if given.modules:
        packages = Counter(name.partition(".")[0] for name in found[FIRST])
        print(*(f"{count:5d} {name}" for name, count in packages.most_common(20)), sep="\n")
        more = Counter(name.partition(".")[0] == "fracflow" for name in {*found[FIRST]} - {*found["base"]})
        print(f"modules beside the base: {more[True]} of fracflow, {more[False]} of other packages")
    sys.exit(times[FIRST] > given.most * times["base"])


if __name__ == "__main__":
    main()
