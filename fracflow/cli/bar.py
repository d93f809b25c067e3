"""A progress bar on a terminal, with a line of text below it: imported where there is one, as it takes a while."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
from rich.text import Text


class Bar(Progress):
    """The bar of a run with a name; lines for the same terminal come above it."""

    def __init__(self, console: Console, name: str) -> None:
        """On a console that is a terminal."""
        columns = TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn()
        self._below = self.inside = ""
        super().__init__(*columns, console=console, transient=True)
        self._task = self.add_task(name, total=None)

    def get_renderables(self) -> Any:
        """The bar, then the line."""
        yield from super().get_renderables()
        yield Text(self._below + self.inside)

    def show(self, line: str, share: float | None) -> None:
        """Show a line, and a share done or None where the end is not known."""
        self._below = line
        self.update(self._task, total=None if share is None else 1.0, completed=share or 0.0)
