"""A row of the table of quantities is everywhere: in scenes, probes, fields, tables, pictures and the reference."""

from dataclasses import replace

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.laws import JOINT_LAWS
from fracflow.output.catalogue import Catalogue, FaultEnds, Instant
from fracflow.output.events import COLUMNS, EventLog, FractureNodes, columns_of, read_events
from fracflow.output.export import tables
from fracflow.output.fields import list_steps, read_step
from fracflow.output.history import read_history
from fracflow.output.pictures import _probes
from fracflow.output.reader import load_run_data
from fracflow.output.sampling import Columns
from fracflow.scene.quantities import QUANTITIES, OutputQuantity, component_names, magnitude, quantities
from fracflow.scene.scene import Scene, load
from fracflow.scene.schema import rows
from fracflow.scene.units import PLAIN, STRESS, VELOCITY
from fracflow.simulation.run import run

LAW = "slip-weakening"
SCENE = f"""
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
[fracture.default]
law = "{LAW}"
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.3
dynamic_friction_coefficient = 0.25
slip_weakening_distance = "1 cm"
[geometry]
domain = [0, 0, 4, 3]
size = 1.5
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 2]]
[initial_stress]
xx = -5e6
yy = -5e6
[[support]]
on = ["south", "east"]
[[support]]
on = ["north", "west"]
displacement = {{x = {{time = [0, 4], value = [0, 8e-3]}}, y = 0.0}}
[[probe]]
name = "crack"
at = [2, 1.5]
[[probe]]
name = "rock"
at = [2, 0.5]
quantities = ["speed", "mean_stress", "strain_energy_density"]
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 4
"""
ROWS = (
    OutputQuantity("speed", VELOCITY, "node", lambda at: magnitude(at.velocity), "size of the velocity"),
    OutputQuantity("mean_stress", STRESS, "cell", lambda at: at.stress[..., :3].mean(axis=-1), "a third of the trace"),
    OutputQuantity(
        "mobilised_friction",
        PLAIN,
        "section",
        lambda at: magnitude(at.sections.traction[..., :-1]) / -at.sections.traction[..., -1],
        "shear over normal traction",
    ),
)


@pytest.fixture
def more(monkeypatch):
    """Rows from outside, and a history variable that a law publishes."""
    for row in ROWS:
        monkeypatch.setitem(QUANTITIES, row.name, row)
    history = JOINT_LAWS[LAW].history
    monkeypatch.setitem(history, "slip_path", replace(history["slip_path"], published=True))


def test_rows_from_outside_are_everywhere(more, shared_tmp, comm):
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(SCENE, encoding="utf-8")
    comm.barrier()
    scene, out = load(shared_tmp / "scene.toml"), shared_tmp / "out"
    run(scene, out, comm)
    comm.barrier()
    history = read_history(out / "history.h5")
    on, inside = (
        {k[len(p) :]: v for k, v in history.items() if k.startswith(p)} for p in ("probe/crack/", "probe/rock/")
    )
    assert set(inside) == {"speed", "mean_stress", "strain_energy_density"}
    assert {"speed", "mobilised_friction", "slip_path", "slip"} <= set(on) and "mean_stress" not in on
    assert on["speed"] == pytest.approx(np.linalg.norm(on["velocity"], axis=1), rel=1e-12)
    assert inside["mean_stress"][-1] != 0.0 < inside["strain_energy_density"][-1]

    fractures, cells = (list_steps(out, family)[-1][1] for family in ("fractures", "rock"))
    joint = read_step(fractures)[1]
    assert joint["mobilised_friction"] == pytest.approx(np.abs(joint["shear_traction"]) / -joint["normal_traction"])
    assert joint["slip_path"] == pytest.approx(np.abs(joint["plastic_slip"])) and joint["slip_path"].max() > 1e-4
    assert on["slip_path"][-1] == pytest.approx(np.abs(on["plastic_slip"][-1]))
    _, points, cells = read_step(cells)
    assert points["speed"].shape == points["velocity"].shape[:1]
    assert cells["mean_stress"] == pytest.approx(np.trace(cells["stress"], axis1=1, axis2=2) / 3.0)

    heads = set(tables(out)["probe_crack"]) | set(tables(out)["probe_rock"])
    assert {"speed [m/s]", "mean_stress [N/m^2]", "mobilised_friction", "slip_path [m]", "slip [m]"} <= heads
    figure = _probes(load_run_data(out))
    labels = {axes.get_ylabel().partition(" [")[0] for axes in figure.axes}
    assert {"speed", "mean stress", "mobilised friction", "slip path", "slip"} <= labels
    reference = {key: values for key, values, _, meaning in rows(Scene.json_schema()) if meaning == ROWS[1].meaning}
    assert reference == {'probe[].quantities: "mean_stress"': f"[{STRESS}]"}


