from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import h5py
import numpy as np
import pytest

from fracflow.output.fields import FieldWriter, list_steps, read_mesh, read_step

pytestmark = pytest.mark.serial

POINTS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [2.0, 0.0]])
CELLS = {
    "Mixed": (
        np.array([[0, 1, 2, 3], [1, 4, 2, -1], [0, 1, -1, -1]]),
        [5, 0, 1, 2, 3, 4, 1, 4, 2, 2, 2, 0, 1],
    ),
    "Triangle": (np.array([[0, 1, 2, -1], [1, 4, 2, -1]]), [[0, 1, 2], [1, 4, 2]]),
    "Polyline": (np.array([[0, 1], [1, 4]]), [[0, 1], [1, 4]]),
}


def item(folder, element):
    """Values that an XDMF reader would load, checked against the size that the file promises."""
    file, key = element.text.strip().split(":")
    with h5py.File(folder / file) as data:
        values = data[key][()]
    assert values.shape == tuple(int(n) for n in element.get("Dimensions").split())
    assert values.dtype.itemsize == int(element.get("Precision"))
    assert {"f": "Float", "i": "Int"}[values.dtype.kind] == element.get("NumberType")
    return values


@pytest.mark.parametrize("kind", CELLS)
def test_the_index_leads_to_the_values(tmp_path, kind):
    cells, topology = CELLS[kind]
    writer = FieldWriter(tmp_path, "rock", POINTS, cells, {"fractures": ["A", "B"]})
    stress = np.arange(4.0 * len(cells)).reshape(-1, 2, 2)
    for index, time in ((0, 0.0), (12, 0.1)):
        point_data = {"displacement": POINTS + time, "is <open>": np.array([True, False, True, False, False])}
        writer.write(index, time, point_data, {"stress": stress, "rock": np.arange(len(cells))})
    assert [path.name for _, path in list_steps(tmp_path, "rock")] == ["rock_000000.h5", "rock_000012.h5"]

    collection = ElementTree.parse(tmp_path / "rock.xdmf").find("Domain/Grid")
    assert collection.get("CollectionType") == "Temporal"
    grids = collection.findall("Grid")
    assert [float(grid.find("Time").get("Value")) for grid in grids] == [0.0, 0.1]
    last = grids[-1]
    assert last.find("Topology").get("TopologyType") == kind
    np.testing.assert_array_equal(item(tmp_path, last.find("Topology/DataItem")), topology)
    np.testing.assert_array_equal(item(tmp_path, last.find("Geometry/DataItem"))[:, :2], POINTS)
    found = {
        field.get("Name"): (field.get("AttributeType"), field.get("Center"), field.find("DataItem"))
        for field in last.findall("Attribute")
    }
    assert found["displacement"][:2] == ("Vector", "Node")
    np.testing.assert_array_equal(item(tmp_path, found["displacement"][2])[:, :2], POINTS + 0.1)
    assert found["stress"][:2] == ("Tensor", "Cell")
    tensor = item(tmp_path, found["stress"][2]).reshape(-1, 3, 3)
    np.testing.assert_array_equal(tensor[:, :2, :2], stress)
    assert found["is <open>"][:2] == ("Scalar", "Node")

    time, point_data, cell_data = read_step(list_steps(tmp_path, "rock")[-1][1])
    assert time == 0.1 and point_data["displacement"].shape == (5, 3)
    np.testing.assert_array_equal(cell_data["stress"], tensor)
    points, read_cells, attrs = read_mesh(tmp_path, "rock")
    assert points.shape == (5, 3) and attrs["fractures"] == '["A", "B"]'
    np.testing.assert_array_equal(read_cells, cells)


def test_resuming_keeps_steps_and_starting_anew_removes_them(tmp_path):
    cells = CELLS["Polyline"][0]
    FieldWriter(tmp_path, "a", POINTS, cells).write(3, 1.5, {"slip": np.zeros(5)})
    FieldWriter(tmp_path, "a", POINTS, cells, resume=True).write(4, 2.0, {"slip": np.zeros(5)})
    grids = ElementTree.parse(tmp_path / "a.xdmf").findall("Domain/Grid/Grid")
    assert [grid.find("Time").get("Value") for grid in grids] == ["1.5", "2.0"]
    FieldWriter(tmp_path, "a", POINTS, cells)
    assert list_steps(tmp_path, "a") == []


def test_fields_of_the_wrong_length_are_refused(tmp_path):
    writer = FieldWriter(tmp_path, "a", POINTS, CELLS["Polyline"][0])
    with pytest.raises(ValueError, match="slip of a: 4 rows, should be 5 points"):
        writer.write(0, 0.0, {"slip": np.zeros(4)})
    assert list_steps(tmp_path, "a") == []
