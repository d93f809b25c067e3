"""Every command's help ends with an example that works; words that are wrong are told what would be right."""

import contextlib
import json
import os
import re
import shlex
import subprocess
import sys

import pytest
from malformed import spoken
from pages import ROOT
from typer.testing import CliRunner

from fracflow.cli.app import app, commands, with_levels
from fracflow.cli.reference import EXAMPLES

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("name", EXAMPLES)
def test_help_ends_with_an_example(name):
    said = CliRunner().invoke(app, [name, "--help"])
    assert said.exit_code == 0 and said.output.split()[-len(EXAMPLES[name].split()) - 1 :][0] == "Example:"
    assert " ".join(said.output.split()).endswith(f"Example: {EXAMPLES[name]}")


def test_each_command_has_one():
    assert set(EXAMPLES) == set(commands())
    for name, line in EXAMPLES.items():
        program, command, *words = shlex.split(line.partition(" >")[0])
        assert (program, command) == ("fracflow", name)
        commands()[name].make_context(name, words)


def test_examples_work_one_after_the_other(tmp_path, monkeypatch, capsys):
    """In an empty folder; the scene that is written runs at once."""
    monkeypatch.chdir(tmp_path)
    said = {}
    for name, line in EXAMPLES.items():
        words, _, file = line.removeprefix("fracflow ").partition(" > ")
        with contextlib.suppress(SystemExit):
            assert app(with_levels(words.split()), standalone_mode=False) in (None, 0), line
        said[name] = capsys.readouterr().out
        if file:
            (tmp_path / file).write_text(said[name])
    assert json.loads((tmp_path / "scene.schema.json").read_text())["title"] == "Scene of fracflow"
    assert "steps" in said["run"] and "has ended" in said["resume"]
    made = ("first/scene.toml", "runs/first-before.png", "runs/first/history.h5", "runs/first/report.html")
    assert [name for name in made if not (tmp_path / name).is_file()] == []
    assert sorted(os.listdir(tmp_path / "first")) == ["scene.toml"]


WRONG = {
    "runn": "No such command 'runn'. Did you mean \"run\"? Or see fracflow --help",
    "xyz": "No such command 'xyz'. Allowed: check, export, help, mesh, new, picture, report, resume, run, schema. Or see",
    "scene.toml": "No such command 'scene.toml'. Did you mean: fracflow run scene.toml? Or see fracflow --help",
    "": "no command; see fracflow --help. Begin with: fracflow new first",
    "check a.toml --jason": "No such option: --jason (Possible options: --json); see fracflow --help",
    "run a.toml --outptu b": 'such as -solid_pc_type lu; did you mean "--output"?',
}


@pytest.mark.parametrize("words", WRONG)
def test_words_that_are_wrong(words, monkeypatch, capfd):
    code, line = spoken(words.split(), monkeypatch, capfd)
    assert code == 2 and line.startswith("fracflow: command line: ") and line.count("\n") == 1
    assert WRONG[words] in line


def test_petsc_prints_its_own_table_of_a_run(tmp_path):
    scene = str(ROOT / "meshes" / "report_5_1" / "scene.toml")
    words = ["run", scene, "-o", str(tmp_path / "run"), "--set", "output.pictures=false", "--", "-log_view"]
    done = subprocess.run([sys.executable, "-m", "fracflow", *words], capture_output=True, text=True, check=True)
    assert "SNESFunctionEval" in done.stdout and done.stderr == ""
    for stage in ("Set up", "Steps", "Output"):
        assert re.search(rf"^ *\d+: +{stage}: [\d.e+-]+ ", done.stdout, re.MULTILINE), stage
    counts = {name: int(count) for name, count in re.findall(r"^(\w+) +(\d+) 1\.0 ", done.stdout, re.MULTILINE)}
    assert counts["FracOutput"] > counts["FracStep"] > 0 and counts["FracSetUp"] == 1
    assert (
        counts["FracEvaluate"] == counts["SNESFunctionEval"] > 0
        and counts["FracAssemble"] > 0
        and counts["FracLaws"] > 0
    )
