"""A joint of two uncoupled springs, without strength limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fracflow.laws.base import (
    INSTANT,
    Floats,
    History,
    JointLaw,
    JointResponse,
    LawStep,
    Parameter,
    per_section,
    per_tangent,
)


@dataclass(frozen=True, eq=False)
class Linear(JointLaw):
    """(2.22) with constant moduli: f = f_0 + k eps in shear and normal direction, tension included.

    normal_stiffness        k_n [stress/length], number or (n,)
    shear_stiffness         k_s [stress/length], number or (n,)
    initial_normal_traction f_n0 [stress], number or (n,), tension positive, effective
    initial_shear_traction  f_s0 [stress], number, (n,) in two dimensions, or (n, dim-1)
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    initial_normal_traction: Parameter = 0.0
    initial_shear_traction: Parameter = 0.0

    compiled: ClassVar[int | None] = 0
    passes_over: ClassVar[bool] = True  # a scene may switch to springs, and keep its friction for later

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """(2.22) Traction, tangent and stored energy of strain (n, dim); ``history`` is empty."""
        sections, dim = strain.shape
        stiffness = np.empty((sections, dim))
        stiffness[:, :-1] = per_section(self.shear_stiffness, sections)[:, None]
        stiffness[:, -1] = per_section(self.normal_stiffness, sections)
        initial = np.empty((sections, dim))
        initial[:, :-1] = per_tangent(self.initial_shear_traction, sections, dim - 1)
        initial[:, -1] = per_section(self.initial_normal_traction, sections)
        change = stiffness * strain
        never = np.zeros(sections, dtype=bool)
        return JointResponse(
            traction=initial + change,
            tangent=stiffness[:, :, None] * np.eye(dim),
            stored=np.einsum("ni,ni->n", initial + 0.5 * change, strain),
            inelastic=np.zeros((sections, dim)),
            strength=np.full(sections, np.inf),
            utilisation=np.zeros(sections),
            is_sliding=never,
            is_open=never.copy(),
            margin=np.full(sections, np.inf),
            history={},
        )
