"""fields.vtkhdf as vtk itself reads it, against the HDF5 files of the XDMF, bit for bit."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from stopped_run import SCENE, stop_half_way
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOHDF import vtkHDFReader

from fracflow.output.fields import list_steps, read_mesh, read_step
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

pytestmark = pytest.mark.serial
TIMES = vtkStreamingDemandDrivenPipeline.TIME_STEPS()


def opened(folder):
    reader = vtkHDFReader()
    reader.SetFileName(str(folder / "fields.vtkhdf"))
    reader.UpdateInformation()
    return reader, list(reader.GetOutputInformation(0).Get(TIMES) or ())


def same(folder, steps):
    """All arrays of these steps, of rock and fractures, and the mesh; what is not defined elsewhere is nan or -1."""
    reader, times = opened(folder)
    assert times == [read_step(path)[0] for _, path in list_steps(folder, "fractures")]
    meshes = {name: read_mesh(folder, name) for name in ("rock", "fractures")}
    count = 0
    for step in steps:
        reader.UpdateTimeStep(times[step])
        grid = reader.GetOutputDataObject(0)
        points = vtk_to_numpy(grid.GetPoints().GetData())
        assert points.tobytes() == np.concatenate([each[0] for each in meshes.values()]).tobytes()
        first = [0, 0]
        for name, (nodes, cells, _) in meshes.items():
            for place, rows, data in ((0, len(nodes), grid.GetPointData()), (1, len(cells), grid.GetCellData())):
                mine, there = slice(first[place], first[place] + rows), read_step(list_steps(folder, name)[step][1])
                for key, values in there[1 + place].items():
                    found = vtk_to_numpy(data.GetArray(key))
                    assert found[mine].tobytes() == values.tobytes() and found.dtype == values.dtype, (name, key)
                    if name == "fractures" and key not in read_step(list_steps(folder, "rock")[step][1])[1 + place]:
                        rest = found[: first[place]]
                        assert np.isnan(rest).all() if rest.dtype.kind == "f" else (rest == -1).all()
                    count += 1
                first[place] += rows
        sizes = [grid.GetCell(k).GetNumberOfPoints() for k in range(grid.GetNumberOfCells())]
        assert sizes == [(row >= 0).sum() for _, cells, _ in meshes.values() for row in cells]
        last = grid.GetCell(len(sizes) - 1)
        ends = [last.GetPointId(k) - len(meshes["rock"][0]) for k in range(2)]
        assert ends == meshes["fractures"][1][-1].tolist()
    return count


def test_vtk_reads_what_the_xdmf_has_bit_for_bit_at_each_time(tmp_path):
    """A bent fracture in pieces, at the first and the last of six times; and where the folder has been moved."""
    (tmp_path / "scene.toml").write_text(
        SCENE.replace("[[400, 600], [600, 200]]", "[[400, 600], [450, 400], [600, 200]]")
    )
    run(load(tmp_path / "scene.toml"), tmp_path / "run")
    shutil.move(tmp_path / "run", tmp_path / "moved")
    assert len(opened(tmp_path / "moved")[1]) == 6
    assert same(tmp_path / "moved", [0, 5]) > 40


def test_a_run_that_goes_on_has_no_step_twice(tmp_path):
    folder = stop_half_way(tmp_path)
    assert same(folder, [0, 2])
    resume(folder)
    assert same(folder, [1, 5]) and opened(folder)[1] == sorted(set(opened(folder)[1]))


def test_it_can_be_left_out(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    run(load(tmp_path / "scene.toml", ["output.vtkhdf=false", 'stage.0.end="6 h"']), tmp_path / "run")
    assert not [*(tmp_path / "run").rglob("*vtkhdf*"), *(tmp_path / "run").rglob("grid.h5")]
