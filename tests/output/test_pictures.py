from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from fracflow.errors import InputError
from fracflow.output import EventLog, FieldWriter, FractureNodes, HistoryFile
from fracflow.output.pictures import _draw_probes, _draw_profiles, _overview, _probes, _wells, draw
from fracflow.output.plot_style import styled
from fracflow.output.reader import FractureFields, load_run_data
from fracflow.scene.quantities import QUANTITIES

pytestmark = pytest.mark.serial

STEPS, STEADY, END = 240, 12, 0.02


def lattice(n: int, size: float):
    x, y = np.meshgrid(np.linspace(0, size, n + 1), np.linspace(0, size, n + 1))
    i = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
    return np.stack([x.ravel(), y.ravel()], axis=1), np.stack([i, i + 1, i + n + 2, i + n + 1], axis=1)


def network(pieces: int):
    ends = {"A": ((10, 20), (90, 70)), "B": ((50, 0), (50, 100)), "C": ((15, 80), (75, 55))}
    along = np.linspace(0, 1, pieces + 1)[:, None]
    points = np.concatenate([(1 - along) * np.array(a) + along * np.array(b) for a, b in ends.values()])
    first = np.arange(pieces)
    cells = np.concatenate([np.stack([first, first + 1], 1) + k * (pieces + 1) for k in range(len(ends))])
    return list(ends), points, cells, np.repeat(np.arange(len(ends)), pieces)


def make_run(folder, steps=STEPS, fluid=True, probes=True, fields=True, events=True, dynamic=True):
    """A made-up run of the shape of problem 5.5: a steady climb, then slip."""
    names, points, cells, fracture = network(20)
    places = {"node1": [38.0, 37.5], "node2": [50.0, 30.0], "node3": [45.0, 67.5]} if probes else {}
    attrs = {
        "title": "Slip in a network of three fractures",
        "units": {"length": "ft", "force": "lbf", "time": "s"},
        "probes": places,
        "wells": {"injection": [10, 20], "producer": [50, 100]},
    }
    t = np.concatenate([np.zeros(STEADY), np.linspace(0, END, STEPS - STEADY)])[:steps]
    grow = np.clip(t / END, 0, 1)
    with HistoryFile(folder / "history.h5", attrs) as history:
        for i, (time, g) in enumerate(zip(t, grow, strict=True)):
            kinetic = 40 * g * np.exp(-6 * g)
            row = {"time": time, "step/kind": 2 if dynamic and i >= STEADY else 0, "energy/kinetic": kinetic}
            row |= {"energy/friction": 12 * (1 - np.exp(-5 * g)), "energy/viscous": 0.0}
            row |= {"energy/rock_strain": 900 - 18 * g, "energy/joint_shear": 30 - 8 * g}
            for k, name in enumerate(places):
                slip = 1e-3 * (k + 1) * (1 - np.exp(-(4 + k) * g)) * (1 if k != 1 else 0.66)
                row |= {f"probe/{name}/slip": slip, f"probe/{name}/displacement": [slip, -0.4 * slip]}
                row |= {f"probe/{name}/slip_rate": slip * 50, f"probe/{name}/opening": -1e-4 * g}
                if fluid:
                    row[f"probe/{name}/pressure"] = 2e4 - k * 3e3 * g
            history.append(row)
    if fields:
        rock = FieldWriter(folder, "rock", *lattice(20, 100.0))
        writer = FieldWriter(folder, "fractures", points, cells, {"fractures": names})
        s = np.tile(np.linspace(0, 1, 21), 3)
        for index, time, slip in ((0, 0.0, 0.0), (STEADY, 0.0, 0.0), (STEPS, END, 1e-3)):
            beside = 0.3 * np.clip(np.sin(2 * np.pi * s), 0, 1)
            shape = np.where(np.arange(63) < 21, np.sin(np.pi * s), beside)
            data = {"plastic_slip": -slip * shape, "slip": -slip * shape}
            if fluid:
                data["pressure"] = 2e4 + 1e4 * (1 - s) * (1 if slip == 0 else 0.6 + s)
            rock.write(index, time, {"displacement": np.zeros((441, 2))})
            writer.write(index, time, data, {"fracture": fracture})
    if events:
        nodes = FractureNodes([names[0]] * 63, np.arange(63), *points.T, [""] * 63)
        log = EventLog(folder / "events.csv", nodes)
        sliding = np.arange(63) == 10
        log.update(0.001, sliding, ~sliding & False, 1e-3 * sliding, 1.0 * sliding)
    return folder


def is_drawn(path):
    image = imread(path)[..., :3]
    return image.shape[0] > 400 and image.shape[1] > 1000 and image.std() > 0.02


def test_a_full_run_is_drawn(tmp_path):
    paths = draw(make_run(tmp_path))
    assert [path.name for path in paths] == ["overview.png", "probes.png"]
    assert all(is_drawn(path) for path in paths)


