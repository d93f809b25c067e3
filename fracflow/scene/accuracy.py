"""[accuracy]: how accurate results are to be, and when iterations have converged."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fracflow.scene.method import Count, Fraction, Table
from fracflow.scene.units import LINE_FORCE, Quantity


class Accuracy(Table):
    """[accuracy] How accurate results are to be, when an iteration has converged, and when it is given up."""

    residual: Fraction = Field(
        default=1e-11, description="largest residual relative to what drives it (default test) [1]"
    )
    out_of_balance: Annotated[float, Quantity(LINE_FORCE, above=0.0)] | None = Field(
        default=None,
        description="epsilon_S of (4.9a), absolute, per unit thickness [force/length]; without it the residuals decide",
    )
    displacement: Fraction = Field(default=1e-12, description="relative change of displacement of (4.9b) [1]")
    pressure: Fraction = Field(default=1e-10, description="epsilon_F of the fixed point (4.5), relative [1]")
    digits: Annotated[int, Field(strict=True, ge=0, le=15)] = Field(
        default=6,
        description="digits that round-off must leave of the joint tractions, and of what wells with a pressure draw, or the"
        " run stops; 0 lets it go on [1]",
    )
    max_iterations: Count = Field(default=50, description="Newton iterations of a step before it is halved or given up")
    max_halvings: Annotated[int, Field(strict=True, ge=0, le=30)] = Field(
        default=6, description="times that a step which does not converge is halved before the run stops"
    )
    tolerance: Fraction | None = Field(
        default=None,
        description="error of results that time steps may make in a stage, over the largest change: steps are cut in substeps"
        " whose estimated errors add up to no more; with inertia of displacements, without it of the volume stored in"
        " fractures; if not given, every step is of length time_step [1]",
    )
    step_error: Fraction | None = Field(
        default=None,
        description="largest error of displacement that a step may add, over the largest displacement so far: longer steps are"
        " halved, at most max_halvings times; takes the place of tolerance [1]",
    )
    max_events: Annotated[int, Field(strict=True, ge=0)] = Field(
        default=20, description="events of joints in a step that parts of it end at; later ones are taken as they fall"
    )
    max_cycles: Count = Field(default=50, description="cycles of the fixed point (4.5) before it is given up")
