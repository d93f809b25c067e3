"""The picture of a scene before its run: mesh, fractures, wells and sides, and how near each trace is to slip."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow.output.drawing.axes import Axis, Floats, axis_of
from fracflow.output.drawing.network_map import Network, coloured, draw_map, name_all, plain_numbers, scaled
from fracflow.output.plot_style import PALE, draw_head
from fracflow.scene.units import PLAIN, STRESS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 3.0  # of a fracture [points]
_SAME = 1e-9  # of the largest value: all fractures alike


def before_a_run(network: Network, title: str, below: str, tendency: Floats, rise: Floats) -> Figure:
    """Two maps: slip tendency, and the rise of pressure to slip, of pieces (m,); NaN and inf where there is none.

    title, below  the head, and a smaller line under it
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, _height(network)), layout="constrained")
    draw_head(figure, title, below)
    left, right = figure.subplots(1, 2)
    share = "|τ|/σₙ′, shear over effective normal traction"
    more = "pressure above the initial one at which it slips or opens"
    drawn = [
        (left, _draw(left, network, "Slip tendency before the run", tendency, PLAIN, share, "viridis_r")),
        (right, _draw(right, network, "Pressure rise to slip", rise, STRESS, more, "viridis")),
    ]
    right.set_ylabel("")
    handles, labels = left.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower left", ncols=4, handletextpad=0.4)
    figure.draw_without_rendering()  # names are placed in the pixels of the final layout
    for axes, scales in drawn:
        name_all(axes, network, scales, _WIDTH)
    return figure


def _height(network: Network) -> float:
    """Height in inches of two maps side by side, within limits."""
    points = np.concatenate([np.zeros((0, 2)), *(cell.reshape(-1, 2) for cell in network.rock)])
    wide, high = np.ptp(points, axis=0) if len(points) else (1.0, 1.0)
    return float(np.clip(5.8 * high / max(wide, 1e-300) + 2.3, 4.5, 9.0))


def _draw(
    axes: Axes, network: Network, title: str, values: Floats, dimension: str, word: str, cmap: str
) -> tuple[Axis, Axis]:
    """One map, its fractures coloured by values (m,); returns its scales."""
    axes.set_title(title)
    scales = draw_map(axes, network)
    known = np.isfinite(values)
    if not known.any():
        axes.text(0.5, 1.0, "no fracture here can slip", transform=axes.transAxes, ha="center", va="bottom", color=PALE)
        return scales
    axis = axis_of(dimension, [np.r_[0.0, values[known]]], network.units)
    shown, low, top = axis(values[known]), *(float(end) for end in axis([values[known].min(), values[known].max()]))
    if top - low < _SAME * max(abs(top), 1e-300):
        axes.set_title(f"{title}: {axis.text(float(values[known][0]))} everywhere")
        low, top = 0.0, top or 1.0
    lines = coloured(axes, scaled(network.segments[known], *scales), shown, _WIDTH, cmap, (low, top))
    look: dict[str, Any] = dict(location="bottom", shrink=0.8, aspect=40, pad=0.03, panchor=False)
    bar = axes.figure.colorbar(lines, ax=axes, label=axis.label(word), **look)
    plain_numbers(bar.ax, "x")
    return scales
