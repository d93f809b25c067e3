"""The pages: links lead somewhere, each picture stands in one place, code is as the program has it, tables are fresh."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import tomllib
import write_pages
from pages import PAGES, ROOT, TUTORIALS, Code, anchors, blocks, spans, targets, tokens
from website.pages import slug

from fracflow.cli.app import USAGE, app, commands, with_levels
from fracflow.scene.scene import Scene, load
from fracflow.scene.schema import rows

pytestmark = pytest.mark.serial
NAMES = {page: page.relative_to(ROOT).as_posix() for page in PAGES}
KEYS = {re.sub(r"\[\]", "", key.strip("[]") if key.startswith("[") else key) for key, *_ in rows(Scene.json_schema())}
TABLES = {key.split(".")[0] for key in KEYS if "." in key}
GENERATED = {"meshes/SCENE.md", "fracflow/COMMANDS.md"}
LONGEST_FRONT_PAGE = 150  # lines
OTHERS = {"build", "conda", "pip", "podman", "rattler-build", "ruff", "sbatch"}  # of their words files alone are known
each_page = pytest.mark.parametrize("page", PAGES, ids=NAMES.values())


# -- links and pictures


@each_page
def test_links_lead_somewhere(page):
    faults = []
    for _, target in targets(page):
        path, _, anchor = target.partition("#")
        if "://" in path or path.startswith("mailto:"):
            continue
        there = (page.parent / path).resolve() if path else page
        if not there.exists() or ROOT not in (there, *there.parents):
            faults.append(f"{target}: no such file")
        elif anchor and anchor not in anchors(there):
            faults.append(f"{target}: no such heading")
    assert faults == []


def test_each_picture_stands_in_one_place():
    shown = Counter((page.parent / to).resolve() for page in PAGES for kind, to in targets(page) if kind == "picture")
    kept = {path for path in (ROOT / "meshes").rglob("*.png")}
    assert {path: count for path, count in shown.items() if count > 1} == {}
    assert set(shown) == kept


def test_each_scene_is_in_an_index():
    linked = {(page.parent / target).resolve() for page in PAGES for _, target in targets(page)}
    assert {scene for scene in (ROOT / "meshes").rglob("scene.toml") if scene not in linked} == set()


def test_the_front_page_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= LONGEST_FRONT_PAGE


@each_page
def test_sentences_have_a_subject(page):
    """None begins with "what"; pages that are written from the sources are as these are."""
    texts = [token.content for token in tokens(page) if token.type == "inline"]
    found = [text for text in texts if re.search(r"(?:^|[.:;]\s+)What\b", text)]
    assert NAMES[page] in GENERATED or found == []


def test_headings_make_anchors_as_the_forge_does():
    assert slug("How far from converged?") == "how-far-from-converged"
    assert slug("Kept: a `key`, (2.1)-(2.9)") == "kept-a-key-21-29"


# -- files and keys that are named


@each_page
def test_files_that_are_named_exist(page):
    """A path in code, from the root, from ``fracflow/`` or from the page; after ``::`` a name defined there."""
    faults = []
    for span in spans(page):
        path, _, name = span.partition("::")
        if not re.fullmatch(r"\.?[\w./-]+/[\w.-]+\.(py|md|toml|csv|geo|sh)", path) or path.startswith("runs/"):
            continue
        found = [base / path for base in (ROOT, ROOT / "fracflow", page.parent) if (base / path).is_file()]
        if not found:
            faults.append(f"{span}: no such file")
        elif name and not re.search(rf"\b(def|class) {name}\b", found[0].read_text(encoding="utf-8")):
            faults.append(f"{span}: no such name there")
    assert faults == []


def unknown_keys(data: dict[str, object], path: str = "") -> list[str]:
    """Keys of a fragment of a scene that the schema does not have; names of the scene's own stand for NAME."""
    faults = []
    for name, value in data.items():
        key = next((key for key in (f"{path}{name}", f"{path}NAME") if key in KEYS or has_below(key)), None)
        if key is None:
            faults.append(f"{path}{name}")
            continue
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, dict) and has_below(key):
                faults += unknown_keys(each, f"{key}.")
    return faults


