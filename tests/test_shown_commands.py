"""The commands that pages show, run in turn: those of fracflow as they stand, in a folder that sees the scenes.

Scripts, ranks, whole applications and tutorials are run where the tables say.
"""

from __future__ import annotations

import fnmatch
import shlex

import pytest
from pages import PAGES, ROOT, blocks
from stopped_run import spoken

from fracflow._petsc import PETSc

pytestmark = pytest.mark.serial

ELSEWHERE = {  # lines as patterns -> why they are not run here as they stand
    ". scripts/setup.sh": "the environment of this suite",
    "scripts/run": "sets up the machine, then runs the application of tests/report/test_report_5_3_5_5.py",
    "scripts/test*": "is this suite",
    "python -m pytest *": "is this suite",
    "mpirun -n 2 python -m pytest *": "is this suite",
    "mpirun -n 2 fracflow run *": "starts ranks: tests/parallel/test_same_on_ranks.py",
    "fracflow run meshes/three_fractures/*": "tests/report/test_scenes.py runs the scene",
    "fracflow run * --converge*": "SCENE is any scene: tests/reference/test_converge.py",
    "fracflow export * --quakeml *": "needs a catalogue: tests/output/test_quakeml.py",
    "fracflow picture meshes/*": "tests/output/test_before_a_run.py draws scenes",
    "scripts/docs*": "sets up the machine: tests/test_site.py builds and opens the site",
    "scripts/figures GROUP *": "GROUP is any",
    "scripts/figures report *": "tests/report/test_figures.py",
    "scripts/figures plan *": "tests/plan/test_twins.py",
    "scripts/bench NAME": "NAME is any",
    "python -m ruff format *": "would write into the checkout",
    "python scripts/write_pages.py": "would write into the checkout: tests/test_paper.py compares",
    "python -m build": "tests/test_package.py builds both",
    "pip install *": "tests/test_package.py installs the wheel",
    "sbatch *": "needs Slurm: tests/test_package.py runs the job script",
    "python tests/test_docstrings.py": "tests/test_docstrings.py counts the same",
}
PAGES_ELSEWHERE = {
    "meshes/*/README.md": "tutorials are run with the output that they show",
    "fracflow/COMMANDS.md": "written from the commands; tests/cli runs the example of each help",
}
SHORT = ("--set", "stage.failure.steps=3", "--set", "output.pictures=false")  # of runs: tests/report has whole ones
ANY_SCENE = "meshes/report_5_3/scene.toml"


def shown():
    """The lines of blocks in ``sh`` of pages that are run here, without comments, each once."""
    pages = [page for page in PAGES if not any(page.match(pattern) for pattern in PAGES_ELSEWHERE)]
    texts = [block.text for page in pages for block in blocks(page) if block.language == "sh"]
    lines = [shlex.join(shlex.split(line, comments=True)) for text in texts for line in text.splitlines()]
    return list(filter(None, dict.fromkeys(lines)))


def reason(line):
    return next((why for pattern, why in ELSEWHERE.items() if fnmatch.fnmatch(line, pattern)), "")


def test_the_commands_run(tmp_path, monkeypatch, capfd):
    """One after another: later ones read ``runs/mine`` of the front page."""
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    monkeypatch.chdir(tmp_path)
    lines = [line for line in shown() if not reason(line)]
    before = PETSc.Options().getAll().keys()
    assert len(lines) > 6
    for line in lines:
        words = shlex.split(line.replace("SCENE", ANY_SCENE).partition(" '>' ")[0])
        assert words[0] == "fracflow", f"{line}: run it here, or name in ELSEWHERE where it is run"
        end = words.index("--") if "--" in words else len(words)
        words[end:end] = SHORT if words[1] == "run" else ()
        code, said = spoken(words[1:], monkeypatch, capfd)
        for name in PETSc.Options().getAll().keys() - before:  # those after --, which PETSc would keep
            PETSc.Options().delValue(name)
        assert code == 0, f"{line}: {said}"


def test_the_table_names_lines_that_are_shown():
    assert [pattern for pattern in ELSEWHERE if not any(fnmatch.fnmatch(line, pattern) for line in shown())] == []
    named = {word.rstrip(":,") for why in ELSEWHERE.values() for word in why.split() if word.startswith("tests/")}
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
