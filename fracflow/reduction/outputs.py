"""Quantities computed only on request, and the rock outside of the model."""

from __future__ import annotations

from collections.abc import Iterator

from fracflow.elements import dashpot
from fracflow.reduction.decision import Decision, ReductionInput


def fields(facts: ReductionInput) -> Iterator[Decision]:
    """Stresses and energy densities of the rock, and files of whole fields."""
    every = facts.scene.output.fields_every
    value = "the first and the last state" if every == 0 else f"every {every} steps"
    saves = "stresses, densities and files of the other steps" if every != 1 else "nothing: every step is asked for"
    yield Decision("fields", every != 1, "output.fields_every", value, "asked for", "none", saves)


def far_field(facts: ReductionInput) -> Iterator[Decision]:
    """Rock beyond absorbing sides, which changes waves that meet them at an angle."""
    scene = facts.scene
    sides = ", ".join(name for term in scene.terms if term.absorbs for name in term.on)
    ratios = {rock.poissons_ratio for rock in scene.rock.values() if rock.poissons_ratio is not None}
    for ratio in sorted(ratios) if sides and scene.has_dynamics else ():
        yield Decision(
            "rock beyond absorbing sides", True, f"share of P and S waves that {sides} send back, by their angle to the normal",
            f"of {'; of '.join(dashpot.reflections(ratio))}; for Poisson's ratio {ratio:g}", "0 at 0 degrees",
            "waves that meet a side at a slant come back weaker: move it away, or turn it towards them", "the rock there",
        )  # fmt: skip
