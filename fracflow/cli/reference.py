"""The page of all commands: their arguments, options and exit codes, as the command line itself declares them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HEAD = """# Commands

Written by `fracflow help --markdown`. `fracflow COMMAND --help` prints the same in a terminal.
`fracflow --version` prints versions: fracflow, Python, PETSc with its packages, MPI with its ranks, and NumPy to Matplotlib.

| exit code | meaning |
|---|---|
| 0 | done |
| 2 | bad input; one line names the place and a remedy |
| 3 | the solve or the disk failed; the last good state is saved, and its pictures are drawn |
| 130 | interrupted; the state is saved |
"""


def markdown(commands: Mapping[str, Any]) -> str:
    """The page in Markdown of commands by name, as ``typer.main.get_command`` gives them."""
    return HEAD + "".join(_section(name, command) for name, command in commands.items())


def _section(name: str, command: Any) -> str:
    options = [one for one in command.params if one.opts[0].startswith("-")]
    words = [one.name.upper() for one in command.params if one not in options]
    usage = " ".join(["fracflow", name, *words, *(["[OPTIONS]"] if options else [])])
    rows = [f"| `{word}` | {one.help} |" for one in command.params for word in [_word(one)]]
    table = ["", "| argument or option | meaning |", "|---|---|", *rows] if rows else []
    return "\n".join(["", f"## fracflow {name}", "", f"`{usage}`", "", command.help, *table, ""])


def _word(one: Any) -> str:
    """An argument's or option's name, with the value that it takes."""
    if not one.opts[0].startswith("-"):
        return str(one.name.upper())
    value = "" if one.is_flag else f" {one.metavar or one.name.rstrip('_').upper()}"
    return ", ".join(one.opts) + (" KEY=VALUE" if one.opts == ["--set"] else value)
