"""Probes and fields against closed forms and the energy balance."""

import xml.etree.ElementTree as ElementTree

import h5py
import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.output.fields import list_steps, read_mesh, read_step
from fracflow.output.history import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

E, NU = 10e9, 0.25
ROCK = f"""
[output]
pictures = false
fields_every = 1
[rock.rock]
youngs_modulus = {E}
poissons_ratio = {NU}
density = 2500
"""
# An affine motion of a block under a stress that grows with depth.
GRADIENT = np.array([[1e-4, 3e-4], [-1e-4, 2e-4]])
AFFINE = (
    ROCK
    + f"""
[geometry]
domain = [0, 0, 4, 3]
size = 1
cells = "quads"
[initial_stress]
datum = 3
xx = -1e5
yy = -2e5
zz = -3e5
xy = 4e4
gradient = {{xx = -5e3, yy = -2e4, zz = -6e3}}
[body_force]
y = -2e4
[[support]]
on = ["south", "north", "east", "west"]
displacement_gradient = {GRADIENT.tolist()}
[[probe]]
name = "inside"
at = [2, 1]
[[probe]]
name = "corner"
at = [4, 0]
quantities = ["stress"]
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 1
"""
)
CRACK = (
    ROCK
    + """
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.6
cohesion = 1e5
stick_slip_ratio = 0.9
[geometry]
domain = [0, 0, 4, 3]
size = 0.8
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 2]]
[initial_stress]
xx = -5e6
yy = -5e6
[fluid]
viscosity = 1e-3
specific_weight = 1e4
initial_pressure = 1e6
[[support]]
on = ["south", "east"]
[[support]]
on = ["north", "west"]
displacement = {x = {time = [0, 4e-4], value = [0, 2e-3]}, y = 0.0}
[[well]]
name = "in"
at = {fracture = "crack", end = "start"}
pressure = 2e6
[[probe]]
name = "middle"
at = [2, 1.5]
[[stage]]
kind = "quasi-static"
time_step = 1e-4
steps = 4
[[stage]]
kind = "dynamic"
time_step = 1e-5
steps = 6
"""
)


@pytest.fixture
def ran(shared_tmp, comm):
    """Function (scene, *overrides) -> folder of its run. Collective."""

    def once(text, *overrides):
        if comm.rank == 0:
            (shared_tmp / "scene.toml").write_text(text, encoding="utf-8")
        comm.barrier()
        run(load(shared_tmp / "scene.toml", list(overrides)), shared_tmp / "out", comm)
        comm.barrier()
        return shared_tmp / "out"

    return once


def hooke(strain):
    """Stress of a plane strain with components xx, yy, zz, xy."""
    lame, shear = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    return lame * strain[:3].sum() * np.array([1, 1, 1, 0]) + 2 * shear * strain


def initial(y):
    return np.array([-1e5, -2e5, -3e5, 4e4]) + (3 - y) * np.array([-5e3, -2e4, -6e3, 0.0])


@pytest.mark.parametrize("cells", ["triangles", "quads"])
def test_strain_and_stress_of_an_affine_motion(ran, cells):
    """The strain is the symmetric gradient, the stress sigma_0 at the place plus Hooke's, zz by plane strain."""
    folder = ran(AFFINE, f"geometry.cells={cells}")
    history = read_history(folder / "history.h5")
    tensor = 0.5 * (GRADIENT + GRADIENT.T)
    strain = np.array([tensor[0, 0], tensor[1, 1], 0.0, tensor[0, 1]])
    assert history["probe/inside/strain"][-1] == pytest.approx(strain, rel=1e-9)
    y = history["probe/inside/displacement"][-1] @ np.linalg.inv(GRADIENT).T
    assert history["probe/inside/stress"][0] == pytest.approx(initial(y[1]), rel=1e-9)
    assert history["probe/inside/stress"][-1] == pytest.approx(initial(y[1]) + hooke(strain), rel=1e-9)
    assert history["probe/corner/stress"][-1] == pytest.approx(initial(0.0) + hooke(strain), rel=1e-9)
    assert "probe/corner/displacement" not in history

    points, cells, _ = read_mesh(folder, "rock")
    _, point, cell = read_step(list_steps(folder, "rock")[-1][1])
    assert point["displacement"][:, :2] == pytest.approx(points[:, :2] @ GRADIENT.T, abs=1e-12)
    centre = np.array([points[nodes[nodes >= 0]].mean(axis=0) for nodes in cells])
    whole = np.array([initial(y) for y in centre[:, 1]]) + hooke(strain)
    stress = cell["stress"][:, [0, 1, 2, 0], [0, 1, 2, 1]]
    assert stress == pytest.approx(whole, rel=1e-9)
    assert cell["strain"][:, :2, :2] == pytest.approx(np.tile(tensor, (len(cells), 1, 1)), abs=1e-12)


