"""Scenes from anybody: nothing of them runs, PETSc's options and packages included, and all is read in bounded time."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from malformed import SCENE, contents, said

from fracflow.errors import InputError
from fracflow.scene.petsc import EXPECTED, SOLVERS, refusal
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]


# PETSc's options

NO_OPTIONS = {
    "a view": ("whole-lu_ksp_view", "ascii:VIEW"),
    "a view in the terminal": ("whole-lu_ksp_view", ""),
    "a view of a matrix": ("ksp_view_mat", "binary:M"),
    "a monitor to a file": ("whole-lu_ksp_monitor", "ascii:M"),
    "a rate to a file": ("whole-lu_ksp_converged_rate", "ascii:M"),
    "a reason to a file": ("whole-lu_ksp_converged_reason", "ascii:M"),
    "eigenvalues to a file": ("whole-lu_ksp_compute_eigenvalues", "ascii:M"),
    "a Python type": ("whole-lu_pc_type", "python"),
    "a Python solver": ("solid_ksp_type", "python"),
    "a Python step": ("solid_snes_type", "python"),
    "a Python file": ("whole-lu_pc_python_type", "notes.txt:PC"),
    "a Python monitor": ("whole-lu_ksp_monitor_python", "notes.txt:mon"),
    "a Python block": ("monolithic_fieldsplit_solid_pc_type", "python"),
    "a Python level": ("solid_mg_levels_1_pc_type", "python"),
    "a shell": ("solid_pc_type", "shell"),
    "a file of options": ("options_file", "more"),
    "two in one name": ("ksp_type gmres -options_file", "more"),
    "two in one value": ("solid_ksp_rtol", "1e-9 -options_file more"),
    "a second line": ("solid_ksp_type", "gmres\n-log_view"),
    "a library": ("dll_append", "evil.so"),
    "a log": ("log_view", "ascii:LOG"),
    "a debugger": ("on_error_attach_debugger", "xterm"),
    "a dump": ("malloc_dump", ""),
    "information": ("info", "INFO"),
    "a web server": ("saws_options", ""),
    "factors on disk": ("whole-lu_mat_mumps_icntl_22", 1),
    "a folder for factors": ("whole-lu_mat_mumps_ooc_tmpdir", "/tmp"),
    "a unit of Fortran": ("whole-lu_mat_mumps_icntl_3", 77),
    "print files of hypre": ("solid_pc_hypre_boomeramg_print_debug", ""),
    "Euclid's file": ("solid_pc_hypre_type", "euclid"),
    "capitals": ("WHOLE-LU_PC_PYTHON_TYPE", "notes.txt:PC"),
    "another solver": ("other_pc_type", "lu"),
    "a dash": ("-ksp_view", ""),
    "no number": ("solid_ksp_rtol", float("nan")),
    "a number as a count": ("solid_ksp_max_it", 1.5),
    "a huge count": ("solid_ksp_gmres_restart", 10**5000),
}
OPTIONS = {
    "ksp_rtol": 1e-9, "whole-lu_pc_type": "lu", "whole-lu_pc_factor_mat_solver_type": "mumps", "solid_ksp_type": "fgmres",
    "whole-lu_mat_mumps_icntl_14": 50, "solid_ksp_monitor": "", "solid_ksp_reuse_preconditioner": True,
    "monolithic_fieldsplit_solid_pc_type": "hypre", "monolithic_fieldsplit_solid_pc_hypre_boomeramg_P_max": 4,
    "solid_mg_levels_1_ksp_chebyshev_esteig": "0,0.1,0,1.1", "solid_mg_levels_esteig_ksp_max_it": 10, "flow_ksp_rtol": "1e-9",
    "solid_pc_gamg_threshold": "0.01,0.02", "explicit_sub_pc_type": "ilu", "whole-lu_snes_linesearch_type": "bt",
}  # fmt: skip


@pytest.mark.parametrize("name", NO_OPTIONS)
def test_a_scene_gives_no_option_that_runs_writes_or_reads(name):
    assert refusal(*NO_OPTIONS[name])


def test_a_scene_gives_methods_and_tolerances():
    assert {key: refusal(key, value) for key, value in OPTIONS.items()} == dict.fromkeys(OPTIONS, "")


def test_the_options_that_a_scene_may_give_are_those_of_the_solvers_there_are():
    from fracflow.solve.options import MULTIGRID, OPTIONS

    assert set(SOLVERS) == set(OPTIONS)
    given = [
        (f"{prefix}_{key}", v) for t in (OPTIONS, MULTIGRID) for prefix, own in t.items() for key, v in own.items()
    ]
    assert [key for key, value in given if refusal(key, value)] == ["monolithic_pc_type", "solid_pc_type"]  # shell
    words = ("python", "shell", "view", "file", "print", "plot", "draw", "dump", "ooc", "saws", "dll", "debug")
    assert not any(word in name for name in EXPECTED for word in words)


@pytest.mark.parametrize(
    "table",
    ['whole-lu_ksp_view = "ascii:TRACE"\n', 'whole-lu_pc_type = "python"\nwhole-lu_pc_python_type = "notes.txt:PC"\n'],
    ids=["petsc", "petsc_python"],
)
def test_options_of_a_stranger_are_refused_in_one_line(table, tmp_path, monkeypatch, capfd):
    (tmp_path / "scene.toml").write_text(SCENE + "[petsc]\n" + table)
    (tmp_path / "notes.txt").write_text('open("TRACE", "w").write("ran")\nclass PC: pass\n')
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    for words in (["check", "scene.toml"], ["run", "scene.toml", "-o", "out"]):
        code, line = said(words, monkeypatch, capfd)
        key, _, value = table.split("\n")[0].partition(" = ")
        assert code == 2 and f"scene.toml: petsc.{key} = {value}: " in line and f"command line: -- -{key}" in line
    assert contents(tmp_path) == before
    (tmp_path / "plain.toml").write_text(SCENE)
    with pytest.raises(InputError, match="whole-lu_pc_type"):  # what --set gives is kept in the run folder
        load(tmp_path / "plain.toml", ["petsc.whole-lu_pc_type=python"])


def test_nothing_beside_a_scene_is_an_option_or_a_package(tmp_path):
    """PETSc reads .petscrc and petscrc of the working folder, and python -m looks for packages there."""
    trap = 'open("TRACE", "w").close()\n'
    for name in (".petscrc", "petscrc"):
        (tmp_path / name).write_text(f"-planted_{name.strip('.')} 1\n")
    for name in ("typer", "pydantic", "petsc4py"):
        (tmp_path / f"{name}.py").write_text(trap)
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / ".petscrc").write_text("# mine\n-of_home 1\n-both 1\n")
    ask = "import sys; sys.path.insert(0, sys.argv[1]); from fracflow._petsc import PETSc; print(PETSc.Options().getAll())"
    (tmp_path / "ask").mkdir()
    for name in (".petscrc", "petscrc"):
        shutil.copy(tmp_path / name, tmp_path / "ask")
    env = {**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(tmp_path / "home"), "PETSC_OPTIONS": "-both 2"}
    done = subprocess.run(
        [sys.executable, "-c", ask, str(ROOT)],
        cwd=tmp_path / "ask",
        env=env,
        capture_output=True,
        text=True,
        check=True,
    )
    assert eval(done.stdout) == {"both": "2", "of_home": "1"}
    done = subprocess.run([sys.executable, "-m", "fracflow", "--help"], cwd=tmp_path, env=env, capture_output=True)
    assert done.returncode == 0 and not (tmp_path / "TRACE").exists()


# Scenes and tables


def row(text, old, new):
    assert old in text, old
    return text.replace(old, new, 1)


def traces(make):
    """A scene that names a table of traces, and what makes the table."""
    begin, end = SCENE.index("[[geometry.fracture]]"), SCENE.index("[rock.rock]")
    return SCENE[:begin] + 'fractures_csv = "traces.csv"\n' + SCENE[end:], make


def longer(text):
    return lambda path: path.write_text(text)


def sparse(path):
    with path.open("wb") as file:
        file.truncate(1 << 40)


HARD = {
    "a pipe": (None, os.mkfifo, "is no regular file"),
    "zeros without end": (None, lambda path: path.symlink_to("/dev/zero"), "is no regular file"),
    "a terabyte": (None, sparse, "has more than 8 MiB"),
    "a table that is a pipe": (*traces(os.mkfifo), "traces.csv: is no regular file"),
    "a table of zeros": (*traces(lambda path: path.symlink_to("/dev/zero")), "is no regular file"),
    "a huge table": (*traces(sparse), "traces.csv: has more than"),
    "a table with a huge field": (*traces(longer('name,x,y\n"' + "x" * 200000 + '",1,2\n')), "traces.csv: line"),
    "many traces": (
        *traces(longer("name,x,y\n" + "".join(f"f{i},0,0\n" for i in range(100002)))),
        "more than 100000 fractures",
    ),
    "deep lists": ("a = " + "[" * 300 + "]" * 300 + "\n" + SCENE, None, "too deep inside each other"),
    "deep keys": (".".join("a" * 8000) + " = 1\n" + SCENE, None, "more than 50 dots"),
    "a number of many digits": ("a = " + "9" * 5000 + "\n" + SCENE, None, "thousands of digits"),
    "a hexadecimal of many": (row(SCENE, "size = 2", "size = 0x" + "f" * 8000), None, "geometry.size = 0x"),
    "a power of powers": (row(SCENE, "50 GPa", "50 GPa*99**99**99"), None, 'unknown unit "GPa*99**99**99"'),
    "a huge power": (row(SCENE, "50 GPa", "50 GPa**9999999"), None, 'unknown unit "GPa**9999999"'),
    "units of powers": ('units = "m*9**9**9**9-N-s"\n' + SCENE, None, "is not a unit of length"),
    "digits without end": (row(SCENE, '"50 GPa"', '"' + "1" * 50000 + '\\n"'), None, "must be a number in"),
    "many keys": ("".join(f"k{i} = 1\n" for i in range(30000)) + SCENE, None, "(and 29999 more errors)"),
    "many of one name": (SCENE + '[[probe]]\nname = "p"\nat = [3, 2]\n' * 20000, None, "(and 19998 more errors)"),
    "a long name": ('"' + "x" * 100000 + '" = 1\n' + SCENE, None, "unknown key"),
}


@pytest.mark.parametrize("name", HARD)
def test_scenes_are_read_in_bounded_time_and_memory(name, tmp_path):
    text, make, expected = HARD[name]
    if text is not None:
        (tmp_path / "scene.toml").write_text(text)
    if make is not None:
        make(tmp_path / ("traces.csv" if text is not None else "scene.toml"))
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(InputError) as caught:
        load(tmp_path / "scene.toml")
    assert expected in str(caught.value) and len(str(caught.value)) < 2000
    assert time.process_time() - began < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 << 10  # KiB


@pytest.mark.parametrize("setting", ["x=" + "[" * 5000, ".".join("a" * 5000) + "=1", "stage.0.steps=" + "9" * 5000])
def test_settings_are_read_in_bounded_time(setting, tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(InputError):
        load(tmp_path / "scene.toml", [setting])


@pytest.mark.parametrize(
    "unit", ["GPa", "1/GPa", "kg/m^3", "m^5/(N s)", "lbf s/ft^2", "Pa*s", "N/m**2", "m^-1", "m**0.5", "µm"]
)
def test_units_of_the_field_pass(unit):
    from fracflow.scene.units import _UNIT

    assert _UNIT.fullmatch(unit)


# The promises


def test_each_promise_names_a_test_that_is_there():
    whole = (ROOT / ".github" / "SECURITY.md").read_text(encoding="utf-8")
    page = re.sub(r"<!--.*?-->", "", whole, flags=re.DOTALL)
    named, held_back = (
        {word.strip("`.,;:()") for word in t.split() if "tests/" in word and ".py" in word} for t in (page, whole)
    )
    held_back -= named  # promises of tests that are not there yet
    assert not [word for word in held_back if (ROOT / word).exists()], "uncomment what has its test"
    assert "tests/safety/test_entry.py" in named
    missing = [word for word in named if not (ROOT / word.partition("::")[0]).is_file()]
    assert not missing
    for word in named:
        file, _, test = word.partition("::")
        assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8") or not test, word
