from collections.abc import Callable
from pathlib import Path

import pytest

from fracflow.scene.scene import Scene, load

SCENE = """
[mesh]
file = "fault.geo"

[rock.granite]
youngs_modulus = "50 GPa"
poissons_ratio = 0.25
density = 2700

[initial_stress]
xx = -2e6

[fracture.fault]
normal_stiffness = "10 GPa/m"
shear_stiffness = 1e9
aperture = "1 mm"
friction_angle_deg = 30

[fluid]
viscosity = "1e-3 Pa s"

[[support]]
on = "west"

[[load]]
on = ["south", "north"]
traction = "initial-stress"

[control.pumping]

[[well]]
name = "node2"
at = [0, 1]
flow_rate = "3 l/s"
control = "pumping"

[[probe]]
name = "end"
at = {fracture = "fault", end = "start"}

[[stage]]
name = "slow"
kind = "steady"
until = "incipient"
control = "pumping"

[[stage]]
kind = "dynamic"
time_step = "10 ms"
end = 3
"""


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., Scene]:
    """Load the scene above after overrides, or another text."""

    def make(*overrides: str, text: str = SCENE) -> Scene:
        file = tmp_path / "scene.toml"
        file.write_text(text)
        return load(file, overrides)

    make.text = SCENE  # type: ignore[attr-defined]
    return make
