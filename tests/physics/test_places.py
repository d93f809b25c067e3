"""Wells and probes are where a scene puts them: a node for a well, interpolation for a probe."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.scene.scene import load
from fracflow.simulation.run import run

from .conftest import HELD, JOINT
from .test_books import CRACK, QUASI

SHARES = (0.137, 0.5, 0.861803)
START, END = np.array([0.0, 1.0]), np.array([3.0, 1.3])
CORNERS = np.array([[0, 0], [3, 0], [3, 2], [0, 2]])
RIGID = (
    HELD
    + JOINT
    + """
[[well]]
name = "in"
at = {fracture = "slot", end = "start"}
pressure = 3e4
[[well]]
name = "out"
at = {fracture = "slot", end = "end"}
pressure = 1e4
"""
)


def turned(degrees, mirrored):
    """The motion of a plane, of points (n, 2)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    flip = np.diag([1.0, -1.0 if mirrored else 1.0])
    return lambda points: np.asarray(points) @ (np.array([[c, -s], [s, c]]) @ flip).T


def channel(move, *wells):
    """The scene of a fracture through a block of rock, with probes at shares of its length."""
    domain = move(CORNERS).tolist()
    probes = "".join(
        f'[[probe]]\nname = "p{k}"\nat = {move(START + share * (END - START)).tolist()}\n'
        for k, share in enumerate(SHARES)
    )
    trace = f'[[geometry.fracture]]\nname = "slot"\npoints = {move([START, END]).tolist()}\n'
    return f"[geometry]\ndomain = {domain}\nsize = 0.7\n{trace}".join([RIGID, probes]) + "".join(wells)


@pytest.mark.parametrize(("degrees", "mirrored"), [(0, False), (0, True), (37, False), (37, True)])
def test_a_linear_pressure_is_exact_at_any_place(run_scene, degrees, mirrored):
    """Between two pressures kept at the ends: p(s) = p_in + (p_out - p_in) s/L, on any number of ranks."""
    found = run_scene(channel(turned(degrees, mirrored)))
    for k, share in enumerate(SHARES):
        assert found.probe(f"p{k}", "pressure")[-1] == pytest.approx(3e4 - 2e4 * share, rel=1e-10)


def test_a_probe_sees_either_wall_from_its_own_side(run_scene):
    """Off the nodes too: what the top wall moves beyond the bottom one is the slip and the opening there."""
    found = run_scene(CRACK + QUASI, "probe.middle.at=[1.0371, 1.259275]")
    along = np.array([4.0, 1.0]) / np.sqrt(17.0)
    jump = found.probe("middle", "displacement") - found.probe("middle", "displacement_bottom")
    opening, slip = found.probe("middle", "opening"), found.probe("middle", "slip")
    assert opening[-1] > 1e-6
    assert jump @ [-along[1], along[0]] == pytest.approx(opening, abs=1e-12 * opening[-1])
    assert jump @ along == pytest.approx(slip, abs=1e-12 * opening[-1])


def test_a_probe_off_its_fracture_is_at_the_nearest_point_of_it(run_scene):
    """At the foot of its perpendicular, whatever the nodes."""
    across = np.array([-0.3, 3.0]) / np.hypot(0.3, 3.0)
    place = START + 0.4 * (END - START) + 0.05 * across
    found = run_scene(channel(turned(0, False)), f"probe.p1.at={place.tolist()}", "probe.p1.on=slot")
    assert found.probe("p1", "pressure")[-1] == pytest.approx(3e4 - 2e4 * 0.4, rel=1e-10)


@pytest.mark.parametrize(
    "at",
    [
        (START + 0.317 * (END - START)).tolist(),
        '{fracture = "slot", fraction = 0.317}',
        f'{{fracture = "slot", at = "{317e-3 * np.hypot(3, 0.3)} m"}}',
    ],
)
@pytest.mark.parametrize("cells", ["triangles", "quads"])
def test_the_mesh_has_a_node_where_a_well_is(shared_tmp, at, cells):
    """However the place is given."""
    file, folder, comm = shared_tmp / "scene.toml", shared_tmp / "run", MPI.COMM_WORLD
    if comm.rank == 0:
        file.write_text(channel(turned(0, False), f'[[well]]\nname = "mid"\nat = {at}\nflow_rate = 1e-6\n'))
    comm.barrier()
    run(load(file, [f"geometry.cells={cells}"]), folder)
    if comm.rank == 0:
        mesh = load_mesh(folder / "mesh.h5")
        away = np.linalg.norm(mesh.points[mesh.flow_origin] - (START + 0.317 * (END - START)), axis=1)
        assert away.min() < 1e-14
        assert "well.mid sits" not in (folder / "log.txt").read_text()


def test_a_place_beyond_the_end_of_its_fracture_is_refused(shared_tmp):
    """With the length that it has."""
    file = shared_tmp / "scene.toml"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(channel(turned(0, False)))
    MPI.COMM_WORLD.barrier()
    with pytest.raises(
        InputError, match=r'well.in: at = 3.5 m: fracture "slot" is 3.01496 m long; give less, or a fraction'
    ):
        run(load(file, ['well.in.at={fracture = "slot", at = 3.5}']), shared_tmp / "run")
