"""Meshes of other programs: the same network written by meshio into each format is the same mesh, and makes the same run."""

from __future__ import annotations

import sys

import h5py
import meshio
import netCDF4
import numpy as np
import pytest
from stopped_run import SCENE

from fracflow.errors import InputError
from fracflow.mesh.files.others import read_other
from fracflow.mesh.read import read_mesh
from fracflow.output.history import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial
SIDES = {"west": (0, 0.0), "east": (0, 4.0), "south": (1, 0.0), "north": (1, 4.0)}
FORMS = {"m.inp": "abaqus", "m.vtu": "vtu", "m.e": "exodus", "m.xdmf": "xdmf", "m.msh": "gmsh22"}


def network():
    """A square of four by four cells, halves of squares, with a fracture that ends inside, and a named place."""
    x, y = (each.ravel().astype(float) for each in np.meshgrid(np.arange(5), np.arange(5)))
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    quads = corner[:, None] + [0, 1, 6, 5]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    lines = {"Anna": [[7, 12], [12, 17]]}
    for name, (axis, value) in SIDES.items():
        on = np.flatnonzero((x, y)[axis] == value)
        lines[name] = np.column_stack([on[:-1], on[1:]]).tolist()
    return np.column_stack([x, y, 0 * x]), triangles, lines


def mesh_of(form):
    """The network as meshio has it: sets where the format has them, else numbers under the names in a row."""
    points, triangles, lines = network()
    names = ["rock", *lines]
    cells = [("triangle", triangles), ("line", np.concatenate([*lines.values()]))]
    number = [
        np.zeros(len(triangles), int),
        np.repeat(np.arange(1, len(names)), [len(each) for each in lines.values()]),
    ]
    if form == "abaqus":
        sets = {name: [np.flatnonzero(each == k) for each in number] for k, name in enumerate(names)}
        return meshio.Mesh(points, cells, cell_sets=sets, point_sets={"well": np.array([12])})
    if form == "gmsh22":
        dims = [2, *[1] * len(lines)]
        tags = {"gmsh:physical": [each + 1 for each in number], "gmsh:geometrical": [each + 1 for each in number]}
        about = {name: np.array([k + 1, dim]) for k, (name, dim) in enumerate(zip(names, dims, strict=True))}
        return meshio.Mesh(points, cells, cell_data=tags, field_data=about)
    if form == "exodus":
        return meshio.Mesh(points, [("triangle", triangles), *(("line", np.array(each)) for each in lines.values())])
    return meshio.Mesh(points, cells, cell_data={"-".join(names): number})


def write(folder, name):
    meshio.write(folder / name, mesh_of(FORMS[name]), file_format=FORMS[name])
    if name == "m.e":  # meshio numbers blocks; other programs name them
        with netCDF4.Dataset(folder / name, "a") as file:
            names = file.createVariable("eb_names", "S1", ("num_el_blk", "len_string"))
            for k, each in enumerate(["rock", *network()[2]]):
                names[k, : len(each)] = list(each)
    return folder / name


def sides_of_cells(lines, numbers):
    """Element and side (f, 2), from one, of lines of the network, in an Exodus file whose sides have these numbers."""
    _, triangles, _ = network()
    edge = {
        (cell[i], cell[(i + 1) % 3]): (n + 1, numbers[i]) for n, cell in enumerate(triangles.tolist()) for i in range(3)
    }
    return np.array([edge.get((a, b)) or edge[b, a] for a, b in lines])


def side_sets(path, space, first):
    """The network as an Exodus file of cells alone; its lines are side sets, the first of them by its number only."""
    points, triangles, lines = network()
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles[:6]), ("triangle", triangles[6:])]))
    with netCDF4.Dataset(path, "a") as file:
        if space == 2:
            file.renameDimension("num_dim", "of_coord")
            file.createDimension("num_dim", 2)
        blocks, names = (file.createVariable(name, "S1", (file.createDimension(f"n_{name}", size).name, "len_string"))
                         for name, size in (("eb_names", 2), ("ss_names", 5)))  # fmt: skip
        for k in range(2):
            blocks[k, :4] = list("rock")
        for k, (name, rows) in enumerate(lines.items()):
            names[k, : len(name)] = list(name) if name != "Anna" else [""] * 4
            count = file.createDimension(f"num_side_ss{k + 1}", len(rows)).name
            for key, values in zip(
                ("elem", "side"), sides_of_cells(rows, [first, first + 1, first + 2]).T, strict=True
            ):
                file.createVariable(f"{key}_ss{k + 1}", "i4", (count,))[:] = values
    return path


