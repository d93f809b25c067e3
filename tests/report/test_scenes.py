"""The scenes of ``meshes/`` that are not the report's, each held against numbers from outside the program."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

MESHES = Path(__file__).parents[2] / "meshes"
# stress xx, yy, xy and p0 as the scenes state them; the wells' rate at a control of 1; where it comes out; dynamic steps
SCENES = {
    "three_fractures": ((-13e6, -25e6, 0.0), 5e6, 1e-3, (1000, 330), 20),
    "crossings": ((-10e6, -15e6, 4e6), 1e6, 1.0, None, 4),
}


# on ranks crossings are compared in parallel/test_same_on_ranks.py
@pytest.fixture(scope="module", params=["three_fractures", pytest.param("crossings", marks=pytest.mark.serial)])
def ran_scene(request, tmp_path_factory):
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(tmp_path_factory.mktemp("scene")) if comm.rank == 0 else None)) / "out"
    short = f"stage.1.steps={SCENES[request.param][4]}"
    scene = load(MESHES / request.param / "scene.toml", ["output.pictures=false", "output.fields_every=1", short])
    run(scene, folder, comm)
    found = None
    if comm.rank == 0:
        with h5py.File(folder / "fields/fractures_mesh.h5") as file:
            ends = file["points"][:, :2].reshape(-1, 2, 2)
        steps = []
        for path in sorted((folder / "fields").glob("fractures_0*.h5")):
            with h5py.File(path) as file:
                steps.append({key: item[()].reshape(-1, 2) for key, item in file["point"].items()})
        found = ends, steps, read_history(folder / "history.h5"), read_events(folder / "events.csv")
    return request.param, *comm.bcast(found)


def test_initial_tractions_are_mohrs(ran_scene):
    """(2.14) sigma_n = n sigma n, tau = s sigma n, the effective one plus p0, on every facet."""
    name, ends, steps, *_ = ran_scene
    (xx, yy, xy), p0 = SCENES[name][:2]
    along = ends[:, 1] - ends[:, 0]
    s = along / np.linalg.norm(along, axis=1)[:, None]
    n = np.stack([-s[:, 1], s[:, 0]], axis=1)
    traction = n @ np.array([[xx, xy], [xy, yy]])
    for end in (0, 1):
        assert steps[0]["normal_traction"][:, end] == pytest.approx(np.sum(traction * n, axis=1) + p0, rel=1e-9)
        assert steps[0]["shear_traction"][:, end] == pytest.approx(np.sum(traction * s, axis=1), rel=1e-9, abs=1.0)


def test_what_is_pumped_in_comes_out(ran_scene):
    """Kirchhoff in the steady state: all of Q leaves by the outlet, each junction passes on what it gets, dead ends nothing."""
    name, ends, steps, history, _ = ran_scene
    last = int(np.flatnonzero(history["step/kind"] == 0)[-1])
    flow = steps[last]["flow_rate"][:, 0]
    pumped = SCENES[name][2] * history["step/control/pumping"][last]
    places, number = np.unique(np.round(ends.reshape(-1, 2), 6), axis=0, return_inverse=True)
    number = number.reshape(-1, 2)
    net = np.bincount(number[:, 0], flow, len(places)) - np.bincount(number[:, 1], flow, len(places))
    assert net.max() == pytest.approx(pumped, rel=1e-9)
    assert net.min() == pytest.approx(-pumped, rel=1e-9)
    assert np.sum(np.abs(net) > 1e-9 * pumped) == 2
    if SCENES[name][3] is not None:
        assert places[np.argmin(net)] == pytest.approx(SCENES[name][3])


def test_slip_begins_at_the_coulomb_strength(ran_scene):
    """0.6 |f_n| where it begins, one part in a million below at the end of the search; there the first event starts."""
    _, ends, steps, history, events = ran_scene
    last = int(np.flatnonzero(history["step/kind"] == 0)[-1])
    used = np.abs(steps[last]["shear_traction"]) / (-0.6 * steps[last]["normal_traction"])
    assert used.max() == pytest.approx(1 - 1e-6, abs=2e-8)
    first, where = events[0], ends[np.argmax(used.max(axis=1))]
    assert first["kind"] == "slip"
    assert np.min(np.linalg.norm(where - [first["x"], first["y"]], axis=1)) <= np.linalg.norm(where[1] - where[0])
