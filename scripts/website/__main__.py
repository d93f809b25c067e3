"""The site: every page of the project, its reference and its sources as static HTML, which opens from a disk.

scripts/docs [-o DIR]    by default into runs/site; exit code 2 where a link is broken
"""

from __future__ import annotations

import argparse
import html
import json
import posixpath
import shutil
import sys
from pathlib import Path
from urllib.parse import quote

from website.pages import ROOT, BrokenLink, Page, ordered, plain, url_of
from website.reference import made_pages
from website.render import Entry, Site, body_of, names_of, source_body

from fracflow._version import __version__

HERE = Path(__file__).parent
REFERENCE = ("meshes/SCENE.md", "fracflow/COMMANDS.md")  # beside the pages made of docstrings
ICON = "data:image/svg+xml," + quote(
    "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16' fill='none' stroke-width='2.4'>"
    "<path d='M1 13 8 5l7 2' stroke='#0072b2'/><path d='m5 1 7 14' stroke='#d55e00'/></svg>"
)


def build(out: Path, root: Path = ROOT, made: dict[str, Page] | None = None) -> list[str]:
    """Write the site of a checkout, with the pages ``made`` of docstrings; gives its pages, without those of sources.

    Raises BrokenLink before anything is written.
    """
    made = made_pages() if made is None else made
    groups = ordered(root, made)
    pages = [page for group in groups for page in group]
    site = Site(root, {page.path: page for page in pages})
    for path in (*REFERENCE, *made):
        site.names |= dict(names_of(site.pages[path])) if path in site.pages else {}
    entries: list[Entry] = []
    texts = {}
    for at, page in enumerate(pages):
        body, found = body_of(site, page)
        entries += found
        around = (pages[at - 1] if at else None, pages[at + 1] if at + 1 < len(pages) else None)
        texts[page.url] = whole(page, body + _around(page, *around), groups)
    for path in sorted(site.sources):
        shown = Page(path, "")
        texts[shown.url] = whole(shown, source_body(path, (root / path).read_text(encoding="utf-8")), groups)

    for place, text in texts.items():
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        (out / place).write_text(text, encoding="utf-8")
    for picture in site.pictures:
        (out / picture).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / picture, out / picture)
    style = (ROOT / "fracflow" / "run_report" / "page.css").read_text(encoding="utf-8")
    (out / "site.css").write_text(style + (HERE / "site.css").read_text(encoding="utf-8"), encoding="utf-8")
    shutil.copyfile(HERE / "site.js", out / "site.js")
    index = json.dumps(entries, ensure_ascii=False, separators=(",", ":"))
    (out / "search.js").write_text(f"entries = {index};\n", encoding="utf-8")
    return [page.url for page in pages]


def whole(page: Page, body: str, groups: list[list[Page]]) -> str:
    """A page with its head, its way to the others, and its foot."""
    up = "../" * page.url.count("/")
    front = groups[0][0].title
    title = page.title or page.path
    head = title if title == front else f"{title} · {front}"
    foot = f"fracflow {__version__}; written from {page.source or page.path} by scripts/docs."
    return "\n".join([
        "<!DOCTYPE html>", f'<html lang="en" data-up="{up}"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<title>{html.escape(head)}</title><link rel="icon" href="{ICON}">',
        f'<link rel="stylesheet" href="{up}site.css"><script defer src="{up}site.js"></script></head><body>',
        f"<nav>{_navigation(page, groups, up)}</nav>",
        f"<main>{body}<footer>{html.escape(foot)}</footer></main>",
        "</body></html>", "",
    ])  # fmt: skip


def _navigation(page: Page, groups: list[list[Page]], up: str) -> str:
    """The search, and all pages; below the open one its sections."""
    front = groups[0][0]
    parts = []
    for head, *others in groups[1:]:
        items = "".join(f"<li>{_entry(page, each, up)}</li>" for each in others)
        parts.append(f"<li>{_entry(page, head, up)}{f'<ul>{items}</ul>' if items else ''}</li>")
    search = '<input type="search" id="search" placeholder="Search" aria-label="Search" autocomplete="off">'
    return (
        f'<div class="top"><a class="brand" href="{up}{front.url}">{html.escape(front.title)}</a>{search}</div>'
        '<div id="found" hidden></div>'
        f"<details open><summary>Contents</summary><ol>{''.join(parts)}</ol></details>"
    )


def _entry(page: Page, each: Page, up: str) -> str:
    if each.path != page.path:
        return f'<a href="{up}{each.url}" title="{html.escape(each.title)}">{html.escape(each.short)}</a>'
    heads = [
        (page.tokens[at + 1], token) for at, token in enumerate(page.tokens) if token.tag == "h2" and token.nesting == 1
    ]
    inside = "".join(f'<li><a href="#{token.attrs["id"]}">{html.escape(plain(text))}</a></li>' for text, token in heads)
    return f'<a class="here" href="#" aria-current="page">{html.escape(each.short)}</a><ul class="inside">{inside}</ul>'


def _around(page: Page, before: Page | None, after: Page | None) -> str:
    """Links to the page before and to the next one."""
    parts = []
    for each, mark in ((before, "← {}"), (after, "{} →")):
        if each is not None:
            to = posixpath.relpath(each.url, posixpath.dirname(page.url) or ".")
            parts.append(f'<a href="{to}">{mark.format(html.escape(each.short))}</a>')
        else:
            parts.append("<span></span>")
    return f'<div class="around">{"".join(parts)}</div>'


def refused(line: str) -> int:
    """Print why there is no site, and give the exit code."""
    print(f"scripts/docs: {line}", file=sys.stderr)
    return 2


def main() -> None:
    """Write the site into a folder, and name its first page."""
    reader = argparse.ArgumentParser(prog="scripts/docs", description="Write the pages of the project as a site.")
    reader.add_argument("-o", "--output", type=Path, default=Path("runs/site"), metavar="DIR")
    out = reader.parse_args().output
    try:
        pages = build(out)
    except BrokenLink as error:
        sys.exit(refused(str(error)))
    except OSError as error:
        sys.exit(refused(f"{error.filename}: {error.strerror}; name another folder with -o"))
    print(f"{len(pages)} pages: {out / url_of('README.md')}")


if __name__ == "__main__":
    main()
