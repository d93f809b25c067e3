"""Pressures that strain the rock beyond the model, whose strains are small: a rate through next to nothing comes to them."""

from __future__ import annotations

from fracflow.scene.scene import Scene
from fracflow.scene.units import STRESS

STRAINED = 0.1  # p/E: a tenth is no small strain


def beyond_small_strains(scene: Scene, pressure: float) -> str:
    """Words on a pressure that strains rock by over ``STRAINED``, and a remedy; else none.

    pressure  largest difference from that at rest, above or below it [stress]
    """
    stiff = [rock.youngs_modulus for rock in scene.rock.values() if rock.youngs_modulus is not None]
    if not stiff or pressure <= STRAINED * min(stiff):
        return ""
    unit = scene.unit_system.behind(STRESS)
    wells = {
        key: [
            f"well.{well.name}"
            for well in scene.well
            if well.flow_rate is not None and any(sign * value > 0.0 for value in well.flow_rate.values)
        ]
        for key, sign in (("maximum_pressure", 1.0), ("minimum_pressure", -1.0))
    }
    limits = [f"a {key} to {', '.join(names)}" for key, names in wells.items() if names]
    remedy = (
        f"give {', '.join(limits)}, or a minimum_hydraulic_aperture to fractures too narrow for the rate"
        if limits
        else "lower the pressures that wells and fractures prescribe"
    )
    return (
        f"a pressure that differs by {pressure:.3g}{unit} from that at rest strains rock of E = {min(stiff):.3g}{unit} by"
        f" over {STRAINED:g}, where neither strains nor joints are those of the model: later results are meaningless; {remedy}"
    )
