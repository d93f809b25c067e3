"""What a step is asked, and by which rule it goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas
from fracflow.model.loads import Loads
from fracflow.scene.time_table import AT_ONCE, Around, Rates


@dataclass(frozen=True)
class StepRequest:
    """One step that is to be made from a state.

    time             at its end [time]
    length           of the step [time]; 0 where time has no part
    controls         value of each load factor at its end
    loads            loads, wells and supports that act
    restraint        a force (n,) beside the loads [force per thickness]; None for none
    unapplied        share of what the state lacks of the prescribed that does not arrive in this step [1]
    hold             all joint sections keep their status, whatever their tractions
    next_length      length of the step that follows, 0 where the stage ends or this one is cut at a jump [time]; None for one
                     as long as this one
    expects_failure  a failure costs little: where sections keep changing, it is given up early, and not given to another solver
    max_iterations   while no section changes, where accuracy.max_iterations is more; 0 for no such limit
    """

    time: float
    length: float
    controls: Mapping[str, float]
    loads: Loads
    restraint: PETSc.Vec | None = None
    unapplied: float = 0.0
    hold: bool = False
    next_length: float | None = None
    expects_failure: bool = False
    max_iterations: int = 0


@dataclass(frozen=True)
class StepRule:
    """How a step takes rates at its end, and samples what is tabled in time.

    alphas    (4.3), its coefficients of velocity and acceleration
    adjacent  lengths of the step and of the one that follows, over halves of which a jump in time is spread [time]
    rates     how flow rates are sampled, if not as above; without inertia jumps of supports are as ``adjacent`` says
    inertia   the mass matrix takes part
    """

    alphas: Alphas
    adjacent: Around = AT_ONCE
    rates: Rates | None = None
    inertia: bool = False
