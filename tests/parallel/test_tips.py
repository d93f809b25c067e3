"""Tips in meshed rock: in runs of the program, and the same stiffness of them on any number of ranks."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.mesh.distribute import distribute
from fracflow.model.terms.tips import excesses
from fracflow.output import read_history
from fracflow.reduction.prepare import read_split
from fracflow.scene.scene import load
from fracflow.simulation.run import run

COMM = MPI.COMM_WORLD
SCENE = """
model = "full"
method = {{tips = "{tips}"}}
rock.rock = {{youngs_modulus = "50 GPa", poissons_ratio = 0.25, density = 2700}}
initial_stress = {{xx = "-2 MPa", yy = "-3 MPa", xy = "0.5 MPa", zz = "-2 MPa"}}
fluid = {{viscosity = "1e-3 Pa s", specific_weight = "1e4 N/m^3"}}
output.pictures = false
stage = [{{kind = "{kind}", time_step = "5 ms", steps = 3}}]
support = [{{on = ["west", "east", "south", "north"]}}]
probe = [{{name = "m", at = [0, 0], on = "c", quantities = ["opening", "slip"]}}]
[fracture.c]
normal_stiffness = "1e6 GPa/m"
shear_stiffness = "1e4 GPa/m"
aperture = "0.2 mm"
friction_coefficient = 0.5
pressure = "6 MPa"
[geometry]
domain = [-40, -40, 40, 40]
size = 8
size_at_fractures = {joint}
growth = 0.08
refine = {refine}
cells = "{cells}"
fracture = [{{name = "c", points = [[-0.8, -0.6], [0.8, 0.6]]}}]
"""


def written(folder, **keys):
    if COMM.rank == 0:
        (folder / "scene.toml").write_text(SCENE.format(**keys), encoding="utf-8")
    COMM.barrier()
    return load(folder / "scene.toml")


def in_stripes(mesh, width=0.07):
    """Rank (m,) of each uncut cell by its place, in stripes narrower than a joint, on rank 0."""
    if mesh is None:
        return None
    cells = mesh.uncut.cells
    return (mesh.uncut.points[cells[:, :3]].mean(axis=1)[:, 0] // width).astype(int) % COMM.size


@pytest.mark.parametrize(("cells", "refine"), [("triangles", 0), ("quads", 0), ("triangles", 1)])
def test_excess_of_tips_that_ranks_cut(shared_tmp, cells, refine):
    scene = written(shared_tmp, kind="quasi-static", tips="corrected", joint=0.2, cells=cells, refine=refine)
    mesh = on_root(COMM, lambda: read_split(scene))
    blocks = distribute(mesh, COMM, cell_rank=in_stripes(mesh))
    found = excesses(blocks, scene)
    both = COMM.allgather([(blocks.solid.node_ids[walls].tolist(), modulus) for walls, modulus in found])
    cut = {tuple(walls): modulus for each in both for walls, modulus in each}
    whole = distribute(COMM.bcast(mesh, root=0), MPI.COMM_SELF)
    alone = {tuple(whole.solid.node_ids[walls].tolist()): modulus for walls, modulus in excesses(whole, scene)}
    assert len(alone) == 2 and cut.keys() == alone.keys()
    for walls, modulus in alone.items():
        assert np.array_equal(cut[walls], modulus)
        assert 0.03 < modulus.trace() / 50e9 < 0.4


def missing(shared_tmp, kind, tips, joint):
    """Shares (2,) by which opening and slip are too small; 2.88 MPa act normal to the crack, 0.34 along it."""
    scene = written(shared_tmp, kind=kind, tips=tips, joint=joint, cells="triangles", refine=0)
    run(scene, shared_tmp / tips, COMM)
    history = read_history(shared_tmp / tips / "history.h5")
    energy = {name: np.abs(values).max() for name, values in history.items() if name.startswith("energy/")}
    assert energy["energy/residual"] < 1e-10 * max(energy.values())
    assert (energy.get("energy/tips", 0.0) > 0.0) == (tips == "corrected")
    found = np.abs([history[f"probe/m/{name}"][-1] for name in ("opening", "slip")])
    return 1 - found / (4 * (1 - 0.25**2) / 50e9 * np.array([2.88e6, 0.34e6]))


def test_an_open_crack_in_a_run(shared_tmp):
    plain, corrected = (missing(shared_tmp, "quasi-static", tips, joint=0.1) for tips in ("plain", "corrected"))
    assert plain[0] > 0.035 and corrected[0] < 0.012
    assert np.abs(corrected).max() < np.abs(plain).max() / 3


@pytest.mark.serial
def test_the_balance_of_energy_with_inertia(shared_tmp):
    missing(shared_tmp, "dynamic", "corrected", joint=0.3)
