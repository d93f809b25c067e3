"""The page of all commands: their arguments, options and exit codes, as the command line itself declares them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HEAD = """# Commands

Written by `fracflow help --markdown`. `fracflow COMMAND --help` prints the same in a terminal. `fracflow new first` writes the
scene that the examples are of.
`fracflow --version` prints versions: fracflow, Python, PETSc with its packages, MPI with its ranks, and NumPy to Matplotlib.

| exit code | meaning |
|---|---|
| 0 | done |
| 2 | bad input; one line names the place and a remedy |
| 3 | the solve or the disk failed; the last good state is saved, and its pictures are drawn |
| 130 | interrupted; the state is saved |

A line after `! ` is a warning with its remedy; nothing is to be done about one after `note: `.
"""


EXAMPLES = {
    "new": "fracflow new first",
    "check": "fracflow check first/scene.toml",
    "mesh": "fracflow mesh first/scene.toml",
    "picture": "fracflow picture first/scene.toml",
    "run": "fracflow run first/scene.toml -o runs/first",
    "resume": "fracflow resume runs/first",
    "report": "fracflow report runs/first",
    "export": "fracflow export runs/first --csv",
    "schema": "fracflow schema --json > scene.schema.json",
    "help": "fracflow help",
}
"""An example of each command; one after the other they work in any folder."""


def markdown(commands: Mapping[str, Any]) -> str:
    """The page in Markdown of commands by name, as ``typer.main.get_command`` gives them."""
    return HEAD + "".join(_section(name, command) for name, command in commands.items())


def _section(name: str, command: Any) -> str:
    options = [one for one in command.params if one.opts[0].startswith("-")]
    words = [one.name.upper() for one in command.params if one not in options]
    usage = " ".join(["fracflow", name, *words, *(["[OPTIONS]"] if options else [])])
    rows = [f"| `{word}` | {one.help} |" for one in command.params for word in [_word(one)]]
    table = ["", "| argument or option | meaning |", "|---|---|", *rows] if rows else []
    example = ["", "```sh", EXAMPLES[name], "```"]
    return "\n".join(["", f"## fracflow {name}", "", f"`{usage}`", "", command.help, *table, *example, ""])


def _word(one: Any) -> str:
    """An argument's or option's name, with the value that it takes."""
    if not one.opts[0].startswith("-"):
        return str(one.name.upper())
    value = "" if one.is_flag else f" {one.metavar or one.name.rstrip('_').upper()}"
    return ", ".join(one.opts) + (" KEY=VALUE" if one.opts == ["--set"] else value)