def test_a_place_without_the_quantity_is_named(more, shared_tmp, comm):
    if comm.rank == 0:
        text = SCENE.replace('["speed", "mean_stress", "strain_energy_density"]', '["slip_path"]')
        (shared_tmp / "scene.toml").write_text(text, encoding="utf-8")
    comm.barrier()
    with pytest.raises(InputError, match=r"probe\.rock\.quantities: slip_path: belongs to a fracture"):
        run(load(shared_tmp / "scene.toml"), shared_tmp / "out", comm)
    elastic = ["fracture.default={law='linear', normal_stiffness=5e10, shear_stiffness=2e10}", "probe.rock.on='crack'"]
    elastic += ["probe.rock.at={fracture='crack', end='end'}"]
    with pytest.raises(InputError, match="slip_path: the fracture crack there has a law without it"):
        run(load(shared_tmp / "scene.toml", elastic), shared_tmp / "out", comm)


@pytest.mark.serial
def test_a_name_that_is_no_row_is_refused(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    with pytest.raises(InputError, match=r'probe.rock.quantities.0 = "speed": unknown; allowed: "displacement"'):
        load(tmp_path / "scene.toml")


@pytest.mark.serial
def test_rows_have_a_dimension_and_a_meaning():
    for row in quantities().values():
        assert row.meaning and set(row.dimension.replace("**", "*").replace("/", "*").split("*")) <= {
            "1", "2", "3", "5", "length", "force", "time",
        }, row.name  # fmt: skip


@pytest.mark.serial
def test_slip_has_a_component_in_a_plane_and_two_in_space():
    for dim, names in ((2, ["slip"]), (3, ["slip_1", "slip_2"])):
        columns = Columns(("opening", "slip"), dim)
        table = np.arange(4.0 * columns.width).reshape(2, 2, columns.width)
        assert component_names("slip", "shear", dim - 1) == names
        assert columns.of(table, "opening").shape == (2, 2) and columns.of(table, "slip").shape == (2, 2, dim - 1)
        assert np.array_equal(columns.of(table, "slip"), table[..., 1:])


@pytest.mark.serial
def test_events_in_space_have_two_components_of_slip(tmp_path):
    nodes = FractureNodes(["A"], np.array([7]), np.zeros(1), np.zeros(1), [""])
    log, yes, no = EventLog(tmp_path / "events.csv", nodes, tangents=2), np.array([True]), np.array([False])
    log.update(1.0, yes, no, np.array([[1.0, 1.0]]), np.array([[3.0, -4.0]]))
    again = EventLog(tmp_path / "events.csv", nodes, tangents=2)
    again.remember(log.memory())
    again.update(2.0, no, no, np.array([[4.0, 3.0]]), np.zeros((1, 2)))
    (row,) = read_events(again.path)
    assert (row["slip_1"], row["slip_2"], row["peak_slip_rate"]) == (4.0, 3.0, 5.0)
    assert columns_of(1) == COLUMNS and len(columns_of(2)) == len(COLUMNS) + 1


@pytest.mark.serial
def test_a_catalogue_in_space_takes_the_stress_drop_along_the_slip():
    books = dict.fromkeys(("friction", "radiated", "dropped", "residual"), 0.0)
    ends = FaultEnds(np.array([0, 1]), np.array([1.0, 1.0]), np.full(2, 3e10))
    log, still = Catalogue(ends), np.zeros((2, 2))

    def at(time, slip, traction, slides):
        return Instant(time, np.array(slip), np.array(traction), still, np.array([slides, False]), books, 0.0)

    log.update(at(0.0, still, [[5.0, 5.0], [5.0, 5.0]], False), False)
    log.update(at(1.0, [[0.3, 0.4], [0.0, 0.0]], [[2.0, 1.0], [9.0, 9.0]], True), True)
    row = log.update(at(2.0, [[0.3, 0.4], [0.0, 0.0]], [[2.0, 1.0], [9.0, 9.0]], False), False)
    assert (row["slip_1"], row["slip_2"], row["sections"]) == (0.3, 0.4, 1)
    assert row["mean_slip"] == pytest.approx(0.5) and row["stress_drop"] == pytest.approx((3 * 0.3 + 4 * 0.4) / 0.5)
