"""R04: steady flow by the cubic law between walls that do not move: a taper, and a network in rational numbers.

Lubrication: q = dp/(12 mu int ds/d^3), so with a linear aperture from a to b over L
int ds/d^3 = L/(b - a) (1/a^2 - 1/b^2)/2 = L (a + b)/(2 a^2 b^2). The mean (3.14f) makes it (a^3 + a^2 b + a b^2 + b^3)/4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np
from grids import tensor

from figures_verification.case import Bar, Case
from figures_verification.runs import Floats, solve

Branch = tuple[int, int, int | str, int | str, int | str]
"""From, to, aperture at each end, length."""
VISCOSITY = 1.0 / 12.0  # so that a conductance is mean(d^3)/L


def kirchhoff(branches: Sequence[Branch], held: Mapping[int, int], inflow: Mapping[int, str]) -> Floats:
    """Pressures of the nodes in rational arithmetic."""
    count = 1 + max(max(branch[:2]) for branch in branches)
    rows = [[Fraction(0)] * count + [Fraction(inflow.get(node, 0))] for node in range(count)]
    for i, j, first, last, length in branches:
        a, b = Fraction(first), Fraction(last)
        resistance = Fraction(length) * (a + b) / (2 * a**2 * b**2)
        for p, q in ((i, j), (j, i)):
            rows[p][p] += 1 / resistance
            rows[p][q] -= 1 / resistance
    for node, pressure in held.items():
        rows[node] = [Fraction(int(k == node)) for k in range(count)] + [Fraction(pressure)]
    for c in range(count):
        pivot = next(r for r in range(c, count) if rows[r][c])
        rows[c], rows[pivot] = rows[pivot], rows[c]
        rows[c] = [x / rows[c][c] for x in rows[c]]
        for r in range(count):
            if r != c:
                rows[r] = [x - rows[r][c] * y for x, y in zip(rows[r], rows[c], strict=True)]
    return np.array([float(row[count]) for row in rows])


HEAD = f"""
units = "none"
rock.rock = {{rigid = true}}
fluid = {{viscosity = {VISCOSITY}}}
support = [{{on = "rock", components = ["x", "y", "rotation"]}}]
stage = [{{kind = "steady", time_step = 1, steps = 1}}]
"""
FRACTURE = (
    'fracture.{name} = {{law = "linear", normal_stiffness = 1, shear_stiffness = 1, aperture = {{along = {along},'
    " value = {value}}}}}\n"
)
ENDS = """
[[well]]
name = "in"
at = {{fracture = "{name}", end = "start"}}
pressure = {pressure}
[[well]]
name = "out"
at = {{fracture = "{name}", end = "end"}}
pressure = 0
"""


def taper(mean: str) -> Callable[[float], tuple[float, ...]]:
    """Of the flow through a taper 5 to 1 of length 1 in pieces of that length."""

    def at(size: float) -> tuple[float, ...]:
        scene = (
            HEAD + FRACTURE.format(name="slot", along=[0, 1], value=[1.0, 0.2]) + ENDS.format(name="slot", pressure=1)
        )
        mesh = tensor(np.linspace(0, 1, round(1 / size) + 1), np.array([-1.0, 0.0, 1.0]), {"slot": (0.0, 0.0, 1.0)})
        flow = solve(scene, f"method.conductance={mean}", mesh=mesh).fractures[-1].point["flow_rate"]
        return (float(np.abs(flow / (2 * 0.2**2 / 1.2) - 1).max()),)

    return at


TRACES = {  # nodes and apertures along each
    "main": ([0, 1, 2, 3, 4], ["1", "3/2", "1", "1/2", "1"]),
    "top": ([5, 6, 7], ["1/2", "1", "3/4"]),
    "left": ([1, 5], ["3/2", "1/2"]),
    "middle": ([2, 6], ["1", "1"]),
    "right": ([3, 7], ["1/2", "3/4"]),
}
PLACES = ((0, 1), (1, 1), (2, 1), (3, 1), (4, 1), (1, 2), (2, 2), (3, 2))  # all branches are of length 1
NETWORK: list[Branch] = [
    (i, j, a, b, 1)
    for nodes, apertures in TRACES.values()
    for (i, j), (a, b) in zip(pairwise(nodes), pairwise(apertures), strict=True)
]


def network(cells: str) -> Callable[[float], tuple[float, ...]]:
    """Of the pressures at its nodes, 10 at the first, 0 at the last of the main fracture, 1/10 pumped in at (2, 2)."""

    def at(size: float) -> tuple[float, ...]:
        scene = HEAD + "".join(
            FRACTURE.format(name=name, along=list(range(len(nodes))), value=[float(Fraction(d)) for d in apertures])
            for name, (nodes, apertures) in TRACES.items()
        )
        scene += ENDS.format(name="main", pressure=10) + '[[well]]\nname = "pump"\nat = [2, 2]\nflow_rate = 0.1\n'
        traces = ", ".join(
            f'{{name = "{name}", points = {[list(PLACES[n]) for n in nodes]}}}' for name, (nodes, _) in TRACES.items()
        )
        scene += f'[geometry]\ndomain = [0, 0, 4, 3]\nsize = {size}\ncells = "{cells}"\nfracture = [{traces}]\n'
        state = solve(scene).fractures[-1]
        gaps = np.linalg.norm(state.points[None] - np.array(PLACES)[:, None], axis=2)
        found = state.point["pressure"][gaps.argmin(axis=1)]
        exact = kirchhoff(NETWORK, {0: 10, 4: 0}, {6: "1/10"})
        return (max(float(np.abs(found - exact).max() / 10), float(gaps.min(axis=1).max())),)

    return at


FINE = (1 / 16, 1 / 32, 1 / 64)
CASES = (
    Case("R04 taper 5:1, exact mean", (Bar("flow", 1e-12),), taper("exact"), (1, 1 / 4, 1 / 16), (1, 1 / 4)),
    Case("R04 taper 5:1, mean (3.14f)", (Bar("flow", 1.6e-3, 1.9),), taper("report"), FINE, FINE[:2]),
    *(Case(f"R04 network in rationals, {cells}", (Bar("pressures", 1e-12),), network(cells), (0.5, 0.25), (0.5,))
      for cells in ("quads", "triangles")),
)  # fmt: skip
