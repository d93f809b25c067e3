"""The package as others install it: its wheel, a run from it, one version and one list of dependencies, the job script."""

from __future__ import annotations

import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import tarfile
import time
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from stopped_run import SCENE
from typer.testing import CliRunner

from fracflow import __version__
from fracflow.cli.app import app
from fracflow.output.status import ENDED, STOPPED, read_status

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[1]
PACKAGING = ROOT / "scripts" / "packaging"
CONDA = {"gmsh": "python-gmsh", "matplotlib": "matplotlib-base"}  # names that differ on conda-forge
NO_SOURCES = (".git", ".venv", "runs", "build", "*.egg-info", "__pycache__", ".*_cache", ".hypothesis")
BUILD = "import sys; from setuptools import build_meta; getattr(build_meta, f'build_{sys.argv[1]}')(sys.argv[2])"


def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def build(kind, source, target):
    """The file that setuptools makes of a folder of sources: a wheel or an sdist."""
    target.mkdir()
    done = subprocess.run([sys.executable, "-c", BUILD, kind, target], cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    (made,) = target.iterdir()
    return made


def packed(wheel):
    """Names and check sums of a wheel's files, but the list of them."""
    with zipfile.ZipFile(wheel) as archive:
        return {each.filename: each.CRC for each in archive.infolist() if not each.filename.endswith("RECORD")}


def test_the_wheel_is_whole_and_runs_a_scene(tmp_path):
    """All of the package and nothing else; the same from the source distribution; a run and its page from it alone."""
    source = tmp_path / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*NO_SOURCES))
    wheel = build("wheel", source, tmp_path / "wheel")
    found = packed(wheel)
    about = f"fracflow-{__version__}.dist-info"
    assert {name.partition("/")[0] for name in found} == {"fracflow", about}
    inside = [path for path in (source / "fracflow").rglob("*") if path.is_file()]
    inside = [path for path in inside if path.suffix not in (".md", ".so")]
    files = {path.relative_to(source).as_posix() for path in inside}
    assert "fracflow/py.typed" in files and "fracflow/run_report/page.js" in files
    compiled = {name for name in found if name.endswith(".so")}
    assert {name for name in found if name.startswith("fracflow/")} - compiled == files
    assert len(compiled) == 2 * bool(shutil.which("cc") or shutil.which("gcc"))  # without a compiler it does without

    shutil.rmtree(source / "build")
    sdist = build("sdist", source, tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        archive.extractall(tmp_path / "unpacked")  # made by the line above
    assert {"pyproject.toml", "README.md", "LICENSE", *files} <= names
    again = build("wheel", next((tmp_path / "unpacked").iterdir()), tmp_path / "again")
    assert packed(again) == found

    words = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-compile"]
    subprocess.run([*words, "--target", tmp_path / "site", wheel], check=True, capture_output=True)
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    surroundings = os.environ | {"PYTHONPATH": str(tmp_path / "site")}

    def call(*words):
        command = [sys.executable, tmp_path / "site" / "bin" / "fracflow", *words]
        done = subprocess.run(command, cwd=tmp_path, env=surroundings, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    call("run", "scene.toml", "-o", "out")
    assert call("report", "out").split() == ["out/report.html"]
    assert "<script>" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    where = [sys.executable, "-c", "import fracflow; print(fracflow.__file__)"]
    done = subprocess.run(where, cwd=tmp_path, env=surroundings, capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "site")


# -- one version, one list of dependencies


def test_one_version():
    """The one of ``fracflow/_version.py``, which pyproject.toml reads."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    recipe = yaml.safe_load((PACKAGING / "recipe.yaml").read_text(encoding="utf-8"))
    heads = re.findall(r"^## (\S+?),", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [citation["version"], recipe["context"]["version"], heads[0]] == [__version__] * 3


def test_versions_are_printed():
    done = CliRunner().invoke(app, ["--version"])
    lines = done.stdout.splitlines()
    assert done.exit_code == 0 and lines[0] == f"fracflow {__version__}"
    assert re.match(r"PETSc 3\.\d+\.\d+ \(real, \d\d-bit indices; .*mumps.*\), petsc4py 3\.", lines[2])
    assert re.search(r"mpi4py \d.*, ranks: 1$", lines[3])
    assert re.search(r"numpy \d.*, gmsh \d", lines[4])


def test_dependencies_agree():
    """Those of the wheel, of the environment and of the recipe of conda, and the versions that the tests run with."""
    asked = [Requirement(line) for line in project()["dependencies"]]
    plain = {CONDA.get(one.name, one.name): str(one.specifier) for one in asked if one.marker is None}
    plain |= {"python": project()["requires-python"]}
    recipe = yaml.safe_load((PACKAGING / "recipe.yaml").read_text(encoding="utf-8"))["requirements"]
    runs = dict(line.split()[:2] for line in recipe["run"] if isinstance(line, str))
    assert runs == plain
    there = yaml.safe_load((PACKAGING / "environment.yml").read_text(encoding="utf-8"))["dependencies"]
    made = dict(line.split()[:2] for line in there if line != "pip")
    host = dict(line.split()[:2] for line in recipe["host"] if line != "pip")
    assert made == plain | host
    lines = (ROOT / "scripts" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = {one.name: one for one in map(Requirement, filter(None, (line.partition("#")[0] for line in lines)))}
    for one in asked:
        for pin in pins[one.name].specifier if one.name in pins else ():
            assert pin.operator != "==" or pin.version in one.specifier, one


@pytest.mark.parametrize(
    "path", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml")), ids=lambda path: path.stem
)
def test_forms_ask_for_what_a_fault_needs(path):
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    if path.stem == "config":
        assert set(form) <= {"blank_issues_enabled", "contact_links"}
        return
    assert {"name", "description", "body"} <= set(form)
    asked = {part.get("id"): part for part in form["body"]}
    if path.stem != "feature":
        assert "fracflow --version" in asked["versions"]["attributes"]["description"]
        assert "fracflow check" in asked["check"]["attributes"]["description"]
        assert asked["scene"]["validations"]["required"]


def test_continuous_integration_runs_what_a_user_runs():
    flow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8"))
    (job,) = flow["jobs"].values()
    assert job["steps"][-1] == {"run": "scripts/test"}


# -- the job script


def job(home, *words, **more):
    """The job script under mpirun, with a stand-in for Slurm that writes down its words."""
    stub = home / "bin" / "scontrol"
    if not stub.exists():
        stub.parent.mkdir()
        stub.write_text('#!/bin/sh\necho "$@" >>"${0%/*}/../requeued"\n')
        stub.chmod(stub.stat().st_mode | stat.S_IXUSR)
    own = {"PATH": f"{stub.parent}:{os.environ['PATH']}", "SLURM_JOB_ID": "7", "FRACFLOW_LAUNCH": "mpirun -n 1"}
    return subprocess.Popen(
        ["bash", PACKAGING / "job.sh", *words], cwd=home, env=os.environ | own | more, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


@pytest.mark.starts_ranks
def test_a_job_stops_before_its_limit_and_goes_on_in_the_next(tmp_path):
    text = SCENE.replace('"6 h"', '"1 h"').replace("fields_every = 2, checkpoint_every = 3, ", "")
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    folder, first = tmp_path / "out", job(tmp_path, "scene.toml", "out")
    log = folder / "log.txt"
    limit = time.monotonic() + 120
    while first.poll() is None and not (log.exists() and "stage 0" in log.read_text(encoding="utf-8")):
        assert time.monotonic() < limit, "the run does not begin"
        time.sleep(0.01)
    first.send_signal(signal.SIGUSR2)
    said = first.communicate(timeout=60)[0]
    assert first.returncode == 0, said
    assert (tmp_path / "requeued").read_text() == "requeue 7\n"
    assert read_status(folder).word == STOPPED, said

    second = job(tmp_path, "scene.toml", "out")
    said = second.communicate(timeout=120)[0]
    assert second.returncode == 0, said
    assert (tmp_path / "requeued").read_text() == "requeue 7\n"
    assert read_status(folder).word == ENDED


def test_a_job_that_would_fail_again_is_not_put_back(tmp_path):
    (tmp_path / "scene.toml").write_text("title = 1", encoding="utf-8")
    done = job(tmp_path, "scene.toml", "out", FRACFLOW_LAUNCH="env")
    said = done.communicate(timeout=60)[0]
    assert done.returncode == 2 and "fracflow: " in said
    assert not (tmp_path / "requeued").exists()


def test_of_two_setups_side_by_side_the_second_waits(tmp_path):
    """Both find no environment; one makes it, the other one says that it waits, and finds it made."""
    functions = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8").partition("\nexport ")[0]
    lines = """
_fracflow_root=$1
_fracflow_stamp() { echo stamp; }
_fracflow_make_venv() { mkdir .venv && until [ -e go ]; do sleep 0.05; done; echo stamp > .venv/.fracflow-stamp; }
_fracflow_install_python
"""
    command, plain = ["bash", "-c", functions + lines, "setup", str(tmp_path)], os.environ | {"FRACFLOW_TESTS": ""}
    look = {"cwd": tmp_path, "text": True, "stdout": subprocess.PIPE, "env": plain}
    with subprocess.Popen(command, **look) as first, subprocess.Popen(command, **look) as second:
        began = [each.stdout.readline() for each in (first, second)]
        (tmp_path / "go").touch()
    assert set(began) == {f"setup: preparing {tmp_path}/.venv\n", f"setup: waiting for another setup of {tmp_path}\n"}
    assert first.returncode == second.returncode == 0
