"""A run imports no more than it needs: start-up is most of the cost of a small one."""

import os
import re
import subprocess
import sys

import pytest
from pages import ROOT

from fracflow._petsc import _ALONE, _OF_LAUNCHERS, _without_network
from fracflow.scene.units import BASE, PARTS, USUAL, _registry

LATE = {"matplotlib", "PIL", "pint", "pandas", "gmsh", "meshio", "IPython", "scipy", "xml", "http"}
"""Packages without which a run of one joint in SI units comes to its pictures."""
MODULES, OF_OTHERS = 268, 210  # by the first step, beside NumPy, mpi4py, petsc4py and h5py; pint alone has 250
TO_PICTURES = """
import sys, fracflow.cli.run
fracflow.cli.run.show = lambda *_: print(*{name.partition(".")[0] for name in sys.modules})
from fracflow.cli.app import main
main()
"""

TO_THE_END = """
import atexit, fracflow.storage.reader as reader
atexit.register(lambda: print("reader", reader._reader._process))
from fracflow.cli.app import main
main()
"""


@pytest.mark.serial
def test_a_run_comes_to_its_pictures_without_these_packages(tmp_path):
    """Its process imports PETSc and HDF5, none of the packages that draw, convert units, mesh or walk graphs."""
    words = ["run", str(ROOT / "meshes/r01_inclined_joint/scene.toml"), "-o", "run"]
    done = subprocess.run([sys.executable, "-c", TO_PICTURES, *words], cwd=tmp_path, capture_output=True, text=True)
    found = {word for line in done.stdout.splitlines() for word in line.split()}
    assert {"petsc4py", "h5py"} <= found and not found & LATE, done.stderr


@pytest.mark.serial
def test_start_up_imports_little_beside_the_libraries_that_compute():
    """Modules, and not CPU: on a busy machine that of the many small files of a package grows more than that of libraries."""
    bench = [sys.executable, ROOT / "scripts/benches/startup.py", "--pairs", "1", "--run-only", "--modules"]
    done = subprocess.run(bench, capture_output=True, text=True)
    ours, others = map(int, re.search(r"base: (\d+) of fracflow, (\d+) of other", done.stdout).groups())
    base, run = (
        float(re.search(rf"^{name} +([\d.]+) s", done.stdout, re.M)[1]) for name in ("base", "run, to its first step")
    )
    assert done.returncode == int(run > 1.5 * base) or abs(run - 1.5 * base) < 2e-3, done.stderr
    assert ours <= MODULES and others <= OF_OTHERS, done.stdout


@pytest.mark.serial
def test_a_run_reads_itself_what_it_wrote_and_a_resumed_one_does_not(tmp_path):
    """No process that reads HDF5 starts for files that no one else can have made."""
    first = [
        str(ROOT / "meshes/r01_inclined_joint/scene.toml"),
        "--set",
        "stage.0.steps=1",
        "--set",
        "output.pictures=false",
    ]
    for words, says in ((["run", *first, "-o", "run"], "reader None"), (["resume", "run"], "reader <Popen")):
        done = subprocess.run(
            [sys.executable, "-c", TO_THE_END, *words], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        assert says in done.stdout and "Energy balance" in done.stdout


@pytest.mark.serial
def test_only_a_process_without_launcher_starts_without_network(monkeypatch):
    """The settings of the user and of launchers stay, and none is left to processes that start later."""
    for name in [name for name in os.environ if name.startswith(_OF_LAUNCHERS) or name in _ALONE]:
        monkeypatch.delenv(name)
    with _without_network():
        assert os.environ["OMPI_MCA_btl"] == "self"
    assert not _ALONE.keys() & os.environ.keys()
    for name in ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "SLURM_PROCID", "OMPI_MCA_pml"):
        with monkeypatch.context() as given:
            given.setenv(name, "2")
            with _without_network():
                assert "OMPI_MCA_btl" not in os.environ
            assert os.environ[name] == "2"


def test_factors_of_usual_units_are_those_of_pint():
    """To the last bit."""
    pint = _registry()
    for target, factors in USUAL.items():
        for unit, factor in factors.items():
            assert float(pint.Quantity(1.0, pint.parse_units(unit)).to(target).magnitude) == factor, (unit, target)
    for unit, factor in BASE.items():
        assert float(pint.Quantity(1.0, unit).to_base_units().magnitude) == factor, unit
    assert all(pint.Quantity(1.0, name).check(dimension) for dimension, names in PARTS.items() for name in names)
