"""The tutorials: what each page shows is what its commands print; the pages are short, and lead to one another."""

import pytest
from pages import ROOT, TUTORIALS, blocks, targets
from shown import difference, parts, path_of, printed

pytestmark = pytest.mark.serial
LONGEST = 120  # lines
NAMES = {page: page.relative_to(ROOT).as_posix() for page in TUTORIALS}


def marked(page):
    """The page; one that starts ranks has the machine for itself."""
    starts = any("mpirun" in block.text for block, _ in parts(page))
    return pytest.param(page, id=NAMES[page], marks=pytest.mark.starts_ranks if starts else ())


@pytest.mark.parametrize("page", [marked(page) for page in TUTORIALS])
def test_shown_output_is_printed(page, tmp_path, monkeypatch):
    """In a folder of its own that sees the scenes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    names, held = {"__name__": "tutorial"}, 0
    for block, shown in parts(page):
        output = printed(block, names)
        if shown is not None:
            held += 1
            fault = difference(shown, output)
            assert not fault, f"{NAMES[page]}:{block.line}: {fault}\nprinted:\n{output}"
    assert held, "a tutorial shows what its commands print"


@pytest.mark.parametrize("page", TUTORIALS, ids=NAMES.values())
def test_a_tutorial_has_its_form(page):
    """Short; what one learns and how long it takes on top; scenes as they are in the folder; the next one at the end."""
    text = page.read_text(encoding="utf-8")
    lines = text.splitlines()
    assert len(lines) <= LONGEST
    top = " ".join(lines[1:8])
    assert "**You learn**" in top and "**Time:**" in top
    files = {
        kind: [path.read_text(encoding="utf-8") for path in page.parent.glob(f"*.{kind}")] for kind in ("py", "toml")
    }
    scenes = [block.text for block in blocks(page) if block.language == "toml" and "fragment" not in block.words]
    assert [scene for scene in scenes if scene not in files["toml"]] == []
    laws = [block.text for block in blocks(page) if block.language == "python" and "file" in block.words]
    assert [law for law in laws if not any(law in file for file in files["py"])] == []
    order = path_of()
    after = order[(order.index(page) + 1) % len(order)]
    assert lines[-1].startswith("**Next:**") or lines[-2].startswith("**Next:**")
    last = [(page.parent / target).resolve() for _, target in targets(page)][-1]
    assert last == (after if after != order[0] else page.parent.parent / "README.md")


def test_the_index_names_each_tutorial():
    assert sorted(path_of()) == TUTORIALS


SHOWN = "pressure 7.64 MPa\nsteps 84\n"


@pytest.mark.parametrize(
    ("shown", "output", "agrees"),
    [
        (SHOWN, "pressure  7.6373 MPa\n│ steps │ 84 │\n", True),
        (SHOWN, "pressure 7.66 MPa\nsteps 84\n", False),
        (SHOWN, "pressure 7.64 MPa\nsteps 85\n", False),
        (SHOWN, "pressure 7.64 kPa\nsteps 84\n", False),
        (SHOWN, "steps 84\npressure 7.64 MPa\n", False),
        (SHOWN, SHOWN + "a warning\n", False),
        (SHOWN + "...\n", SHOWN + "a warning\n", True),
        ("...\nsteps 84\n", SHOWN, True),
        ("steps 84\n", SHOWN, False),
        ("...\nit took 12 CPU s\n", "x\nit took 3.5 CPU s\n", True),
        ("energy 1.9e-07 J\n", "energy 2.5e-07 J\n", False),
        ("energy 1.9e-07 J\n", "energy 1.94e-07 J\n", True),
    ],
)
def test_a_difference_is_found(shown, output, agrees):
    assert (difference(shown, output) == "") == agrees