@pytest.mark.parametrize(
    "lacking",
    [
        {"fluid": False},
        {"probes": False},
        {"fields": False},
        {"events": False, "dynamic": False},
        {"steps": 1},
        {"steps": STEADY, "dynamic": False},
        {"fluid": False, "probes": False, "fields": False, "events": False},
    ],
    ids=str,
)
def test_a_run_that_lacks_parts_is_drawn(tmp_path, lacking):
    paths = draw(make_run(tmp_path, **lacking))
    assert len(paths) == (1 if lacking.get("probes") is False else 2)
    assert all(is_drawn(path) for path in paths)


def test_a_vector_that_turns_is_drawn_without_jumps(tmp_path):
    """Along (3, -4), the largest, with the sign of the component that is 4 there."""
    data = load_run_data(make_run(tmp_path))
    turning = {"probe/turning/displacement": np.array([[0.0, 0.0], [2.0, 1.5], [3.0, -4.0], [-1.5, 2.0], [0.4, 0.3]])}
    found = replace(data, history={**data.history, **turning}).probe("turning", "displacement")
    assert found == pytest.approx([0.0, 0.0, -5.0, 2.5, 0.0], abs=1e-14)


def test_histories_of_wells_are_drawn(tmp_path):
    data = load_run_data(make_run(tmp_path))
    grows = np.linspace(0.0, 1.0, STEPS)
    wells = {"well/a/b $/rate": 5e-3 * grows, "well/a/b $/pressure": 2e4 + grows, "well/out/pressure": 0.0 * grows}
    with styled():
        figure = _wells(replace(data, history={**data.history, **wells}))
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["Pressure", "Rate"]
    assert [len(axes.lines) for axes in figure.axes] == [2, 1]
    assert _wells(data) is None


def test_a_moment_of_motion_after_days_is_drawn_over_steps(tmp_path):
    """Over time it would be one line: 120 of 239 steps take 120/227 of 20 ms. Rates of wells are drawn over time."""
    data = load_run_data(make_run(tmp_path))
    late = data.history["time"] + np.where(np.arange(STEPS) < STEADY, np.linspace(-2e5, 0.0, STEPS), 0.0)
    found = replace(data, history={**data.history, "time": late}, units={"time": "s"})
    assert data.abscissa(data.settled).label == data.times(data.settled).label
    assert found.abscissa(slice(None)).label == "step (half of them within 10.6 ms of 2.31 days)"
    assert list(found.abscissa(slice(2, None)).values[:3]) == [2.0, 3.0, 4.0]
    assert found.times(slice(None)).label == "time [days]"
    assert replace(found, has_dynamics=False).abscissa(slice(None)).label == "time [days]"


def test_an_axis_shows_neither_noise_nor_offsets(tmp_path):
    """Round-off is drawn flat with its value; a small change of a large value from a round number."""
    data = load_run_data(make_run(tmp_path))
    noise = 2e4 * (1.0 + 1e-15 * np.sin(np.arange(STEPS)))
    quiet = {f"probe/{name}/pressure": noise for name in data.probes}
    with styled():
        figure = _probes(replace(data, history={**data.history, **quiet}))
    (axes,) = (axes for axes in figure.axes if axes.get_title(loc="left").startswith("Pressure"))
    assert axes.get_title(loc="left") == "Pressure: constant"
    assert all(np.ptp(line.get_ydata()) == 0.0 for line in axes.lines)
    assert "node1, node2,\nnode3: 20 10³ lbf/ft²" in [text.get_text() for text in axes.texts]
    figure.draw_without_rendering()
    assert not any(axis.get_offset_text().get_text() for axes in figure.axes for axis in (axes.xaxis, axes.yaxis))


def test_a_panel_shows_what_changes(tmp_path):
    """Where nothing slips: openings, and a map of pressure; where the domain is a strip, it is as wide as the figure."""
    data = load_run_data(make_run(tmp_path))
    still = {f"probe/{name}/slip": np.zeros(STEPS) for name in data.probes}
    grow = {f"probe/{name}/opening": np.linspace(0.0, 1e-3, STEPS) for name in data.probes}
    fields = replace(data.fractures, after={**data.fractures.after, "plastic_slip": np.zeros(63)})
    quiet = replace(data, history={**data.history, **still, **grow}, fractures=fields, wells={}, probes={})
    flat = np.array([1.0, 0.02])
    strip = replace(
        quiet, rock=[cell * flat for cell in data.rock], fractures=replace(fields, points=fields.points * flat)
    )
    with styled():
        figures = [_overview(replace(each, events=[])) for each in (quiet, strip)]
    titles = [{axes.get_title(loc="left"): axes for axes in figure.axes} for figure in figures]
    for found in titles:
        assert "Opening at the probes" in found and "Pressure at 20 ms: no fracture had slipped" in found
    wide, thin = (found["Pressure at 20 ms: no fracture had slipped"] for found in titles)
    assert wide.get_ylabel() == "y [ft]" and thin.get_ylabel() == "y [ft]\nstretched ×5"
    assert thin.bbox.width > 0.8 * figures[1].bbox.width and wide.bbox.width < 0.6 * figures[0].bbox.width


