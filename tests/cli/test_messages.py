"""Every message of a refusal says what to do: of the command line, the scene and the run."""

import ast
import re
import runpy
import sys
from pathlib import Path

import pytest
from pages import ROOT

from fracflow.cli.exit import abort
from fracflow.cli.run import warned_in

pytestmark = pytest.mark.serial
RAISED = {"InputError", "SolveError", "fault"}
REMEDY = re.compile(
    r"\b(?:must|give|name (?:another|one|a|the)|missing;.* needs|needs (?:at least|two)|"
    r"remove|rename|leave|choose|use|set|take|raise|lower|change|close|correct|shorten|write|save|join|put|"
    r"allowed|did you mean|required|such as|decimals take)\b"
)
MADE_ELSEWHERE = {"error", "text", "failure", "why", "found", "fits", "nearest", "one_line", "more", "no_plain_file"}


def literal(node: ast.expr) -> str:
    """The text of a message, with the names of what stands in it."""
    return " ".join(
        [part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    )


def comes_from_elsewhere(node: ast.expr) -> bool:
    """Whether a message ends in a text that another function makes, its remedy with it."""
    end = node.values[-1] if isinstance(node, ast.JoinedStr) else node
    names = {part.id for part in ast.walk(end) if isinstance(part, ast.Name)}
    names |= {part.attr.lstrip("_") for part in ast.walk(end) if isinstance(part, ast.Attribute)}
    return bool(names & MADE_ELSEWHERE)


def messages(path: Path):
    """(line, message) of the refusals of a file: those raised, and second entries of pairs that checks yield."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in RAISED and node.args:
            yield node.lineno, node.args[0]
        if isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple) and path.name == "checks.py":
            yield node.lineno, node.value.elts[1]


def test_refusals_have_a_remedy():
    found, without = 0, []
    for package in ("cli", "scene", "simulation"):
        for path in sorted((ROOT / "fracflow" / package).glob("*.py")):
            for line, message in messages(path):
                found += 1
                if (
                    literal(message).strip()
                    and not comes_from_elsewhere(message)
                    and not REMEDY.search(literal(message))
                ):
                    without.append(f"{path.relative_to(ROOT)}:{line}: {literal(message)}")
    assert found > 120
    assert without == []


def test_a_message_without_remedy_is_found(tmp_path):
    source = 'raise InputError(f"{name}: is wrong")\nraise fault("is wrong; give another")\nraise InputError(why)\n'
    (tmp_path / "checks.py").write_text(source + 'def f():\n    yield ("a",), "is wrong"\n')
    found = [REMEDY.search(literal(each)) is None for _, each in messages(tmp_path / "checks.py") if literal(each)]
    assert found.count(True) == 2 and found.count(False) == 1


def test_a_fault_in_a_script_names_its_line(tmp_path, monkeypatch, capsys):
    """The script that registers a law is the user's: nobody need report what goes wrong there."""
    script = tmp_path / "law.py"
    script.write_text("def evaluate():\n    return [][0]\n")
    for program, says in (
        (script, f"a fault in line 2 of {script}; mend it"),
        (tmp_path / "other.py", "a fault of the program"),
    ):
        monkeypatch.setattr(sys, "argv", [str(program)])
        try:
            runpy.run_path(str(script))["evaluate"]()
        except IndexError:
            with pytest.raises(SystemExit) as end:
                abort()
        assert end.value.code == 1 and says in capsys.readouterr().err.splitlines()[-1]


def test_a_failed_run_repeats_what_its_log_warned_of(tmp_path):
    """From its first stage on: a terminal has shown those before it, and has the error of the last step."""
    lines = (
        "! before",
        "stage 0 (draw) from time 0",
        "! time 2 s: below zero",
        "note: later",
        "! step given up: at 3 s",
    )
    (tmp_path / "log.txt").write_text("\n".join(lines), encoding="utf-8")
    assert warned_in(tmp_path) == ["! time 2 s: below zero"]
    assert warned_in(tmp_path / "none") == []
