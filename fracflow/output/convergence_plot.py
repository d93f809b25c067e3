"""Convergence on the terminal, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fracflow.output.convergence import LATITUDE, Row
from fracflow.output.plot_style import COLOURS, INK, PALE, plain, styled
from fracflow.storage.files import fresh, replacing

KINDS = ("event", "control", "probe", "energy")
MOST_ROWS = 40
MOST_LINES = 7


def tell(
    rows: Sequence[Row], console: Console, levels: int, order: int, has_tips: bool = False, corrected: bool = False
) -> None:
    """Print the rows as a table, with assumed and low orders, and unreliable rows.

    order      that of the method; ``has_tips`` where fractures end in rock
    corrected  whether cells are corrected there: the order is 2 where fractures open or slide, and 1 where joints hold them
    """
    observed = "observed" if levels > 2 else "assumed"
    title = f"Convergence over {levels} levels, orders as {observed}, errors of the last as estimated"
    table = Table(box=None, pad_edge=False, title=title, title_style="bold")
    for head in ("", "quantity", "change", "difference", "order", "error", "error/change"):
        table.add_column(head, no_wrap=True, min_width=None if head == "quantity" else len(head))
    seen = sorted((row for row in rows if row.is_seen), key=lambda row: KINDS.index(row.kind))
    for row in seen[:MOST_ROWS]:
        moved = f"{row.differences[-1]:.2e}" if row.differences else "-"
        order_of = row.order if levels > 2 else row.least
        name = f"{row.name} [{row.unit}]" if row.unit else row.name
        cells = (row.kind, name, _short(row.change), moved, _short(order_of, ".2f"), _short(row.error, ".2e"))
        mark = "!" if row.warning else ""
        table.add_row(*map(escape, cells), f"{_short(row.relative, '.1e')} {mark}", style="bold" if mark else "")
    console.print(table)
    if len(seen) > MOST_ROWS:
        console.print(f"and {len(seen) - MOST_ROWS} more in converge.csv")
    if len(seen) < len(rows):
        console.print(f"{len(rows) - len(seen)} quantities are the same on all levels, to round-off")
    if levels == 2:
        of_method = f"that of the method, {order}, and 1 of strains, stresses and flow rates"
        assumed = "1, that of fractures' tips in rock" if has_tips else of_method
        if has_tips and corrected:
            assumed += (
                ' where joints hold the walls; by method.tips = "corrected" errors are less where these open or slide'
            )
        console.print(f"two levels show no order: errors assume {assumed}", soft_wrap=True)
    if low := [row for row in rows if not row.warning and row.order < (order if has_tips else row.least) - LATITUDE]:
        why = "tips of fractures in rock" if has_tips else "a kink or a jump; one more level shows whether they stay"
        console.print(f"orders below the method's, {order}: {_few(low)}: {why}", soft_wrap=True, markup=False)
    for warning in dict.fromkeys(row.warning for row in rows if row.warning):
        names = _few([row for row in rows if row.warning == warning])
        console.print(f"! not to be trusted: {names}: {warning}", soft_wrap=True, markup=False)


def _few(rows: Sequence[Row]) -> str:
    """Names of the first rows, and how many more there are."""
    return ", ".join(row.name for row in rows[:3]) + (f" and {len(rows) - 3} more" if len(rows) > 3 else "")


def _short(value: float, form: str = ".4g") -> str:
    return "-" if np.isnan(value) else format(value, form)


def draw(rows: Sequence[Row], folder: Path) -> Path:
    """Draw ``converge.png``: differences from level to level and the error of the last, relative, beside orders 1 and 2.

    First events and controls, then of each quantity the probe that is worst, and energies in grey.
    """
    from matplotlib.figure import Figure

    shown = [row for row in rows if row.is_seen and row.differences and row.change > 0.0 and min(row.differences) > 0.0]
    with styled():
        figure = Figure(figsize=(8.0, 4.8), layout="constrained")
        axes = figure.subplots()
        for row in (row for row in shown if row.kind == "energy"):
            axes.loglog(*_line(row), "-", color=PALE, linewidth=0.8)
        for row, colour in zip(_worst(shown)[:MOST_LINES], COLOURS, strict=False):
            axes.loglog(*_line(row), "o-", color=colour, label=plain(row.name))
            if np.isfinite(row.error) and row.error > 0.0:
                axes.loglog(0.5 ** len(row.differences), row.error / row.change, "o", color=colour, fillstyle="none")
        if shown:
            sizes = 0.5 ** np.arange(len(shown[0].differences) + 1)
            top = 2.0 * max(row.differences[0] / row.change for row in shown)
            for order, style in ((1, ":"), (2, "--")):
                axes.loglog(sizes, top * sizes**order, style, color=INK, linewidth=0.9, label=f"order {order}")
            axes.set_xticks(sizes, [str(level) for level in range(len(sizes))])
            axes.set_xticks([], minor=True)
            axes.invert_xaxis()
            figure.legend(loc="outside right upper", fontsize=7)
        axes.set_xlabel("level")
        axes.set_ylabel("difference to the next level; hollow: estimated error")
        axes.set_title("Convergence, relative to the change of each quantity; energies in grey")
        with replacing(folder / "converge.png") as part:
            figure.savefig(fresh(part), format="png")
    return folder / "converge.png"


def _line(row: Row) -> tuple[np.ndarray, np.ndarray]:
    """Mesh size of the coarser of two levels over that of the first, and the relative difference of the two."""
    return 0.5 ** np.arange(len(row.differences)), np.divide(row.differences, row.change)


def _worst(rows: Sequence[Row]) -> list[Row]:
    """Events and controls, and of each quantity of probes the row with the largest last difference."""
    worst: dict[str, Row] = {}
    for row in (row for row in rows if row.kind == "probe"):
        known = worst.setdefault(row.name.rpartition(" ")[2], row)
        if row.differences[-1] / row.change > known.differences[-1] / known.change:
            worst[row.name.rpartition(" ")[2]] = row
    return [row for row in rows if row.kind in ("event", "control")] + list(worst.values())
