"""A crack under pressure in wide rock, against Sneddon (1946): cells that lock, and cells that are blunt."""

import pytest

from fracflow._petsc import MPI
from fracflow.mesh import read
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.scene.unusual import LOCKS, locking
from fracflow.simulation.run import run

HALF, NET, YOUNG = 10.0, 2e6, 4e10


def crack(nu=0.25, half_width=2000.0, **geometry):
    """Opened by ``NET`` in rock whose sides are held."""
    law = {"normal_stiffness": 1e14, "shear_stiffness": 1e13, "aperture": 1e-3, "friction_coefficient": 0.6}
    outline = [-half_width, -half_width, half_width, half_width]
    trace = {"name": "a", "points": [[-HALF, 0.0], [HALF, 0.0]]}
    sizes = {"size": half_width / 4, "size_at_fractures": 1.0, "growth": 0.3}
    data = {
        "model": "full",
        "rock": {"rock": {"youngs_modulus": YOUNG, "poissons_ratio": nu}},
        "initial_stress": {"xx": -1e7, "yy": -1e7, "zz": -1e7},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 0.0},
        "geometry": {"domain": outline, "fracture": [trace], **sizes, **geometry},
        "support": [{"on": ["west", "east", "south", "north"]}],
        "fracture": {"a": law | {"pressure": [[0, 0.0], [1, 1e7 + NET]]}},
        "probe": [{"name": "p", "at": [0.0, 0.0], "on": "a", "quantities": ["opening"]}],
        "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
        "output": {"pictures": False},
    }
    return Scene.from_data(data)


def lost(folder, scene):
    """The part that the opening in the middle lacks, and the log."""
    run(scene, folder, MPI.COMM_WORLD)
    nu, log = scene.rock["rock"].poissons_ratio, (folder / "log.txt").read_text(encoding="utf-8")
    exact = 4.0 * NET * HALF * (1.0 - nu**2) / YOUNG
    return 1.0 - float(read_history(folder / "history.h5")["probe/p/opening"][-1]) / exact, log


def test_cells_lock_where_rock_keeps_its_volume(shared_tmp):
    usual, still, locked = (lost(shared_tmp / str(nu), crack(nu))[0] for nu in (0.25, LOCKS, 0.49))
    assert usual < still < usual + 0.02 and locked > usual + 0.15
    assert not [*locking(crack(LOCKS))] and "poissons_ratio = 0.49: cells of rock" in "".join(locking(crack(0.49)))


@pytest.mark.parametrize("growth", [0.1, 0.2, 0.3])
def test_quads_may_grow_steeply(shared_tmp, growth):
    """On triangles with a growth of 0.3 it is 0.07."""
    share, log = lost(shared_tmp / "quads", crack(half_width=200.0, cells="quads", growth=growth))
    assert 0.0 < share < 0.12 and "over 150 degrees" not in log


def test_blunt_cells_are_told(shared_tmp, monkeypatch):
    """On those that Gmsh's right-angled algorithm makes here, which are not made anew, half of the opening is lost."""
    monkeypatch.setattr(read, "BLUNT", 1.0)
    share, log = lost(shared_tmp / "blunt", crack(half_width=200.0, cells="quads"))
    assert share > 0.4 and "! mesh: 38 % of the cells have a corner over 150 degrees" in log
