"""The tutorials, run: the commands and the Python of a page in turn, and their output held against the block shown."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise
from pathlib import Path

from pages import ROOT, TUTORIALS, Code, blocks, targets

from fracflow.cli.app import app, with_levels

INDEX = ROOT / "meshes" / "README.md"
FRAMES = re.compile(r"\x1b\[[\d;]*m|[\u2500-\u257f]")  # of tables, and their colours
VARIES = re.compile(r"\d[\d.]* CPU s\b|\b\d+\.\d+\.\d+\b|\b\d+ factorisations\b")
"""Times, versions, and factorisations, which are kept where that was measured to be faster."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
GAP = "..."


def path_of(index: Path = INDEX) -> list[Path]:
    """The tutorials in the order in which the index names them."""
    named = [(index.parent / target).resolve() for _, target in targets(index)]
    return list(dict.fromkeys(page for page in named if page in TUTORIALS))


def parts(page: Path) -> Iterator[tuple[Code, str | None]]:
    """Each block of commands or of Python, and the output shown after it, None where none is.

    Left out are blocks marked "long", and "file": what stands in a file of the folder.
    """
    found = [*blocks(page), Code("", (), "", 0)]
    for block, after in pairwise(found):
        if block.language in ("sh", "python") and not {"long", "file"} & {*block.words}:
            yield block, after.text if after.line and after.language == "" else None


def printed(block: Code, names: dict[str, object]) -> str:
    """The output of a block in the working folder; Python sees ``names``, and adds to them."""
    out = StringIO()
    with redirect_stdout(out):
        if block.language == "python":
            exec(compile(block.text, "tutorial", "exec"), names)
        else:
            for line in block.text.replace("\\\n", " ").splitlines():
                print(_output(shlex.split(line, comments=True)), end="")
    return out.getvalue()


def _output(words: list[str]) -> str:
    """The output of a command: of fracflow in this process, which has read its modules already; runs draw no pictures."""
    words = [*words, *(("--set", "output.pictures=false") if "run" in words else ())]
    if words[:1] == ["fracflow"]:
        out = StringIO()
        with redirect_stdout(out):
            app(with_levels(words[1:]), standalone_mode=False)
        return out.getvalue()
    known = {"fracflow": [sys.executable, "-m", "fracflow"], "python": [sys.executable]}
    command = [part for word in words for part in known.get(word, [word])]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert done.returncode == 0, f"{shlex.join(words)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def difference(shown: str, output: str) -> str:
    """The first line shown that the output lacks; empty where it has all, in a row, but for lines left out at "...".

    Numbers agree to one unit of the last digit shown, whole numbers exactly. Frames and widths of tables, times of
    computing, versions and numbers of factorisations are left aside.
    """
    lines, at, may_skip = _plain(output), 0, False
    for line in _plain(shown):
        if line == GAP:
            may_skip = True
            continue
        last = len(lines) if may_skip else min(at + 1, len(lines))
        found = next((number for number in range(at, last) if _agree(line, lines[number])), None)
        if found is None:
            return f"{line}\nin place of\n" + "\n".join(lines[at:last])
        at, may_skip = found + 1, False
    return "" if may_skip or at == len(lines) else "left out, without ...:\n" + "\n".join(lines[at:])


def _plain(text: str) -> list[str]:
    lines = (" ".join(VARIES.sub("TIME", FRAMES.sub(" ", line)).split()) for line in text.splitlines())
    return [line for line in lines if line]


def _agree(shown: str, output: str) -> bool:
    if NUMBER.sub("#", shown) != NUMBER.sub("#", output):
        return False
    return all(map(_near, NUMBER.findall(shown), NUMBER.findall(output)))


def _near(shown: str, output: str) -> bool:
    mantissa, _, power = shown.partition("e")
    decimals = len(mantissa.partition(".")[2])
    if not decimals and not power:
        return shown == output
    return abs(float(shown) - float(output)) <= 1.01 * 10.0 ** (int(power or 0) - decimals)
