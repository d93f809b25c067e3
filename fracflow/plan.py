"""What the scene needs and what it does not: the decision record, model no more than a scene needs."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from fracflow.elements import dashpot
from fracflow.scene import Scene


@dataclass(frozen=True)
class Decision:
    """Something left out, or kept: the criterion, the value found, the limit, and the error it may cause."""

    part: str
    left_out: bool
    criterion: str
    value: float | str
    limit: float | str
    error: str


def decide(scene: Scene) -> list[Decision]:
    """Decisions that the scene alone settles."""
    fluid = scene.fluid
    value = "no [fluid]" if fluid is None else f"viscosity {fluid.viscosity:g}, specific weight {fluid.specific_weight}"
    flow = Decision(
        "flow", not scene.has_flow, "fluid table with viscosity and specific weight above zero", value, "> 0",
        "none: without a fluid there is no pressure",
    )  # fmt: skip
    kinds = sorted({stage.kind for stage in scene.stage})
    inertia = Decision(
        "inertia", not scene.has_dynamics, "a dynamic stage in the scene", f"stages {', '.join(kinds)}", "dynamic, auto",
        "slip in stages without inertia is that of a slow process: up to half of the dynamic one",
    )  # fmt: skip
    return [flow, inertia, *_far_field(scene)]


def _far_field(scene: Scene) -> list[Decision]:
    """Rock beyond absorbing sides, which waves that meet them at an angle would tell from none."""
    ratios = sorted({rock.poissons_ratio for rock in scene.rock.values() if rock.poissons_ratio is not None})
    sides = ", ".join(name for absorbing in scene.absorbing for name in absorbing.on)
    if not sides or not scene.has_dynamics:
        return []
    return [
        Decision(
            "rock beyond absorbing sides", True, f"share of a P wave that {sides} send back, by its angle to the normal",
            f"{dashpot.reflections(ratio)} for Poisson's ratio {ratio:g}", "0 at 0 degrees",
            "waves that meet a side at a slant come back weaker: move it away, or turn it towards them",
        )
        for ratio in ratios
    ]  # fmt: skip


def factorisations(solves: int, fills: int) -> Decision:
    """The record of Jacobians: one is made anew only where a tangent has changed since the last one."""
    return Decision(
        "new factorisation in every iteration", fills < solves, "tangents equal to those of the last factorisation, bit by bit",
        f"{fills} factorisations in {solves} Newton iterations", "1 while nothing changes state", "none: the same matrix",
    )  # fmt: skip


def as_records(decisions: list[Decision]) -> list[dict[str, object]]:
    """For plan.json."""
    return [asdict(decision) for decision in decisions]