def test_walls_that_rest_on_each_other_show_their_pressure_before_their_displacement(tmp_path):
    """Its long label is broken, so that it stays beside its panel."""
    data = load_run_data(make_run(tmp_path))
    still = {f"probe/{name}/{each}": np.zeros(STEPS) for name in data.probes for each in ("slip", "opening")}
    flat = {f"probe/{name}/pressure": np.full(STEPS, 2e4) for name in data.probes}
    bare = replace(data, fractures=None)
    for run, history, titles in (
        (data, still, ["Pressure at the probes", "Energy", "Pressure along fractures"]),
        (bare, still, ["Pressure at the probes", "Energy", "Normal traction at the probes"]),
        (data, still | flat, ["Displacement along its main", "Energy", "Pressure along fractures"]),
    ):
        with styled():
            figure = _overview(replace(run, history={**data.history, **history}, events=[]))
        panels = figure.axes[:3]
        for axes, title in zip(panels, titles, strict=True):
            assert axes.get_title(loc="left").startswith(title)
    top = panels[0]
    head = min(text.get_window_extent().y0 for text in figure.findobj(Text) if text.get_text().startswith(data.title))
    assert top.yaxis.label.get_window_extent().y1 < head


def test_the_mesh_of_an_event_is_shown_near_the_fractures(tmp_path):
    """All fractures and marks, with a quarter of their extent around them, and no rock far away; meshed rock is shown whole."""
    data = load_run_data(make_run(tmp_path))
    far = [(cell - 50.0) * 10.0 for cell in data.rock]
    near = replace(data.fractures, points=np.clip(data.fractures.points, 10.0, 90.0))
    unmeshed = {**data.history, "energy/change_of_rock": np.zeros(STEPS)}
    runs = [replace(data, rock=far, fractures=near, history=each, wells={}) for each in (data.history, unmeshed)]
    assert data.is_meshed
    runs[1] = replace(runs[1], is_meshed=False)
    with styled():
        shown = [_overview(run).axes[-2] for run in runs]
    edges, faces = (axes.collections[0].get_edgecolor() for axes in shown)
    assert not np.array_equal(edges[0], shown[0].collections[0].get_facecolor()[0]), "a mesh"
    assert np.array_equal(faces[0], shown[1].collections[0].get_facecolor()[0]), "no mesh, no grid"
    whole, zoomed = (np.array([*axes.get_xlim(), *axes.get_ylim()]) for axes in shown)
    assert whole == pytest.approx([-530.0, 530.0, -530.0, 530.0])
    assert zoomed == pytest.approx([-10.0, 110.0, -10.0, 110.0])


@pytest.mark.parametrize("panel", ["profiles", "probes"])
def test_a_long_title_goes_on_below(tmp_path, panel):
    data = load_run_data(make_run(tmp_path))
    with styled():
        figure = Figure(figsize=(3.0, 3.0), layout="constrained")
        axes = figure.subplots()
        if panel == "profiles":
            _draw_profiles(axes, data, QUANTITIES["pressure"])
        else:
            _draw_probes(axes, data, QUANTITIES["displacement"], "Displacement along its main direction at the probes")
        figure.draw_without_rendering()
        (title,) = (
            text for text in axes.findobj(Text) if text.get_text() and text.get_text() == axes.get_title(loc="left")
        )
        assert title.get_window_extent().x1 <= figure.bbox.x1


def test_an_empty_folder_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match=r"history\.h5"):
        draw(tmp_path)


def test_rates_over_three_decades_have_a_logarithmic_axis():
    from fracflow.output.pictures import _spans_decades

    assert _spans_decades([np.array([1e-9, np.nan, 2e-6])]) and _spans_decades([np.array([1e-9]), np.array([2e-6])])
    assert not _spans_decades([np.array([1e-9, 5e-7])]) and not _spans_decades([np.array([0.0, 1e-9, 2e-6])])


def test_of_many_fractures_those_where_a_field_changes_are_drawn():
    """Ten fractures, longer and longer; the shortest has the largest change, and most have no slip."""
    ends = np.array([[[0.0, k], [1.0 + k, k]] for k in range(10)])
    pressure, slip = np.full((2, 20), 5.0), np.zeros(20)
    pressure[1, :2], pressure[1, 6:8], slip[2:4] = 9.0, 5.5, 1e-3
    before, after = ({"pressure": each, "plastic_slip": slip} for each in pressure)
    fields = FractureFields(
        ends.reshape(-1, 2), np.arange(20).reshape(-1, 2), np.arange(10), list("abcdefghij"), before, after, 0.0, 1.0, 1
    )
    assert list(fields.profiles("pressure", 7)) == ["a", "d"]
    assert list(fields.profiles("plastic_slip", 7, by_size=True)) == ["b"]
    assert len(fields.profiles("plastic_slip", 7)) == 7 and len(fields.profiles("pressure", 12)) == 10