def areas(points, cells):
    """Areas by the shoelace rule."""
    result = []
    for nodes in cells:
        x, y, _ = points[nodes[nodes >= 0]].T
        result.append(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return np.array(result)


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["geometry.cells=quads", "method.mass=consistent", "method.quadrature=gauss2"],
        ["method.quadrature=one-point"],
    ],
    ids=["triangles", "quads", "one-point"],
)
def test_densities_add_up_to_the_books(ran, overrides):
    """Densities times area or length are the entries of the books, at every step."""
    folder = ran(CRACK, *overrides)
    history = read_history(folder / "history.h5")
    points, cells, _ = read_mesh(folder, "rock")
    area = areas(points, cells)
    ends, pieces, _ = read_mesh(folder, "fractures")
    share = np.repeat(0.5 * np.linalg.norm(ends[pieces[:, 1]] - ends[pieces[:, 0]], axis=1), 2)
    steps = list_steps(folder, "rock")
    assert len(steps) == len(history["time"])
    largest = max(np.abs(v).max() for k, v in history.items() if k.startswith("energy/"))
    for row, (_, path) in enumerate(steps):
        _, _, cell = read_step(path)
        _, joint, _ = read_step(list_steps(folder, "fractures")[row][1])
        book = {name: history[f"energy/{name}"][row] for name in ("rock_strain", "kinetic", "friction", "joint_shear")}
        stored = book["joint_shear"] + history["energy/joint_normal_closed"][row]
        assert area @ cell["strain_energy_density"] == pytest.approx(book["rock_strain"], abs=1e-9 * largest)
        assert area @ cell["kinetic_energy_density"] == pytest.approx(book["kinetic"], abs=1e-9 * largest)
        assert share @ joint["friction_energy"] == pytest.approx(book["friction"], abs=1e-9 * largest)
        assert share @ joint["stored_energy"] == pytest.approx(stored, abs=1e-9 * largest)
    for entry in ("rock_strain", "kinetic", "friction", "joint_shear"):
        assert np.abs(history[f"energy/{entry}"]).max() > 1e-6 * largest, entry


def test_the_index_of_a_run_leads_to_its_fields(ran):
    """Every array that rock.xdmf and fractures.xdmf name is there in the size they promise, and no field is left out."""
    folder = ran(CRACK)
    for family, least in (
        ("rock", {"velocity", "strain_energy_density"}),
        ("fractures", {"strength", "utilisation", "head"}),
    ):
        grids = ElementTree.parse(folder / f"{family}.xdmf").findall("Domain/Grid/Grid")
        assert len(grids) == 11
        for item in grids[-1].iter("DataItem"):
            file, key = item.text.strip().split(":")
            with h5py.File(folder / file) as data:
                assert data[key].shape == tuple(map(int, item.get("Dimensions").split()))
        _, point, cell = read_step(list_steps(folder, family)[-1][1])
        assert least <= {field.get("Name") for field in grids[-1].findall("Attribute")} == {*point, *cell}


def test_what_a_fracture_tells_agrees_with_the_law(ran):
    """(2.12) strength = C - f_n tan(phi); sliding it carries alpha times that; d = d0 + opening; head = p / gamma."""
    history = read_history(ran(CRACK) / "history.h5")
    found = {key.rsplit("/", 1)[1]: values for key, values in history.items() if key.startswith("probe/middle/")}
    assert found["strength"] == pytest.approx(1e5 - 0.6 * found["normal_traction"], rel=1e-9)
    assert found["aperture"] == pytest.approx(1e-3 + found["opening"], rel=1e-9)
    assert found["head"] == pytest.approx(found["pressure"] / 1e4, rel=1e-12)
    slid = np.diff(found["plastic_slip"]) != 0.0
    assert slid.any()
    assert np.abs(found["shear_traction"][1:][slid]) == pytest.approx(0.9 * found["strength"][1:][slid], rel=1e-6)


PROBE = "[[probe]]" + CRACK.split("[[probe]]")[1]
DRY = CRACK.split("[fluid]")[0] + "[[support]]" + CRACK.split("[[support]]", 1)[1].split("[[well]]")[0] + PROBE


@pytest.mark.parametrize(
    ("text", "at", "quantity", "message"),
    [
        (CRACK, "[2, 1.5]", "stress", "belongs to the rock, and the probe sits on the fracture crack there"),
        (CRACK, "[2, 0.3]", "slip", "belongs to a fracture, and the probe sits in the rock rock there"),
        (DRY, "[2, 1.5]", "pressure", r"models no flow: it needs a \[fluid\]"),
        (CRACK.replace("specific_weight = 1e4\n", ""), "[2, 1.5]", "head", "needs .fluid. with specific_weight"),
    ],
)
def test_a_quantity_that_a_place_has_not_is_refused(ran, text, at, quantity, message):
    text = (
        text.split("[[probe]]")[0]
        + f'[[probe]]\nname = "p"\nat = {at}\nquantities = ["{quantity}"]\n'
        + ('[[stage]]\nkind = "quasi-static"\ntime_step = 1\nsteps = 1\n')
    )
    with pytest.raises(InputError, match=rf"probe\.p\.quantities: {quantity}: .*{message}"):
        ran(text)


def test_what_a_dry_fracture_has_is_written(ran):
    history = read_history(ran(DRY) / "history.h5")
    assert history["probe/middle/aperture"] == pytest.approx(1e-3 + history["probe/middle/opening"], rel=1e-9)
    assert "probe/middle/pressure" not in history
