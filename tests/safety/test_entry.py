"""Input from anybody: nothing of it runs, nothing outside the run folder is written, no link followed, all in bounded time."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from resealed import resealed

from fracflow.cli.app import main
from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.output.events import COLUMNS, read_events
from fracflow.output.export import export_csv
from fracflow.output.folder import RunFolder, write_atomic
from fracflow.output.history import HistoryFile, read_history
from fracflow.scene.petsc import EXPECTED, SOLVERS, refusal
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]

SCENE = """
[geometry]
domain = [0, 0, 4, 4]
size = 2
[[geometry.fracture]]
name = "fault"
points = [[1, 2], [4, 2]]
[rock.rock]
youngs_modulus = "50 GPa"
poissons_ratio = 0.25
[fracture.fault]
normal_stiffness = "10 GPa/m"
shear_stiffness = "5 GPa/m"
friction_angle_deg = 30
aperture = "1 mm"
[fluid]
viscosity = "1e-3 Pa s"
[output]
pictures = false
[[support]]
on = ["west", "east", "south", "north"]
[[well]]
name = "well"
at = [3, 2]
flow_rate = 1e-9
[[probe]]
name = "probe"
at = [3, 2]
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 1
"""


def said(words, monkeypatch, capfd):
    """Exit code of a command in this process, and its one line."""
    monkeypatch.setattr(sys, "argv", ["fracflow", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    line = capfd.readouterr().err
    assert line.startswith("fracflow: ") and line.count("\n") == 1 and line[:-1].isprintable(), line
    return ended.value.code, line


def contents(folder):
    """All that lies in a folder: what links point to, bytes and times."""
    found = {}
    for path in sorted(folder.rglob("*")):
        is_plain = path.is_file() and not path.is_symlink()
        found[path] = (path.lstat().st_mtime_ns, path.read_bytes() if is_plain else None)
    return found


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
    assert [key for key, value in given if refusal(key, value)] == []
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


# Run folders


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """A run that has ended, with fields and a log."""
    home = tmp_path_factory.mktemp("ended")
    (home / "scene.toml").write_text(SCENE)
    from fracflow.simulation.run import run

    run(load(home / "scene.toml"), home / "out")
    return home / "out"


def linked(path, outside):
    path.unlink(missing_ok=True)
    path.symlink_to(outside)


def twice(path, outside):
    path.unlink(missing_ok=True)
    os.link(outside, path)


def piped(path, outside):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def to_zero(path, outside):
    linked(path, "/dev/zero")


def elsewhere(path, outside):
    if path.exists():
        path.rename(outside.parent / "moved")
    (outside.parent / "moved").mkdir(exist_ok=True)
    path.symlink_to(outside.parent / "moved")


TRAPS = {
    "a log elsewhere": ("log.txt", linked),
    "a log of two names": ("log.txt", twice),
    "a log that is a pipe": ("log.txt", piped),
    "a marker elsewhere": (".fracflow", linked),
    "a marker of two names": (".fracflow", twice),
    "a checkpoint elsewhere": ("checkpoint.h5", linked),
    "a history without end": ("history.h5", to_zero),
    "a half history elsewhere": ("history.h5.part", linked),
    "a half checkpoint elsewhere": ("checkpoint.h5.part", linked),
    "a scene that is a pipe": ("scene.toml", piped),
    "a status elsewhere": ("status.json", linked),
    "a half picture elsewhere": ("pictures/overview.png.part", linked),
    "a field elsewhere": ("fields/rock_000001.h5", linked),
    "fields elsewhere": ("fields", elsewhere),
    "pictures elsewhere": ("pictures", elsewhere),
    "a folder as a log": ("log.txt", lambda path, outside: (path.unlink(), path.mkdir())),
}


@pytest.mark.parametrize("name", TRAPS)
def test_a_run_folder_leads_nowhere_else(name, ended, tmp_path, monkeypatch, capfd):
    where, trap = TRAPS[name]
    folder, outside = tmp_path / "out", tmp_path / "precious"
    shutil.copytree(ended, folder)
    (folder / "pictures").mkdir(exist_ok=True)
    outside.write_text("mine\n" * 1000)
    trap(folder / where, outside)
    before = contents(tmp_path)
    (tmp_path / "again").mkdir()
    (tmp_path / "again" / "scene.toml").write_text(SCENE)
    before = contents(tmp_path)
    commands = [["resume", folder], ["run", tmp_path / "again" / "scene.toml", "-o", folder]]
    for words in [*commands, *([["picture", folder], ["export", "--csv", folder]] if trap is not twice else [])]:
        code, line = said(words, monkeypatch, capfd)
        assert code == 2 and where.partition("/")[0] in line and "remove it" in line
    assert contents(tmp_path) == before


def test_what_is_written_follows_no_link(tmp_path):
    """As the check above might be passed by a link that comes later."""
    outside = tmp_path / "precious"
    outside.write_text("mine")
    folder = RunFolder(tmp_path / "out")
    for name in ("plan.json.part", "history.h5.part"):
        (folder / name).symlink_to(outside)
    folder.write_text("plan.json", "{}")
    with HistoryFile(folder / "history.h5") as history:
        history.append({"time": 0.0})
    (folder / "log.txt").symlink_to(outside)
    folder.log("a line")
    assert folder.unlogged == 1
    with pytest.raises(InputError, match=r"log.txt: is a link"):
        folder.cut_back(0, 0, 0)
    write_atomic(folder / "log.txt", "")  # takes the place of the link
    assert outside.read_text() == "mine" and not (folder / "log.txt").is_symlink()


def external(path):
    with h5py.File(path, "w") as file:
        file["time"] = h5py.ExternalLink("/etc/passwd", "/x")


def stored_elsewhere(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("time", (10,), "f8", external=[("/etc/passwd", 0, 80)])


def made_up(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("time", (10**13,), "f8", chunks=(1000,))


def in_circles(path):
    with h5py.File(path, "w") as file:
        file["a/b"] = h5py.SoftLink("/a")
        file["c/d"] = file["c"] if "c" in file else file.create_group("c")


@pytest.mark.parametrize("make", [external, stored_elsewhere, made_up, in_circles])
@pytest.mark.parametrize("read", [read_history, load_mesh])
def test_an_hdf5_file_holds_its_data_itself(make, read, tmp_path):
    make(tmp_path / "a.h5")
    with pytest.raises(InputError, match=r"a.h5: is no .*; "):
        read(tmp_path / "a.h5")


def test_a_run_that_was_moved_before_its_first_checkpoint_goes_on(tmp_path):
    """Its folder alone is enough: the mesh is kept there."""
    from fracflow.simulation.run import resume, run

    home = tmp_path / "a" / "deep" / "home"
    home.mkdir(parents=True)
    shutil.copy(ROOT / "meshes" / "report_5_2" / "block.geo", home)
    text = (ROOT / "meshes" / "report_5_2" / "scene.toml").read_text()
    (home / "scene.toml").write_text(text)
    scene = load(home / "scene.toml", ["stage.0.end=0.3"])
    run(scene, home / "out")
    whole = read_history(home / "out" / "history.h5")
    shutil.move(home / "out", tmp_path / "moved")
    shutil.rmtree(tmp_path / "a")
    (tmp_path / "moved" / "checkpoint.h5").unlink()
    (tmp_path / "moved" / "history.h5").unlink()
    resume(tmp_path / "moved")
    again = read_history(tmp_path / "moved" / "history.h5")
    assert again.keys() == whole.keys() and all(np.array_equal(again[k], whole[k], equal_nan=True) for k in whole)


# Names


@pytest.mark.parametrize("name", ["\x1b[2J", "a\nb", "a\x00b", "\x9b31m", "a\u202eb", "x" * 300])
@pytest.mark.parametrize("table", ["probe = [{{name = {}, at = [3, 2]}}]", "control = {{{} = {{initial = 1}}}}"])
def test_names_steer_no_terminal(name, table, tmp_path):
    quoted = '"' + "".join(c if c.isascii() and c.isprintable() else f"\\u{ord(c):04x}" for c in name) + '"'
    (tmp_path / "scene.toml").write_text(table.format(quoted) + "\n" + SCENE.replace("[[probe]]", "[[tie]]"))
    text = SCENE.split("[[probe]]")[0] + "[[stage]]" + SCENE.split("[[stage]]")[1]
    (tmp_path / "scene.toml").write_text(table.format(quoted) + "\n" + text)
    with pytest.raises(InputError, match=r"must be one line without control characters|must have at most 250 letters"):
        load(tmp_path / "scene.toml")


def test_names_of_a_mesh_steer_no_terminal(tmp_path):
    from test_malformed import MSH

    from fracflow.mesh.read import read_mesh

    (tmp_path / "a.msh").write_text(MSH.replace('"south"', '"\x1b]0;owned\x07"'))
    with pytest.raises(InputError, match=r"a.msh: physical curve 3: control characters in its name"):
        read_mesh(tmp_path / "a.msh", ["fault"])


def test_names_in_pictures_are_no_formulas(tmp_path, monkeypatch):
    """Matplotlib would read them between dollars, and take a matplotlibrc of the working folder, which may call TeX."""
    matplotlib = pytest.importorskip("matplotlib")
    from fracflow.output.pictures import draw
    from fracflow.simulation.run import run

    text = SCENE.replace('"probe"', r"'$\foo{$'").replace('"fault"', r"'$\frac{$'").replace(".fault]", r".'$\frac{$']")
    (tmp_path / "scene.toml").write_text(r"title = 'a $\foo$ b'" + "\n" + text)
    run(load(tmp_path / "scene.toml"), tmp_path / "out")
    with matplotlib.rc_context({"text.usetex": True, "text.latex.preamble": r"\input{/etc/hostname}"}):
        assert len(draw(tmp_path / "out")) == 2


def test_names_in_a_run_folder_steer_no_terminal(ended, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(ended, folder)
    (folder / "events.csv").write_text(f"{','.join(COLUMNS)}\nslip,\x1b[2J,1,,0,0,0,,0,0{',' * 11}\n")
    with resealed(folder / "mesh.h5") as (_, notes):
        notes["fractures"] = '["\\u001b]0;owned\\u0007"]'
    with pytest.raises(InputError, match=r"events.csv: row 1 is no event .*control characters"):
        read_events(folder / "events.csv")
    with pytest.raises(InputError, match=r"mesh.h5: is no saved mesh .*control characters"):
        load_mesh(folder / "mesh.h5")


def test_names_are_no_markup(tmp_path, monkeypatch, capfd):
    """Rich would take [/x] for the end of a style, and end in a traceback."""
    text = SCENE.replace('"probe"', '"p[/x]"').replace('"fault"', '"f[/x]"').replace(".fault]", '."f[/x]"]')
    (tmp_path / "scene.toml").write_text('title = "t[/x]"\n' + text.replace("flow_rate = 1e-9", "flow_rate = 1e-5"))
    monkeypatch.setattr(sys, "argv", ["fracflow", "run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code and "f[/x]" in capfd.readouterr().out


def test_a_link_that_nobody_has_named_is_no_run_folder(tmp_path, monkeypatch, capfd):
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / tmp_path.name).symlink_to(tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    code, line = said(["run", "scene.toml"], monkeypatch, capfd)
    assert code == 2 and f"runs/{tmp_path.name}: is a link; name the run folder with -o" in line
    assert not list((tmp_path / "elsewhere").iterdir())


def test_names_stay_in_their_folder(tmp_path):
    names = ("../../x", "a/b", "a_b", "A_b", "/etc/x", "<script>", "..\\..\\y")
    (tmp_path / "out").mkdir()
    with HistoryFile(tmp_path / "out" / "history.h5", {"units": {}}) as history:
        history.append({"time": 0.0} | {f"probe/{name.replace('..', '...')}/slip": 1.0 for name in names})
    found = export_csv(tmp_path / "out")
    assert len({path.name.lower() for path in found}) == len(names)
    assert {path.resolve().parent for path in found} == {(tmp_path / "out" / "csv").resolve()}


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
    "many keys": ("".join(f"k{i} = 1\n" for i in range(30000)) + SCENE, None, "(and 29999 more)"),
    "many of one name": (SCENE + '[[probe]]\nname = "p"\nat = [3, 2]\n' * 20000, None, "(and 19998 more)"),
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
