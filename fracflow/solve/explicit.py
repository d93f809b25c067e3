"""Parts that all explicit steps of a model share: inverse masses, damping, critical time step, clusters of sections."""

from __future__ import annotations

from fracflow._petsc import destroy
from fracflow.errors import SolveError
from fracflow.model.loads import Loads
from fracflow.model.mass import inverse_mass, longest_step
from fracflow.model.operators import Operators
from fracflow.scene.scene import Scene
from fracflow.solve.clusters import find_clusters
from fracflow.solve.sections import SectionSolver


class ExplicitModel:
    """A model as its explicit steps need it, whatever its wells do; supports stay those it is made with.

    Where terms have a C, M + dt/2 C takes the place of M for accelerations: C acts on the velocity at the end of the step, and
    does not limit the step. Their D acts on the mean velocity of the step, and does limit it.

    critical  the longest stable time step, by the rock and its terms alone [time]
    notes     words of the log on D
    doubts    warnings on it
    """

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Find inverse mass, clusters and critical time step. Raises InputError, on every rank. Collective."""
        self.operators = operators
        self.inverse = inverse_mass(operators, loads.held)
        made = {term.name: term.mean_damping() for term in operators.terms}
        self.damping = {name: damping for name, damping in made.items() if damping is not None}
        self.notes = tuple(damping.note for damping in self.damping.values())
        self.doubts = tuple(damping.doubt for damping in self.damping.values() if damping.doubt)
        self.critical = longest_step(operators, scene, self.inverse, list(self.damping.values()))
        clusters = find_clusters(operators.joints, self.inverse, operators.layout.comm)
        self.sections = SectionSolver(scene, operators, clusters)

    def destroy(self) -> None:
        """Free matrices and solver. Collective."""
        destroy(self.sections, self.inverse)


def refuse_closed(loads: Loads, time: float) -> None:
    """Raise SolveError, on every rank, where nothing but a closure settles the pressures of a part of the network."""
    if loads.closures:
        raise SolveError(
            f'time {time:.6g}: method.stepper = "explicit" needs walls that move in each part of the network that'
            ' no pressure drains: give a [[well]] with a pressure there, fluid.compressibility, or stepper = "newmark"'
        )
