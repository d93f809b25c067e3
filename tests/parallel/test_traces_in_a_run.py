"""From an untidy table of traces to a flow, on all ranks: what was snapped is in the log, apertures are those of the table."""

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.remarks import bare
from fracflow.scene.scene import load
from fracflow.simulation.run import run

# Anna, the shorter one, stops a hair short of Clara's end, by less than the snap that is stated, and Bruno leaves the domain.
TABLE = """name\taperture\tx1\ty1\tx2\ty2
Anna\t0.1 mm\t0\t1\t2\t1
Clara\t0.2 mm\t2.01\t1.01\t4\t2
Bruno\t\t2\t1.99\t2\t9
"""

SCENE = """
rock.rock = {youngs_modulus = 1e30, poissons_ratio = 0.25}
fracture.default = {law = "linear", normal_stiffness = 1e30, shear_stiffness = 1e30, aperture = "0.3 mm"}
fluid = {viscosity = "1e-3 Pa s", specific_weight = "9.81 kN/m^3"}
support = [{on = ["west", "east", "south", "north"]}]
well = [
  {name = "in", at = {fracture = "Anna", end = "start"}, pressure = 2e5},
  {name = "out", at = {fracture = "Clara", end = "end"}, pressure = 0.5e5},
]
probe = [{name = "A", at = [1, 1], on = "Anna"}, {name = "C", at = [3, 1.5], on = "Clara"},
         {name = "B", at = [2, 3], on = "Bruno"}]
stage = [{kind = "steady", time_step = 1, steps = 1}]
output = {pictures = false}
[geometry]
domain = [0, 0, 4, 4]
size = 0.8
size_at_fractures = 0.4
snap = 0.02
growth = 0.3
fractures_csv = "traces.csv"
cells = "CELLS"
"""


@pytest.mark.parametrize("cells", ["triangles", "quads"])
def test_flow_through_two_fractures_of_a_table(shared_tmp, comm, cells):
    """Resistances 12 mu L/d^3 in series."""
    path = shared_tmp / "scene.toml"
    if comm.rank == 0:
        path.write_text(SCENE.replace("CELLS", cells))
        (shared_tmp / "traces.csv").write_text(TABLE, encoding="utf-8")
    comm.barrier()
    scene = load(path)
    run(scene, shared_tmp / "out", comm)
    comm.barrier()
    log = [bare(line) for line in (shared_tmp / "out" / "log.txt").read_text(encoding="utf-8").splitlines()]
    assert 'fracture "Anna": end (2, 1) moved by 0.0141 m to (2.01, 1.01) onto fracture "Clara"' in log
    assert 'fracture "Bruno": cut at (2, 4), where it leaves the domain; 5 m is left out' in log
    length = np.hypot([2.01, 1.99], [0.01, 0.99])
    rate = 1.5e5 / np.sum(12e-3 * length / np.array([1e-4, 2e-4]) ** 3)
    history = read_history(shared_tmp / "out" / "history.h5")
    for name in "AC":
        assert history[f"probe/{name}/flow_rate"][-1] == pytest.approx(rate, rel=1e-9)
    # The scene that the folder keeps needs the table no more.
    assert load(shared_tmp / "out" / "scene.toml") == scene
    assert "fractures_csv" not in (shared_tmp / "out" / "scene.toml").read_text(encoding="utf-8")
    for name, at in (("well.in", '{fracture = "Bruno", fraction = 0.9}'), ("probe.B", "[2, 8.3]")):
        cut = rf'{name}: at \(2, 8[.0-9]*\) m: lies outside the domain, at whose side fracture "Bruno" ends, at \(2, 4\) m: '
        with pytest.raises(InputError, match=cut):
            prepare(load(path, [f"{name}.at={at}"]), comm)
    with pytest.raises(InputError, match=r'fracture "Bruno" is .* away; move it onto that'):
        prepare(load(path, ["probe.B.at=[5, 8.3]", "probe.B.on=Bruno"]), comm)
