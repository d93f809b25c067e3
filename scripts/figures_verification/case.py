"""A case: runs of several sizes compared with a closed form, and the bars on their errors and orders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Bar(NamedTuple):
    """Largest error of an observable at the smallest size of its case, and least order; without one, of no order.

    Errors are held to little more than was reached, lest they grow. The demands on the program are separate: the whole
    order above ``order``, which theory gives the method; exactness, where ``most`` is round-off; and ``asked``, if stated.
    """

    observable: str
    most: float
    order: float | None = None
    asked: float | None = None

    @property
    def theory(self) -> int:
        """Order of the method; 0 where there is none, or where no theory says it: the least order is below a half there."""
        return int(np.ceil(self.order)) if self.order and self.order >= 0.5 else 0


@dataclass(frozen=True)
class Case:
    """A reference and how it is run.

    errors  relative errors, one a bar, at a size: of cells (``by`` = "h") or time steps ("dt"), in the case's own unit
    sizes   falling; ``quick`` are those of the tests, none where another case does as well
    """

    name: str
    bars: tuple[Bar, ...]
    errors: Callable[[float], Sequence[float]]
    sizes: tuple[float, ...]
    quick: tuple[float, ...]
    by: str = "h"


class Outcome(NamedTuple):
    """Errors of one observable by size, their order between the last two sizes (None where none is asked for), and the bars.

    most  of the error at the smallest of the sizes
    """

    case: str
    bar: Bar
    by: str
    sizes: Floats
    errors: Floats
    order: float | None
    most: float

    @property
    def observable(self) -> str:
        """The quantity of the errors."""
        return self.bar.observable

    @property
    def ok(self) -> bool:
        """Whether the error is within its bar, and the order where there are two sizes."""
        least = self.bar.order
        slow = least is not None and len(self.sizes) > 1 and (self.order is None or self.order < least)
        return bool(self.errors[-1] <= self.most) and not slow

    @property
    def reaches(self) -> bool:
        """Whether the error is what was asked for, where something was."""
        return self.bar.asked is None or bool(self.errors[-1] <= self.bar.asked)


def measure(case: Case, quick: bool = False) -> list[Outcome]:
    """Run a case; at quick sizes an error of an order may be larger as its order, the whole number above its bar, has it."""
    sizes = np.array(case.quick if quick else case.sizes)
    errors = np.array([case.errors(float(size)) for size in sizes])
    found = []
    for bar, values in zip(case.bars, errors.T, strict=True):
        ratio = sizes[-2:] if bar.order is not None and len(sizes) > 1 and values[-1] > 0 else None
        order = None if ratio is None else float(np.log(values[-2] / values[-1]) / np.log(ratio[0] / ratio[1]))
        most = bar.most * (sizes[-1] / case.sizes[-1]) ** np.ceil(bar.order or 0.0)
        found.append(Outcome(case.name, bar, case.by, sizes, values, order, most))
    return found