RUN = (
    SCENE[: SCENE.index("geometry =")]
    + """
mesh = {file = "m.msh"}
output = {pictures = false}
probe = [{name = "middle", at = [2, 2], on = "Anna"}]
[fracture.Anna]
"""
    + SCENE[SCENE.index("normal_stiffness") :]
)
RUN = RUN.replace('probe = [{name = "middle", at = [500, 400], on = "Bruno"}]\n', "")


@pytest.mark.parametrize("name", FORMS)
def test_each_format_gives_the_same_mesh(name, tmp_path):
    raw = read_mesh(write(tmp_path, name), ["Anna"])
    points, triangles, lines = network()
    assert np.array_equal(raw.points, points[:, :2]) and np.array_equal(raw.cells, triangles)
    assert raw.fractures == ("Anna",) and raw.rocks == ("rock",) and sorted(raw.sides) == sorted(SIDES)
    assert np.array_equal(raw.fracture_facets, lines["Anna"])
    for k, side in enumerate(raw.sides):
        assert np.array_equal(np.sort(raw.side_facets[raw.side_of == k]), np.sort(lines[side]))
    assert raw.named_points == ({"well": 12} if name == "m.inp" else {})


@pytest.mark.parametrize(("space", "first"), [(2, 1), (3, 3)])
def test_side_sets_name_fractures_and_sides(tmp_path, space, first):
    """Faces of cells come before their edges in space, and a set without a name is called by its number."""
    raw = read_mesh(side_sets(tmp_path / "m.e", space, first), ["1"])
    points, triangles, lines = network()
    assert np.array_equal(raw.points, points[:, :2]) and np.array_equal(raw.cells, triangles)
    assert raw.fractures == ("1",) and raw.rocks == ("rock",) and sorted(raw.sides) == sorted(SIDES)
    assert np.array_equal(np.sort(raw.fracture_facets), lines["Anna"])
    for k, side in enumerate(raw.sides):
        assert np.array_equal(np.sort(raw.side_facets[raw.side_of == k]), np.sort(lines[side]))
    with pytest.raises(ValueError, match='the side set "west" has a side that no triangle or quadrilateral has'):
        read_other(side_sets(tmp_path / "n.e", space, first + 1))


def test_sets_of_sets_of_abaqus(tmp_path):
    """Stated with elements, as ranges, as sets of other sets; elements of plane strain; names in any letters."""
    points, triangles, lines = network()
    rows = ["*NODE", *(f"{k}, {x}, {y}" for k, (x, y, _) in enumerate(points.tolist(), 1)), "*ELEMENT, TYPE=CPE3"]
    rows += [f"{k}, {a + 1}, {b + 1}, {c + 1}" for k, (a, b, c) in enumerate(triangles.tolist(), 1)]
    last = len(triangles)
    for part, (a, b) in zip(("lower", "upper"), lines["Anna"], strict=True):
        last += 1
        rows += [f"*ELEMENT, TYPE=T3D2, ELSET={part}", f"{last}, {a + 1}, {b + 1}"]
    rows += [f"*ELSET, ELSET=rock, GENERATE\n1, 16\n17, {len(triangles)}, 1", "*ELSET, ELSET=Anna", "Upper, lower"]
    rows += ["*ELSET, ELSET=top\nUPPER", "*ELSET, ELSET=top", f"{last - 1}", "** the end"]
    (tmp_path / "m.inp").write_text("\n".join(rows) + "\n")
    raw = read_mesh(tmp_path / "m.inp", ["Anna", "top"])
    assert raw.fractures == ("Anna", "top") and raw.rocks == ("rock",) and np.array_equal(raw.cells, triangles)
    for k in range(2):
        assert np.array_equal(raw.fracture_facets[raw.fracture_of == k], lines["Anna"])
    (tmp_path / "m.inp").write_text("\n".join(rows).replace("Upper, lower", "upper, middle"))
    with pytest.raises(ValueError, match='the set "Anna" has "middle", which stands nowhere before it'):
        read_other(tmp_path / "m.inp")
    (tmp_path / "m.inp").write_text("\n".join(rows).replace(f"{last}, 13", "1, 13"))
    with pytest.raises(ValueError, match="has two elements 1: give the whole mesh in one part"):
        read_other(tmp_path / "m.inp")


def test_each_format_gives_the_same_run_to_the_last_bit(tmp_path):
    (tmp_path / "scene.toml").write_text(RUN)
    found = {}
    for name in FORMS:
        write(tmp_path, name)
        scene = load(tmp_path / "scene.toml", [f'mesh.file="{name}"', 'stage.0.end="12 h"'])
        run(scene, tmp_path / name.replace(".", "-"))
        found[name] = read_history(tmp_path / name.replace(".", "-") / "history.h5")
    for name, history in found.items():
        for key, values in found["m.msh"].items():
            assert np.array_equal(history[key], values, equal_nan=True) or "factorisations" in key, (name, key)
    assert np.ptp(found["m.msh"]["probe/middle/opening"]) > 0.0


