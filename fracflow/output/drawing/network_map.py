"""A map of rock, fractures, wells and probes, with names that do not overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fracflow.output.drawing.axes import Axis, axis_of, unit_for
from fracflow.output.drawing.labels import Label, beside_point, beside_trace, placed
from fracflow.output.plot_style import INK, PALE, plain
from fracflow.scene.units import LENGTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection

Floats = NDArray[np.float64]
Places = Mapping[str, tuple[float, float]]

MOST_NAMES = 150  # fractures that are named, the longest
MOST_CELLS = 40_000  # whose edges are drawn
SMALL, HALO = 7.5, 2.0  # size of names, and width of the white around them [points]
AIR = 3.0  # between names, and between a name and the mark of another, where there is room [points]
FLAT = 0.3  # height over width of a map that has the whole width of a figure
AROUND = 0.25  # of the larger extent of fractures and marks: rock beside them in a map of their surroundings
SQUARE = 0.75  # of its longer side: the shorter one of such a map, at least
FLATTEST, TALLEST = 0.1, 4.0  # height over width of a map: a domain beyond is drawn stretched
_LOOKS = {
    "well": ("v", "#56B4E9", 10.0),
    "probe": ("o", "white", 5.0),
    "slipped first": ("*", "#D55E00", 16.0),
    "limit point": ("D", "#CC79A7", 7.0),
}
_SIDES = {"support": ("#7d7768", 3.5), "absorbing side": ("#CC79A7", 1.8)}  # colour, and width [points]


@dataclass(frozen=True)
class Network:
    """Rock, fractures and marks that a map shows.

    rock      corners (k, 2) of each cell [length]
    segments  (m, 2, 2) ends of the pieces of fractures [length]
    fracture  (m,) index into ``names``
    marks     kind -> name -> place; kinds are "well", "probe", "slipped first", "limit point"
    sides     kind -> pieces (s, 2, 2) of sides [length]; kinds are "support", "absorbing side"
    window    (2, 2) lowest and highest corner of what is shown [length]; None for all of it
    is_meshed  whether cells are of a mesh, and not a map of rock without one
    """

    rock: Sequence[Floats]
    segments: Floats
    fracture: NDArray[np.int64]
    names: Sequence[str]
    units: Mapping[str, str]
    marks: Mapping[str, Places] = field(default_factory=dict)
    sides: Mapping[str, Floats] = field(default_factory=dict)
    window: Floats | None = None
    is_meshed: bool = True

    @property
    def shape(self) -> float:
        """Height over width of the window, or of all cells; 1 for none."""
        corners = self.window if self.window is not None else np.concatenate([np.zeros((0, 2)), *self.rock])
        wide, high = np.ptp(corners, axis=0) if len(corners) else (1.0, 1.0)
        return float(high / wide) if wide > 0.0 and high > 0.0 else 1.0

    def near_fractures(self) -> Network:
        """The same with a window around fractures and marks, and only the cells that it shows."""
        points = np.concatenate([self.segments.reshape(-1, 2), *self._places()])
        if not len(points) or not np.all(np.isfinite(points)) or not np.any(np.ptp(points, axis=0)):
            return self
        low, high = points.min(axis=0), points.max(axis=0)
        size = high - low + 2.0 * AROUND * (high - low).max()
        middle, half = 0.5 * (low + high), 0.5 * np.maximum(size, SQUARE * size.max())
        corners = np.concatenate([points, *self.rock])
        low, high = np.maximum(middle - half, corners.min(axis=0)), np.minimum(middle + half, corners.max(axis=0))
        rock = [cell for cell in self.rock if np.all((cell.max(axis=0) > low) & (cell.min(axis=0) < high))]
        return replace(self, rock=rock, window=np.stack([low, high]))

    def _places(self) -> list[Floats]:
        return [np.array(list(places.values())).reshape(-1, 2) for places in self.marks.values()]

    def scales(self) -> tuple[Axis, Axis]:
        """The axes of x and y, in one unit."""
        every = [cell.reshape(-1, 2) for cell in self.rock] + [self.segments.reshape(-1, 2)]
        points = np.concatenate([*every, *self._places()])
        known = points[np.all(np.isfinite(points), axis=1)]
        first = [axis_of(LENGTH, [known[:, i]], self.units) for i in (0, 1)]
        offset = np.array([each.reference for each in first])
        factor, unit = unit_for(LENGTH, float(np.abs(known - offset).max(initial=0.0)), self.units)
        x, y = (replace(each, factor=factor, unit=unit, is_constant=False) for each in first)
        return x, y

    def traces(self) -> dict[str, Floats]:
        """Name -> the line (k, 2) of a fracture, its pieces joined end to end where they meet so."""
        pieces = {name: self.segments[self.fracture == number] for number, name in enumerate(self.names)}
        return {name: _joined(each) for name, each in pieces.items() if len(each) and np.all(np.isfinite(each))}


def _joined(pieces: Floats) -> Floats:
    """The line (k, 2) of pieces (m, 2, 2) in whatever order; of pieces that branch the first ends as they come."""
    places, ends = np.unique(pieces.reshape(-1, 2), axis=0, return_inverse=True)
    ends = ends.reshape(-1, 2)
    following = dict(ends.tolist())
    begins = set(following) - set(following.values())
    if len(following) < len(ends) or len(begins) > 1:
        return np.concatenate([pieces[:, 0], pieces[-1:, 1]])
    order = [begins.pop() if begins else int(ends[0, 0])]
    while order[-1] in following:
        order.append(following.pop(order[-1]))
    return np.asarray(places[order])


def draw_map(axes: Axes, network: Network) -> tuple[Axis, Axis]:
    """Draw rock, fractures, sides and marks, and return the axes of x and y. ``name_all`` puts the names, at the end."""
    from matplotlib.collections import LineCollection, PolyCollection

    x, y = network.scales()
    axes.grid(False)
    ratio = network.shape
    stretch = float(f"{np.clip(ratio, FLATTEST, TALLEST) / ratio:.2g}")
    axes.set_aspect(stretch, anchor="N")
    look: dict[str, Any] = dict(facecolors="#f4f1ea", edgecolors="#dcd6c8", linewidths=0.25)
    if len(network.rock) > MOST_CELLS or not network.is_meshed:
        look |= dict(edgecolors="face")
    axes.add_collection(PolyCollection([scaled(cell, x, y) for cell in network.rock], **look))
    axes.add_collection(LineCollection(list(scaled(network.segments, x, y)), colors=INK, linewidths=1.0))
    for number, (kind, pieces) in enumerate(network.sides.items()):
        if len(pieces):
            colour, width = _SIDES[kind]
            look = dict(colors=colour, linewidths=width, zorder=1.5 + 0.1 * number, label=kind, capstyle="projecting")
            axes.add_collection(LineCollection(list(scaled(pieces, x, y)), **look))
    for kind, places in network.marks.items():
        if places:
            marker, colour, size = _LOOKS[kind]
            at = scaled(np.array(list(places.values())), x, y).T
            level = 5.9 if kind == "slipped first" else 6.0  # below wells and probes
            axes.plot(*at, marker, ms=size, mfc=colour, mec=INK, mew=0.9, ls="", zorder=level, label=kind)
    axes.autoscale_view()
    axes.margins(0.03)
    if network.window is not None:
        (left, bottom), (right, top) = scaled(network.window, x, y).tolist()
        axes.set(xlim=(left, right), ylim=(bottom, top))
    plain_numbers(axes)
    if ratio * stretch < 0.5:
        plain_numbers(axes, "y", 2)
    wider, higher = (f"\nstretched ×{times:.2g}" if times > 1.0 else "" for times in (1.0 / stretch, stretch))
    axes.set(xlabel=x.label("x") + wider, ylabel=y.label("y") + higher)
    return x, y


def coloured(
    axes: Axes, segments: Floats, values: Floats, widths: float | Floats, cmap: str, ends: tuple[float, float]
) -> LineCollection:
    """Pieces (m, 2, 2), already scaled, in colours of their values (m,) between two ``ends``."""
    from matplotlib.collections import LineCollection

    lines = LineCollection(list(segments), cmap=cmap, linewidths=widths, capstyle="round", zorder=3)
    lines.set_array(values)
    lines.set_clim(*ends)
    axes.add_collection(lines)
    return lines


def scaled(points: Floats, x: Axis, y: Axis) -> Floats:
    """Points (..., 2) as they are drawn."""
    return np.stack([x(points[..., 0]), y(points[..., 1])], axis=-1)


def plain_numbers(axes: Axes, which: Literal["both", "x", "y"] = "both", most: int = 6) -> None:
    """Numbers as they are: neither offsets nor powers of ten."""
    axes.ticklabel_format(axis=which, style="plain", useOffset=False)
    axes.locator_params(axis=which, nbins=most)


def name_all(axes: Axes, network: Network, scales: tuple[Axis, Axis], width: float = 1.0) -> None:
    """Put names of wells, probes and fractures where they are free, and say how many found no place.

    The figure must be laid out as it will be drawn: places are in its pixels.

    width  that fractures are drawn with at most [points]
    """
    pixels = axes.transData.transform
    drawn = np.concatenate([network.segments, *network.sides.values()])
    lines = pixels(scaled(drawn, *scales).reshape(-1, 2)).reshape(-1, 2, 2)
    lines = lines[np.all(np.isfinite(lines), axis=(1, 2))]
    point = axes.figure.dpi / 72.0
    texts, labels, boxes = list[str](), list[Label](), list[Floats]()
    clear = 0.5 * width * point
    for at, names, radius in _at_marks(network):
        here = pixels(scaled(np.array(at), *scales))
        boxes.append(np.concatenate([here - radius * point, here + radius * point]))
        if names:
            texts.append(", ".join(names))
            labels.append(beside_point(here, name_size(axes, texts[-1]), radius * point, clear))
    marks = len(texts)
    longest = sorted(network.traces().items(), key=lambda item: -_length(item[1]))
    for name, trace in longest[:MOST_NAMES]:
        texts.append(name)
        labels.append(beside_trace(pixels(scaled(trace, *scales)), name_size(axes, name), clear))
    bounds = np.ravel(axes.get_window_extent().get_points())
    found = placed(labels, lines, np.array(boxes).reshape(-1, 4), bounds, clear, AIR * point)
    for number, (text, centre) in enumerate(zip(texts, found, strict=True)):
        if centre is not None:
            write_name(axes, text, axes.transData.inverted().transform(centre), INK if number < marks else "#5a5a5a")
    left_out = sum(centre is None for centre in found) + len(longest[MOST_NAMES:])
    if left_out:
        axes.text(1.0, 1.0, f"{left_out} {'name has' if left_out == 1 else 'names have'} no room", ha="right", va="bottom",
                  transform=axes.transAxes, fontsize=SMALL, color=PALE, in_layout=False)  # fmt: skip


def _at_marks(network: Network) -> list[tuple[tuple[float, float], list[str], float]]:
    """Places of marks with the names of their wells and probes, each once, and the radius of the mark [points]."""
    there: dict[tuple[float, float], tuple[list[str], list[float]]] = {}
    for kind, places in network.marks.items():
        for name, at in places.items():
            if np.all(np.isfinite(at)):
                names, sizes = there.setdefault(at, ([], []))
                names += [name] if not name.startswith("\0") and name not in names else []
                sizes.append(0.5 * _LOOKS[kind][2])
    return [(at, names, max(sizes)) for at, (names, sizes) in there.items()]


def _length(trace: Floats) -> float:
    return float(np.linalg.norm(np.diff(trace, axis=0), axis=1).sum())


def name_size(axes: Axes, text: str) -> tuple[float, float]:
    """Width and height of a name [pixels], with its halo."""
    drawn = axes.text(0.0, 0.0, plain(text), fontsize=SMALL)
    box = drawn.get_window_extent()
    drawn.remove()
    return float(box.width) + HALO, float(box.height)


def write_name(axes: Axes, text: str, at: Floats, colour: str) -> None:
    """A name at a place (2,) of the axes, on a white halo."""
    import matplotlib.patheffects as effects

    halo = [effects.withStroke(linewidth=HALO, foreground="white")]
    axes.text(
        float(at[0]),
        float(at[1]),
        plain(text),
        fontsize=SMALL,
        color=colour,
        ha="center",
        va="center",
        zorder=7,
        path_effects=halo,
        in_layout=False,
    )
