"""The site of ``scripts/docs``: its links, its pages in a real browser, its search, and pages that are added."""

from __future__ import annotations

import posixpath
import sys
import time
from html.parser import HTMLParser
from urllib.parse import unquote

import pytest
from chromium import Chromium
from pages import PAGES, ROOT, anchors
from website import __main__ as driver
from website.__main__ import build
from website.pages import BrokenLink, Page, ordered, url_of
from website.reference import described, escaped, made_pages
from website.render import Site, body_of

from fracflow.scene.scene import Scene
from fracflow.scene.schema import rows

pytestmark = pytest.mark.serial
WIDTHS = {"desktop": 1280, "phone": 390}


class Read(HTMLParser):
    """Names and targets of a page."""

    def __init__(self, path):
        super().__init__()
        self.names, self.targets = [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.names += [found["id"]] if "id" in found else []
        self.targets += [found[key] for key in ("href", "src") if key in found]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    return folder, build(folder)


@pytest.fixture(scope="module")
def browser():
    with Chromium() as found:
        yield found


def test_every_link_leads_to_a_file_and_a_name_in_it(site):
    folder, _ = site
    read = {path.relative_to(folder).as_posix(): Read(path) for path in folder.rglob("*.html")}
    faults = []
    for page, found in read.items():
        assert len(found.names) == len(set(found.names)), page
        for target in found.targets:
            path, _, name = target.partition("#")
            if target.startswith(("https://", "http://", "data:")):
                continue
            there = posixpath.normpath(posixpath.join(posixpath.dirname(page), unquote(path))) if path else page
            if not (folder / there).is_file() or (name and name not in read[there].names):
                faults.append(f"{page}: {target}")
    assert faults == []
    assert len(read) > 60


def test_every_page_key_command_and_name_is_there(site):
    folder, pages = site
    shown = {url_of(page.relative_to(ROOT).as_posix()) for page in PAGES if page.name == "README.md"}
    assert shown | {"CHANGELOG.html", "meshes/SCENE.html", "fracflow/COMMANDS.html", "github/SECURITY.html"} <= set(
        pages
    )
    keys = {key for key, *_ in rows(Scene.json_schema()) if not key.startswith("[")}
    index = (folder / "search.js").read_text(encoding="utf-8")
    assert [key for key in keys if f'"{key}"' not in index.replace('\\"', '"')] == []
    python = Read(folder / "fracflow" / "python.html").names
    assert {"fracflowload", "fracflowrun", "fracflowopen", "run", "runprobe", "runhistory", "inputerror"} <= set(python)
    for page in PAGES:
        made = folder / url_of(page.relative_to(ROOT).as_posix())
        assert not made.exists() or anchors(page) <= set(Read(made).names), page


def test_every_page_opens_without_a_fault_and_fits_a_phone(site, browser):
    folder, pages = site
    browser.faults.clear()
    for width in WIDTHS.values():
        for page in (*pages, "fracflow/laws/base.py.html"):
            browser.open(folder / page, width)
            assert browser.value("document.documentElement.scrollWidth") <= width, (page, width)
            assert browser.value("document.querySelectorAll('nav ol a').length") >= len(pages) - 1
            lost = "[...document.images].filter(each => each.complete && !each.naturalWidth).map(each => each.src)"
            assert browser.value(lost) == [], page
    assert browser.faults == []


def search(browser, words):
    """Addresses that the search of the open page finds, best first."""
    browser.value(f"field.value = {words!r}; field.dispatchEvent(new Event('input')); 0")
    end = time.monotonic() + 20
    while not browser.value("found.textContent"):
        assert time.monotonic() < end, "the search shows nothing"
        time.sleep(0.02)
    return browser.value("[...found.querySelectorAll('a')].map(each => each.href)")


@pytest.mark.parametrize("width", WIDTHS.values(), ids=WIDTHS)
def test_the_search_finds_keys_commands_names_and_equations(site, browser, width):
    folder, _ = site
    browser.faults.clear()
    browser.open(folder / "meshes" / "index.html", width)
    for words, address in {
        "stick_slip_ratio": "meshes/SCENE.html#fracture.NAME.stick_slip_ratio",
        "resume": "fracflow/COMMANDS.html#fracflow-resume",
        "Run.probe": "fracflow/python.html#runprobe",
        "2.31": "fracflow/equations.html#2.15---2.19-2.31",
        "wells pressure rate": "fracflow/output/index.html#wells",
    }.items():
        assert (folder / address).as_uri().replace("%23", "#") in search(browser, words)[:3], words
    assert search(browser, "no xylophone here") == [] and "Nothing" in browser.value("found.textContent")
    first = search(browser, "QuakeML")[0]
    assert browser.follow("#found a").value("location.href") == first
    assert browser.faults == []


def small(root, **pages):
    """A project of few pages, by their folders."""
    for folder, text in {"": "# Front\n\n[b](b/README.md) [a](a/README.md)\n", **pages}.items():
        (root / folder).mkdir(parents=True, exist_ok=True)
        (root / folder / "README.md").write_text(text)
    return root


def test_pages_that_are_added_appear_with_their_titles_in_the_order_of_links(tmp_path):
    root = small(tmp_path / "in", **{
        "a": "# A: its folder", "b": "# B\n\n[2](two/README.md) [1](one/README.md)\n",
        "b/one": "# One: a tutorial", "b/two": "# Two", "b/three": "# Three, which no page names yet",
    })  # fmt: skip
    made = {"a/names.md": Page("a/names.md", "# Names")}
    groups = [[page.short for page in group] for group in ordered(root, made)]
    assert groups == [["Front"], ["B", "Two", "One", "Three, which no page names yet"], ["A", "Names"]]
    pages = build(tmp_path / "out", root, made)
    assert pages[:3] == ["index.html", "b/index.html", "b/two/index.html"]
    assert (
        '<a href="../../b/one/index.html" title="One: a tutorial">One</a>'
        in (tmp_path / "out/b/two/index.html").read_text()
    )


@pytest.mark.parametrize("target", ["../c.md", "nothing.py", "../README.md#nowhere", "../../outside.txt", "none.png"])
def test_a_broken_link_is_named_and_nothing_is_written(tmp_path, target):
    (tmp_path / "outside.txt").write_text("")
    root = small(tmp_path / "in", a=f"# A\n\n[x]({target})\n", b="# B")
    with pytest.raises(BrokenLink, match=r"^a/README.md: \S+: no such (file|heading)$"):
        build(tmp_path / "out", root, {})
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(sys, "argv", ["docs", "-o", str(tmp_path / "file")])
    monkeypatch.setattr(driver, "build", lambda out: build(out, small(tmp_path / "in", a="# A", b="# B"), {}))
    with pytest.raises(SystemExit, match="2"):
        driver.main()
    assert capsys.readouterr().err == f"scripts/docs: {tmp_path / 'file'}: File exists; name another folder with -o\n"


def test_docstrings_are_shown_as_they_are():
    def law():
        """Rate (n,) of ``x_a`` * 2 < 3 [length]. Raises InputError for nothing.

        rate   (n,) [length/time]
        other  a name
               that goes on
        """

    text = described(law)
    assert r"\[length\]" in text and "``x_a``" in text and "**Raises** ``InputError`` for nothing." in text
    assert "| `other` | a name that goes on |" in text
    page = Page("p.md", f"# {escaped('<b> *')}\n\n{text}")
    body, _ = body_of(Site(ROOT, {"p.md": page}), page)
    assert "<h1" in body and "&lt;b&gt; *" in body and "<em>" not in body and "* 2 &lt; 3 [length]." in body


def test_members_of_a_class_have_signatures_as_the_source_has_them():
    text = made_pages()["fracflow/python.md"].text
    assert "run(scene: Scene, out: str | Path | None = None, trust: bool = False) -> Run" in text
    assert "history: Arrays" in text and "probe(name: str) -> Arrays" in text
