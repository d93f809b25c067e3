"""Convergence as the terminal tells it, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fracflow.output.convergence import Row
from fracflow.output.look import COLOURS, INK, PALE, STYLE, fonts, one_note_on_letters

MOST_ROWS = 40
MOST_LINES = 7


def tell(rows: Sequence[Row], console: Console, levels: int, order: int) -> None:
    """Print the rows as a table, and how many of them are not to be trusted."""
    observed = "observed" if levels > 2 else "assumed"
    table = Table("", "quantity", "size", "last difference", f"order ({observed})", "error", "relative", box=None)
    table.title, table.title_style = f"Convergence over {levels} levels; errors are estimates for the last", "bold"
    for row in rows[:MOST_ROWS]:
        moved = f"{row.differences[-1]:.2e}" if row.differences else "-"
        seen = row.order if levels > 2 else row.least
        cells = (row.kind, row.name, _short(row.size), moved, _short(seen, ".2f"), _short(row.error, ".2e"))
        mark = "!" if row.warning else ""
        table.add_row(*map(escape, cells), f"{_short(row.relative, '.1e')} {mark}", style="bold" if mark else "")
    console.print(table)
    if len(rows) > MOST_ROWS:
        console.print(f"and {len(rows) - MOST_ROWS} more in converge.csv")
    if levels == 2:
        console.print(f"two levels show no order: errors assume that of the method, {order}", soft_wrap=True)
    for warning in dict.fromkeys(row.warning for row in rows if row.warning):
        names = [row.name for row in rows if row.warning == warning]
        few = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        console.print(f"! outside the asymptotic range: {few}: {warning}", soft_wrap=True, markup=False)


def _short(value: float, form: str = ".4g") -> str:
    return "-" if np.isnan(value) else format(value, form)


def draw(rows: Sequence[Row], folder: Path) -> Path:
    """Draw ``converge.png``: relative differences of probes, energies and events by level, beside orders 1 and 2."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({**STYLE, "font.family": fonts()}), one_note_on_letters():
        figure = Figure(figsize=(6.4, 4.8), layout="constrained")
        axes = figure.subplots()
        shown = [row for row in rows if row.differences and row.size > 0.0 and min(row.differences) > 0.0]
        for row in (row for row in shown if row.kind == "energy"):
            axes.loglog(_sizes(row), np.divide(row.differences, row.size), "-", color=PALE, linewidth=0.8)
        others = [row for row in shown if row.kind != "energy"]
        for row, colour in zip(others[:MOST_LINES], COLOURS, strict=False):
            axes.loglog(_sizes(row), np.divide(row.differences, row.size), "o-", color=colour, label=row.name)
        if shown:
            sizes = _sizes(shown[0])
            top = max(row.differences[0] / row.size for row in shown)
            for order, style in ((1, ":"), (2, "--")):
                axes.loglog(sizes, 2.0 * top * sizes**order, style, color=INK, linewidth=0.9, label=f"order {order}")
            axes.set_xticks(sizes, [f"{level} to {level + 1}" for level in range(len(sizes))])
            axes.set_xticks([], minor=True)
            axes.legend(fontsize=7)
        axes.set_xlabel("from level to level")
        axes.set_ylabel("difference, relative")
        axes.set_title("Convergence (energies in grey)")
        part = folder / "converge.png.part"
        figure.savefig(part, format="png")
    part.replace(folder / "converge.png")
    return folder / "converge.png"


def _sizes(row: Row) -> np.ndarray:
    """Mesh size of the coarser of two levels, over that of the first."""
    return np.asarray(0.5 ** np.arange(len(row.differences)))
