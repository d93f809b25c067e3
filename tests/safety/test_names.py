"""Names from anybody: they steer no terminal, leave no folder, and are neither formulas nor markup."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
from malformed import SCENE, said
from resealed import resealed

from fracflow.cli.app import main
from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.output.events import COLUMNS, read_events
from fracflow.output.export import export_csv
from fracflow.output.history import HistoryFile
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]


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
    from malformed import MSH

    from fracflow.mesh.read import read_mesh

    (tmp_path / "a.msh").write_text(MSH.replace('"south"', '"\x1b]0;owned\x07"'))
    with pytest.raises(InputError, match=r"a.msh: physical curve 3: control characters in its name"):
        read_mesh(tmp_path / "a.msh", ["fault"])


def test_names_in_pictures_are_no_formulas(tmp_path, monkeypatch):
    """Matplotlib would read them between dollars, and take a matplotlibrc of the working folder, which may call TeX."""
    matplotlib = pytest.importorskip("matplotlib")
    from fracflow.output.pictures import draw

    text = SCENE.replace('"probe"', r"'$\foo{$'").replace('"fault"', r"'$\frac{$'").replace(".fault]", r".'$\frac{$']")
    text = text.replace('"A square with a fault"', r"'a $\foo$ b'")
    (tmp_path / "scene.toml").write_text(text)
    run(load(tmp_path / "scene.toml"), tmp_path / "out")
    with matplotlib.rc_context({"text.usetex": True, "text.latex.preamble": r"\input{/etc/hostname}"}):
        assert len(draw(tmp_path / "out")) == 3


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
    text = text.replace('"A square with a fault"', '"t[/x]"').replace("flow_rate = 1e-9", "flow_rate = 1e-5")
    (tmp_path / "scene.toml").write_text(text)
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
