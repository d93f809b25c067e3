"""Colours, style and letters of the pictures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracflow.storage.files import fresh, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, distinct to colour-blind readers and in grey
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
INK, PALE = "#222222", "#9a9a9a"
STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "savefig.dpi": 200,
}
_OTHER_SCRIPTS = (
    "Noto Sans CJK JP",
    "Noto Sans CJK SC",
    "WenQuanYi Zen Hei",
    "Noto Sans Arabic",
    "Noto Sans Devanagari",
)


def fonts() -> list[str]:
    """The usual font, and behind it those installed that have the letters of other scripts."""
    from matplotlib.font_manager import fontManager

    have = {font.name for font in fontManager.ttflist}
    return ["DejaVu Sans", *(name for name in _OTHER_SCRIPTS if name in have)]


@contextmanager
def styled() -> Iterator[None]:
    """Draw in this style alone: Matplotlib takes settings from a file in the working folder too, such as to call TeX."""
    import matplotlib

    with matplotlib.rc_context(), one_note_on_letters():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({**STYLE, "font.family": fonts()})
        yield


def plain(text: str) -> str:
    """A name as it is: what stands between dollars would be read as a formula."""
    return text.replace("$", r"\$")


@contextmanager
def one_note_on_letters() -> Iterator[None]:
    """Replace Matplotlib's warnings, one for each missing letter, by one with the remedy."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    missing = [each for each in caught if "missing from" in str(each.message)]
    for each in caught:
        if each not in missing:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    if missing:
        warnings.warn(
            "names in the pictures have letters that no font here has; install one, such as fonts-noto-cjk",
            stacklevel=3,
        )


def draw_head(figure: Figure, title: str, below: str) -> None:
    """The title of a figure, and a smaller line under it."""
    from matplotlib.text import Annotation

    head = figure.suptitle(f"{plain(title)}\n", fontsize=13, fontweight="bold", x=0.01, ha="left")
    place: dict[str, Any] = dict(xy=(0.0, 0.0), xycoords=head, xytext=(0.0, 2.0), textcoords="offset points")
    figure.add_artist(Annotation(plain(below), **place, fontsize=9, annotation_clip=False))


def save(figure: Figure, path: Path) -> Path:
    """Write a figure whole or not at all. Raises OSError."""
    with replacing(path) as part:
        figure.savefig(fresh(part), format="png")
    return path