def test_tags_of_facets_are_names(tmp_path):
    """As of FEniCS: whole numbers on cells and edges, zero where there is none."""
    points, triangles, lines = network()
    edges = np.concatenate([*lines.values()])
    tags = [np.full(len(triangles), 5), np.array([2] * 2 + [0] * (len(edges) - 2))]
    mesh = meshio.Mesh(points[:, :2], [("triangle", triangles), ("line", edges)], cell_data={"facets": tags})
    meshio.write(tmp_path / "m.xdmf", mesh)
    raw = read_mesh(tmp_path / "m.xdmf", ["2"])
    assert raw.fractures == ("2",) and raw.rocks == ("5",) and raw.sides == ()


def text(name, text):
    return lambda folder: (folder / name).write_text(text)


def xdmf_with(item):
    head = '<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XY"><DataItem Dimensions="3 2" '
    return text("m.xdmf", f"{head}{item}</DataItem></Geometry></Grid></Domain></Xdmf>")


def without_names(name):
    def make(folder):
        points, triangles, _ = network()
        meshio.write(folder / name, meshio.Mesh(points, [("triangle", triangles)]))

    return make


def two_arrays(folder):
    points, triangles, _ = network()
    data = {key: [np.zeros(len(triangles), int)] for key in ("a", "b")}
    meshio.write(folder / "m.vtu", meshio.Mesh(points, [("triangle", triangles)], cell_data=data))


def leads_elsewhere(folder):
    write(folder, "m.xdmf")
    with h5py.File(folder / "m.h5", "a") as file:
        del file["data0"]
        file["data0"] = h5py.ExternalLink("other.h5", "data0")


def beside_is_a_link(folder):
    write(folder, "m.xdmf")
    (folder / "m.h5").rename(folder / "other.h5")
    (folder / "m.h5").symlink_to("other.h5")


def cut_off(name):
    def make(folder):
        path = write(folder, name)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    return make


ENTITIES = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "b">]><VTKFile>&a;</VTKFile>'
BAD = {
    "entities": ("m.vtu", text("m.vtu", ENTITIES), "document type or entities"),
    "entities in XDMF": ("m.xdmf", text("m.xdmf", ENTITIES), "document type or entities"),
    "no XML": ("m.vtu", text("m.vtu", "x"), "is no XML file"),
    "data elsewhere": ("m.xdmf", xdmf_with('Format="HDF">../m.h5:/a'), "must be a file beside it, and no link"),
    "data anywhere": ("m.xdmf", xdmf_with('Format="HDF">/etc/m.h5:/a'), "must be a file beside it, and no link"),
    "data in a file of bytes": ("m.xdmf", xdmf_with('Format="Binary">/etc/passwd'), "data in binary files"),
    "a link for data": ("m.xdmf", beside_is_a_link, "must be a file beside it, and no link"),
    "a link in its data": ("m.xdmf", leads_elsewhere, "data0 is a link"),
    "data that is no HDF5": (
        "m.xdmf",
        lambda f: (write(f, "m.xdmf"), text("m.h5", "x")(f)),
        "is no readable HDF5 file",
    ),
    "another file": ("m.inp", text("m.inp", "*NODE\n1, 0, 0\n*include, input=/etc/passwd\n"), "includes another file"),
    "no names": ("m.vtu", without_names("m.vtu"), "its cells have no names: give rocks, fractures and sides sets"),
    "no names in Abaqus": ("m.inp", without_names("m.inp"), "its cells have no names"),
    "several arrays": ("m.vtu", two_arrays, r"several arrays of whole numbers \(a, b\): keep one"),
    **{f"half of {name}": (name, cut_off(name), "cut off|no readable") for name in ("m.vtu", "m.e", "m.xdmf")},
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_the_reason(case, tmp_path):
    name, make, why = BAD[case]
    make(tmp_path)
    with pytest.raises(ValueError, match=why) as told:
        read_other(tmp_path / name)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("case", ["entities", "no names in Abaqus", "half of m.e"])
def test_a_bad_file_is_one_line_with_its_name_and_a_remedy(case, tmp_path):
    name, make, why = BAD[case]
    make(tmp_path)
    with pytest.raises(InputError, match=why) as told:
        read_mesh(tmp_path / name, ["Anna"])
    line = str(told.value)
    assert line.startswith(str(tmp_path / name)) and "save it again" in line and "\n" not in line, line


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    write(tmp_path, "m.e")
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    with pytest.raises(ValueError, match="the package netCDF4 is needed"):
        read_other(tmp_path / "m.e")
