"""A joint that creeps along itself. python creep.py run SCENE -o DIR: fracflow, with law = "creeping" known to scenes."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from fracflow.laws import JOINT_LAWS, HistoryVariable, JointLaw, Linear
from fracflow.laws.base import INSTANT, key, per_section


@dataclass(frozen=True, eq=False)
class Creeping(JointLaw):
    """Spring and dashpot in a row along the joint (Maxwell): f = f_0 + k_s (slip - plastic), d plastic/dt = f/eta."""

    normal_stiffness: float
    shear_stiffness: float
    viscosity: float = field(metadata=key("eta, traction over rate of slip", "force*time/length**3", above=0.0))
    initial_normal_traction: float = 0.0
    initial_shear_traction: float = 0.0

    history: ClassVar = {"plastic_slip": HistoryVariable("shear", "length", "plastic slip", published=False)}
    slides: ClassVar = True

    def evaluate(self, strain, history, step=INSTANT):
        """Response (n sections) to a strain (n, dim), slip first; the dashpot moves at the rate of the end of the step."""
        initial = self.initial_normal_traction, self.initial_shear_traction
        springs = Linear(self.normal_stiffness, self.shear_stiffness, *initial)
        flows = (step.dt / per_section(self.viscosity, len(strain)))[:, None]
        softer = 1.0 / (1.0 + per_section(self.shear_stiffness, len(strain))[:, None] * flows)
        old = history["plastic_slip"]
        trial = springs.evaluate(strain - np.pad(old, ((0, 0), (0, 1))), {})
        plastic = old + flows * softer * trial.traction[:, :-1]
        inelastic = np.pad(plastic, ((0, 0), (0, 1)))
        tangent = trial.tangent.copy()
        tangent[:, :-1] *= softer[:, :, None]
        end = springs.evaluate(strain - inelastic, {})
        return replace(end, tangent=tangent, inelastic=inelastic, history={"plastic_slip": plastic})


JOINT_LAWS["creeping"] = Creeping

if __name__ == "__main__":
    from fracflow.cli.app import main

    main()
