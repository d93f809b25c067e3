"""The picture of a scene before its run: mesh, fractures, wells and sides, and how near each trace is to slip."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow.output.drawing.axes import Axis, Floats, axis_of
from fracflow.output.drawing.network_map import (
    FLAT,
    FLATTEST,
    Network,
    coloured,
    draw_map,
    name_all,
    plain_numbers,
    scaled,
)
from fracflow.output.plot_style import COLOURS, draw_head
from fracflow.scene.units import PLAIN, STRESS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 3.0  # of a fracture [points]
_SAME = 1e-9  # of the largest value: all fractures alike


def before_a_run(network: Network, title: str, below: str, tendency: Floats, rise: Floats, creeps: bool) -> Figure:
    """Two maps: slip tendency, and the rise of pressure to slip, of pieces (m,); NaN and inf where there is none.

    title, below  the head, and a smaller line under it
    creeps        some slip by rate and state, at any shear; their rise is to steady slip at the reference rate
    """
    from matplotlib.figure import Figure

    shape = max(network.shape, FLATTEST)
    is_flat = shape <= FLAT
    figure = Figure(figsize=(10 if is_flat else 11, 8), layout="constrained")
    draw_head(figure, title, below)
    left, right = figure.subplots(2, 1) if is_flat else figure.subplots(1, 2)
    share = "|τ|/σₙ′, shear over effective normal traction"
    shear = "Shear over normal traction" if creeps else "Slip tendency"
    slip = "steady slip at V₀" if creeps else "slip"
    more = (
        "pressure above the initial one: steady slip at the reference rate V₀ (other friction: slip), or opening"
        if creeps
        else "pressure above the initial one at which it slips or opens"
    )
    drawn = [
        (left, _draw(left, network, f"{shear} before the run", tendency, PLAIN, share, "viridis_r")),
        (right, _draw(right, network, f"Pressure rise to {slip}", rise, STRESS, more, "viridis")),
    ]
    bars = len(figure.axes) - len(drawn)
    beside = np.clip(4.9 * shape + 1.6 + 0.7 * bool(bars), 4.2, 8.0)
    figure.set_figheight(18.0 * shape + 2.5 + 0.7 * bars if is_flat else beside)
    if not is_flat:
        right.set_ylabel("")
    handles, labels = left.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower left", ncols=4, handletextpad=0.4)
    figure.draw_without_rendering()  # names are placed in the pixels of the final layout
    for axes, scales in drawn:
        name_all(axes, network, scales, _WIDTH)
    return figure


def _draw(
    axes: Axes, network: Network, title: str, values: Floats, dimension: str, word: str, cmap: str
) -> tuple[Axis, Axis]:
    """One map, its fractures coloured by values (m,); returns its scales."""
    from matplotlib.collections import LineCollection

    axes.set_title(title)
    scales = draw_map(axes, network)
    known = np.isfinite(values)
    if not known.any():
        axes.set_title(f"{title}: no fracture here can slip")
        return scales
    axis = axis_of(dimension, [np.r_[0.0, values[known]]], network.units)
    shown, low, top = axis(values[known]), *(float(end) for end in axis([values[known].min(), values[known].max()]))
    if top - low < _SAME * max(abs(top), 1e-300):
        where = "everywhere" if known.all() else "where fractures slip"
        axes.set_title(f"{title}: {axis.text(float(values[known][0]))} {where}")
        look: dict[str, Any] = dict(colors=COLOURS[0], linewidths=_WIDTH, capstyle="round", zorder=3)
        axes.add_collection(LineCollection(list(scaled(network.segments[known], *scales)), **look))
        return scales
    lines = coloured(axes, scaled(network.segments[known], *scales), shown, _WIDTH, cmap, (low, top))
    look = dict(location="bottom", shrink=0.8, aspect=40, pad=0.03, panchor=False)
    bar = axes.figure.colorbar(lines, ax=axes, label=axis.label(word), **look)
    plain_numbers(bar.ax, "x")
    return scales
