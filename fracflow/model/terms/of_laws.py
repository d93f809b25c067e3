"""Terms of the laws in ``TERM_LAWS``: on facets of sides, lumped to their nodes, and at the ends of joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fracflow._petsc import PETSc
from fracflow.laws import TERM_LAWS
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats
from fracflow.model.operators import Operators
from fracflow.model.properties import outward, side_facets
from fracflow.model.solid import assembled_at_nodes
from fracflow.model.terms.term import Leaving, Term, TermStep
from fracflow.scene.scene import Scene
from fracflow.scene.terms import LawTable


def terms_of_laws(operators: Operators, scene: Scene) -> tuple[Term, ...]:
    """A term for each law that a scene has a table of. Collective."""
    given = {name: getattr(scene, name) for name in TERM_LAWS}
    return tuple(
        (OnSides if TERM_LAWS[name].places == "sides" else OnFractures)(name, operators, tables)
        for name, tables in given.items()
        if tables
    )


class OnSides(Term):
    """The effect of a law on all sides that the tables of its key name."""

    def __init__(self, name: str, operators: Operators, tables: Sequence[LawTable]) -> None:
        """Assemble K and C. Collective."""
        self.name, self.entry = name, tables[0].law.entry
        dim, laws = operators.blocks.sizes.dim, [(table.on, table.made()) for table in tables]
        self.stiffness = self._assembled(operators, [(on, law.stiffness(dim)) for on, law in laws])
        self.damping = self._assembled(operators, [(on, law.damping(dim)) for on, law in laws])

    def _assembled(
        self, operators: Operators, given: Sequence[tuple[tuple[str, ...], Floats | None]]
    ) -> PETSc.Mat | None:
        """Moduli (dim, dim) along and across sides, of which there are some or none, times the share of each node."""
        if all(moduli is None for _, moduli in given):
            return None
        blocks, parts = operators.blocks, []
        for name, moduli in ((name, moduli) for names, moduli in given if moduli is not None for name in names):
            facets = side_facets(blocks, name)
            nodes, normal = blocks.solid.side_facets[facets], outward(blocks, facets)
            ends = blocks.solid.points[nodes]
            frame = np.stack([np.stack([normal[:, 1], -normal[:, 0]], axis=1), normal], axis=1)
            half = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            values = np.einsum("n,nki,kl,nlj->nij", half, frame, moduli, frame)
            parts.append((nodes, np.stack([values] * 2, axis=1)))
        return assembled_at_nodes(blocks, parts, operators.expand)


class OnFractures(Term):
    """Fluid that leaves all fractures that the tables of a law's key name."""

    drains = True

    def __init__(self, name: str, operators: Operators, tables: Sequence[LawTable]) -> None:
        """Find the joints of each table."""
        flow = operators.network
        self.name, self.entry, self._half = name, tables[0].law.entry, 0.5 * flow.length
        self._laws = [(joints_of(operators.blocks, table.on), table.made()) for table in tables]
        sizes = (sign * operators.scales.pressure + flow.resting_end for sign in (-1.0, 1.0))
        slopes = [self.leaving(pressure, flow.aperture, TermStep()).by_pressure.any(axis=1) for pressure in sizes]
        self._settled = np.flatnonzero(slopes[0] | slopes[1])

    def joints(self) -> np.ndarray:
        """Numbers (k,) of this rank's joints whose pressure it settles: what leaves at a given rate settles none."""
        return self._settled

    def leaving(self, pressure: Floats, aperture: Floats, step: TermStep) -> Leaving:
        """Fluid that leaves at the ends of this rank's joints (j, 2)."""
        total = Leaving(*(np.zeros(pressure.shape) for _ in range(3)))
        for here, law in self._laws:
            found = law.leakage(pressure[here].ravel(), aperture[here].ravel())
            if found is not None:
                for into, values in zip(total, (found.rate, found.by_pressure, found.by_aperture), strict=True):
                    into[here] += self._half[here, None] * values.reshape(-1, 2)
        return total


def joints_of(blocks: Blocks, names: Sequence[str]) -> np.ndarray:
    """Numbers (n,) of this rank's joints on the named fractures."""
    chosen = [number for number, name in enumerate(blocks.joints.fractures) if name in names]
    return np.flatnonzero(np.isin(blocks.joints.fracture, chosen))