def has_below(key: str) -> bool:
    """Whether a table of that name has keys."""
    return any(each.startswith(f"{key}.") for each in KEYS)


@each_page
def test_keys_that_are_named_exist(page):
    """Code in lines that begins with the name of a table, a point and a key, with or without a value."""
    faults = []
    for span in spans(page):
        names = re.fullmatch(r"([a-z_]+(?:\.\w+)+) *(?:=.*)?", span)
        if names and names[1].split(".")[0] in TABLES and not names[1].endswith((".h5", ".md", ".py", ".toml")):
            faults += unknown_keys(nested(names[1].split(".")))
    assert faults == []


def nested(names: list[str]) -> dict[str, object]:
    """A table with one key in it, by the names on the way."""
    return {names[0]: nested(names[1:]) if names[1:] else 0}


# -- blocks of code


def of_language(language: str, pages: list[Path] = PAGES) -> list[object]:
    found = [(page, block) for page in pages for block in blocks(page) if block.language == language]
    return [pytest.param(page, block, id=f"{NAMES[page]}:{block.line}") for page, block in found]


def test_blocks_have_a_language_that_is_checked():
    known = {"sh", "toml", "python", "csv", ""}
    assert {block.language for page in PAGES for block in blocks(page)} <= known


@pytest.mark.parametrize("page, block", of_language("toml"))
def test_scenes_are_valid(page: Path, block: Code, tmp_path):
    """A whole scene loads; a ``fragment`` has keys that exist; a ``file`` of a tutorial may need a law from outside."""
    if "file" in block.words and page in TUTORIALS:
        return
    if "fragment" in block.words:
        assert unknown_keys(tomllib.loads(block.text)) == []
        return
    for table in blocks(page):
        if table.language == "csv":
            (tmp_path / "traces.csv").write_text(table.text, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(block.text, encoding="utf-8")
    assert load(tmp_path / "scene.toml").title


def test_the_first_scene_is_the_one_in_its_folder():
    folder, page = ROOT / "meshes" / "three_fractures", ROOT / "README.md"
    texts = {block.language: block.text for block in blocks(page)}
    assert texts["toml"] == (folder / "scene.toml").read_text(encoding="utf-8")
    assert texts["csv"] == (folder / "traces.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize("page, block", of_language("python", [page for page in PAGES if page not in TUTORIALS]))
def test_python_runs(page: Path, block: Code, tmp_path):
    """In a folder of its own that sees the scenes."""
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    done = subprocess.run([sys.executable, "-c", block.text], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


# -- commands


def command_lines(page: Path) -> list[str]:
    """Lines of ``sh`` blocks, and code in lines that is a command."""
    lines = [line for block in blocks(page) if block.language == "sh"
             for line in block.text.replace("\\\n", " ").splitlines()]  # fmt: skip
    starts = re.compile(r"(mpirun|fracflow|scripts/(run|test|docs|bench|figures)|pytest|python) ")
    return lines + [span for span in spans(page) if starts.match(span)]


@each_page
def test_commands_exist(page):
    faults = {line: fault for line in command_lines(page) if (fault := fault_of(shlex.split(line, comments=True)))}
    assert faults == {}


def fault_of(words: list[str]) -> str:
    """Why a command could not run; nothing where it could."""
    words = words[: words.index(">")] if words[-2:-1] == [">"] else words  # to a file
    if words[:1] == ["mpirun"]:
        words = words[3:]
    if words[:3] == ["python", "-m", "cProfile"]:
        words = ["python", *words[words.index("-m", 2) :]]
    if words[:2] == ["python", "-m"] or words[:3] == ["python", "-X", "importtime"]:
        words = words[words.index("-m") + 1 :]
    if not words or words[0] in (".", "cd", "git", "sudo"):
        return "" if words[:1] != ["."] or (ROOT / words[1]).is_file() else "no such file"
    name, rest = words[0], words[1:]
    if name == "fracflow":
        return fault_of_fracflow(rest)
    if name in ("scripts/bench", "scripts/figures"):
        return fault_of_script(name, rest)
    if name in ("scripts/run", "scripts/test", "scripts/docs", "pytest", "python", *OTHERS):
        paths = [word for word in rest if "/" in word and not word.startswith(("-", "runs/"))]
        missing = [path for path in paths if not is_there(path)]
        return f"{', '.join(missing)}: no such file or test" if missing else ""
    return f"{name}: no command that this test knows"


def is_there(path: str) -> bool:
    file, _, test = path.partition("::")
    return (ROOT / file).exists() and (not test or f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"))


def fault_of_fracflow(words: list[str]) -> str:
    """Parsed by the program's own parser, which reads no file."""
    words = [word for word in words if not word.startswith("[") and (not word.endswith("]") or "=[" in word)]
    if not words or words in (["--help"], ["--version"]) or words[0] == "COMMAND":
        return ""
    if words[0] not in commands():
        return f"{words[0]}: no such command"
    if words[1:] == []:  # in prose
        return ""
    try:
        commands()[words[0]].make_context(words[0], with_levels(words[1:]))
    except USAGE as error:
        return str(error)
    scenes = [word for word in words if word.startswith("meshes/") and not (ROOT / word).is_file()]
    return f"{scenes[0]}: no such file" if scenes else ""


def fault_of_script(script: str, words: list[str]) -> str:
    """Its name is that of a file or a package; its options stand in the sources there."""
    if words[0] in ("NAME", "GROUP"):
        return ""
    if script == "scripts/bench":
        sources = [ROOT / "scripts" / "benches" / f"{words[0]}.py"]
    else:
        sources = sorted((ROOT / "scripts" / f"figures_{words[0].replace('-', '_')}").glob("*.py"))
    if not sources or not sources[0].is_file():
        return f"{words[0]}: no such name"
    strings = {
        node.value for path in sources for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }  # fmt: skip
    unknown = [word for word in words[1:] if word.startswith("-") and word not in strings]
    return f"{', '.join(unknown)}: no such option" if unknown else ""


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("fracflow walk SCENE", "no such command"),
        ("mpirun -n 2 fracflow check SCENE --speed", "--speed"),
        ("fracflow run meshes/nowhere/scene.toml", "no such file"),
        ("scripts/bench nothing", "no such name"),
        ("scripts/figures work-precision --colour", "no such option"),
        ("pytest tests/nowhere", "no such file"),
        ("pytest tests/test_paper.py::test_nothing_at_all", "no such file or test"),
        ("make all", "no command that this test knows"),
    ],
)
def test_a_wrong_command_is_found(line, fault):
    assert fault in fault_of(shlex.split(line))


def test_an_unknown_key_is_found():
    assert unknown_keys(tomllib.loads("method.stepper = 'newmark'\nmethod.stopper = 1")) == ["method.stopper"]
    assert unknown_keys(tomllib.loads("[fracture.Anna]\naperture = 1\napperture = 1")) == ["fracture.NAME.apperture"]


# -- pages that follow from the sources


def test_generated_pages_are_fresh():
    stale = [NAMES[path] for path, text in write_pages.pages().items() if path.read_text(encoding="utf-8") != text]
    assert stale == [], "run: python scripts/write_pages.py"
    assert GENERATED <= set(NAMES.values())


@pytest.mark.parametrize(("words", "page"), [("schema", "meshes/SCENE.md"), ("help", "fracflow/COMMANDS.md")])
def test_commands_print_the_pages(words, page, capsys):
    app([words, "--markdown"], standalone_mode=False)
    assert capsys.readouterr().out == (ROOT / page).read_text(encoding="utf-8")


def test_the_index_names_the_equations_of_the_report():
    """Those of chapters 2 to 4; the page says which no code forms."""
    page = (ROOT / "fracflow" / "README.md").read_text(encoding="utf-8")
    (said,) = re.findall(r"([^.]*(?:\(\d\.\d+\)[^:]*)+) are steps of a derivation", " ".join(page.split()))
    derived = {number for match in write_pages.EQUATION.finditer(said) for number in write_pages.covered(match)}
    found = {number for entry in write_pages.entries() for number in entry.numbers}
    wanted = {(chapter, number) for chapter, last in ((2, 40), (3, 20), (4, 10)) for number in range(1, last + 1)}
    assert wanted - found == derived
