"""The page of a run, opened in a real browser; of runs that lack parts, and of names that would break a page."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from chromium import Chromium
from resealed import changed_notes
from stopped_run import spoken, stop_half_way

import fracflow
from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.model import energy
from fracflow.model.terms.absorbing import AbsorbingSides
from fracflow.model.terms.fault_damping import FaultDamping
from fracflow.model.terms.leak_off import LeakOff
from fracflow.model.terms.tips import Tips
from fracflow.output import EventLog, FieldWriter, FractureNodes, HistoryFile
from fracflow.output.checkpoint import read_notes
from fracflow.output.drawing.axes import suited_unit
from fracflow.output.profiles import MOST, ProfileFile, Timetable, read_profiles
from fracflow.run_report import words, write_report
from fracflow.run_report.catalogue import events_of
from fracflow.run_report.data import RunReport, number, read_run, thinned
from fracflow.run_report.map import _traces, read_frames
from fracflow.simulation.run import resume, run

pytestmark = pytest.mark.serial

HOSTILE = "</script><script>document.title='taken'</script><img src=x onerror=document.title='taken'>"
SI = {"length": "m", "force": "N", "time": "s"}
DAYS = 86400.0
COUNT = 40  # states of a made-up run
LEAKY = """
geometry = {domain = "unbounded", fracture = [{name = "a", points = [[0, 0], [9, 9]]}]}
rock.rock = {youngs_modulus = "30 GPa", poissons_ratio = 0.25, density = 2700}
initial_stress = {xx = "-13 MPa", yy = "-25 MPa", zz = "-15 MPa"}
fluid.viscosity = "1 mPa s"
stage = [{kind = "quasi-static", time_step = "1 h", steps = 2}]
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.2 mm"
friction_angle_deg = 31
leak_off = {permeability = "1e-17 m^2", storage = "1e-11 1/Pa"}
[fracture.a]
law = "rate-and-state"
direct_effect = 0.010
evolution_effect = 0.014
characteristic_slip = "1 mm"
reference_slip_rate = 1e-6
initial_slip_rate = 1e-12
"""


@pytest.fixture(scope="module")
def browser():
    with Chromium() as found:
        yield found


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    return stop_half_way(tmp_path_factory.mktemp("stopped"))


def made_up(folder, fractures=6, events=30, states=COUNT, name="F"):
    """A run of days in a network of parallel traces of two joints, with a catalogue."""
    places = {f"probe {HOSTILE}": [10.0, 0.0]}
    attrs = {"title": f"Made up {HOSTILE}", "units": SI, "probes": places, "wells": {f"well {HOSTILE}": [0.0, 0.0]}}
    points = np.array(
        [[[0.0, 20.0 * i], [50.0, 20.0 * i], [50.0, 20.0 * i], [100.0, 20.0 * i]] for i in range(fractures)]
    )
    points = points.reshape(-1, 2)
    cells, names = np.arange(len(points)).reshape(-1, 2), [f"{name}{i}" for i in range(fractures)]
    times = np.linspace(0.0, 30.0, states) * DAYS
    with HistoryFile(folder / "history.h5", attrs) as history:
        for k, time in enumerate(times):
            row = {"time": time, "step/dt": DAYS, "step/kind": 1, "step/slipping": k % 3}
            row |= {
                "energy/friction": 1e6 * k,
                "energy/rock_strain": -1e6 * k,
                "energy/work_wells": 0.0,
                "energy/residual": 0.0,
            }
            row |= {f"probe/{name}/pressure": 1e7 + 1e5 * k for name in places}
            history.append(row)
    writer = FieldWriter(folder, "fractures", points, cells, {"fractures": names})
    profiles = ProfileFile(folder)
    rise = points[:, 0] / 100.0
    for k, time in enumerate(times):
        values = {
            "pressure": 1e7 + 1e5 * k * (1.0 - rise),
            "aperture": 1e-4 + 0.0 * rise,
            "plastic_slip": -1e-3 * k * rise,
        }
        if k == 0:
            writer.write(0, time, values, {"fracture": np.repeat(np.arange(fractures), 2)})
        profiles.append(time, k, values)
    profiles.close()
    nodes = FractureNodes([names[0]] * len(points), np.arange(len(points)), *points.T, [""] * len(points))
    log = EventLog(folder / "events.csv", nodes)
    dice = np.random.default_rng(1)
    keys = ("sections", "length", "mean_slip", "stress_drop", "radiated", "dissipated", "dropped", "unclosed", "slip")
    for k in range(events):
        row = dict.fromkeys(keys, 1.0) | {
            "place": k % len(points),
            "start": k * DAYS,
            "end": k * DAYS + 2.0,
            "injected": 10.0 * k,
        }
        size = float(dice.exponential(0.4))
        log.add(row | {"magnitude": size, "moment": 10 ** (1.5 * size + 9.05), "peak_slip_rate": 1.0})
    (folder / "scene.toml").write_text("no scene = [")
    return folder


def drawn(browser):
    """Marks of each chart by its name, and of each canvas how many colours it has."""
    charts = browser.value("Object.fromEntries([...document.querySelectorAll('.chart')].map(f =>"
                           " [f.dataset.chart || f.id, f.querySelectorAll('svg .mark').length]))")  # fmt: skip
    colours = "c => new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size"
    canvases = browser.value(f"[...document.querySelectorAll('canvas')].filter(c => c.clientWidth).map({colours})")
    return charts, canvases


def pixels(browser):
    return browser.value("document.querySelector('#chart-map canvas').toDataURL()")


def test_every_plot_is_there_and_the_slider_moves_the_map(tmp_path, browser):
    path, faults = write_report(made_up(tmp_path, name=f"F {HOSTILE} "))
    assert len(faults) == 1 and "scene.toml" in faults[0]
    browser.open(path)
    charts, canvases = drawn(browser)
    assert set(charts) == {
        "well-pressure", "profile", "probe-pressure", "magnitude-time", "gutenberg-richter", "distance-time", "energy",
        "step-length", "step-status",
    }  # fmt: skip
    assert all(charts.values()) and charts["magnitude-time"] == 30
    assert len(canvases) == 1 + 1 + 3 + 3 * 6 and min(canvases[:1] + canvases[2:]) > 3
    browser.value("document.querySelector('#slider').focus()")
    seen = {}
    for key in ("Home", "ArrowRight", "End"):
        browser.press(key)
        profile = browser.value("document.querySelector('#profile path').getAttribute('d')")
        seen[browser.value("document.querySelector('#now').textContent")] = (pixels(browser), profile)
    assert list(seen) == ["0 days", "0.769231 days", "30 days"]
    assert len({picture for picture, _ in seen.values()}) == len({line for _, line in seen.values()}) == 3
    browser.value(
        "const q = document.querySelector('#quantity'); q.value = 'pressure'; q.dispatchEvent(new Event('input'))"
    )
    assert pixels(browser) != seen["30 days"][0] and "pressure [MPa]" in browser.value("document.body.innerText")
    assert browser.value("document.title").startswith("Made up </script>")  # as text, which does not run
    assert not browser.value("document.querySelectorAll('img').length")
    assert browser.faults == []


def test_mcgarrs_bound_has_the_depth_of_the_moments(tmp_path):
    """Fluid fills flow_depth = 4 m, events are event_length = 100 m wide: G ΔV 100/4, G = 30/(2 (1 + 1/4)) GPa."""
    folder, charts = made_up(tmp_path), {}
    (folder / "scene.toml").write_text("""
output.event_length = 100
fluid = {viscosity = 1e-3, flow_depth = 4}
geometry = {domain = [0, 0, 9, 9], size = 3, fracture = [{name = "F0", points = [[1, 1], [5, 5]]}]}
rock.rock = {youngs_modulus = "30 GPa", poissons_ratio = 0.25}
fracture.default = {normal_stiffness = 1e9, shear_stiffness = 1e9, aperture = 1e-3, friction_coefficient = 0.6}
stage = [{kind = "steady", time_step = 1, steps = 1}]
""")
    events_of(read_run(folder), charts)
    chart = charts["moment-volume"]
    assert np.max(chart.series[-1].y) == pytest.approx(12e9 * 290.0 * 25.0)
    assert np.max(chart.series[-1].x) == pytest.approx(290.0) and "25 times the volume shown" in chart.note


def test_the_page_names_every_loss_and_the_laws_of_a_scene(tmp_path):
    entries = {term.entry for term in (AbsorbingSides, FaultDamping, LeakOff, Tips)} | {
        *energy.STORED,
        energy.CHANGE_OF_ROCK,
    }
    assert entries == {*words.STORED, *words.LOST}
    (tmp_path / "scene.toml").write_text(LEAKY)
    lines = " ".join(words.scene_in_words(RunReport(tmp_path, units=SI, scene=fracflow.load(tmp_path / "scene.toml"))))
    for part in (
        "friction 0.6009", "permeability 1×10⁻¹⁷ m² and storage 1×10⁻¹¹ m²/N", "evolution effect 0.014",
        "characteristic slip 1 mm", "slip radiates G/(2 c_s)",
    ):  # fmt: skip
        assert part in lines, part


@pytest.mark.parametrize("width", [320, 390])
def test_it_reads_on_a_phone(tmp_path, browser, width):
    browser.open(write_report(made_up(tmp_path, name="a fracture with quite a long name "))[0], width, 700)
    assert browser.value("document.documentElement.scrollWidth") <= width
    assert browser.value("document.querySelector('nav details').open") is False
    small = "[...document.querySelectorAll('p, li, td, svg text')].filter(e => e.offsetParent !== null || e.ownerSVGElement)"
    assert browser.value(f"Math.min(...{small}.map(e => parseFloat(getComputedStyle(e).fontSize)))") >= 12
    wide = browser.value(
        "Math.max(...[...document.querySelectorAll('svg, canvas')].map(e => e.getBoundingClientRect().right))"
    )
    assert wide <= width and browser.faults == []


def test_sixty_three_fractures_fit_below_5_mb_and_no_two_names_overlap(tmp_path, browser):
    """The names that the map writes, as rectangles of the pen's own measure."""
    path, _ = write_report(made_up(tmp_path, fractures=63, name="fracture "))
    assert path.stat().st_size < 5e6
    browser.open(path)
    browser.value("""(() => { window.names = []; const pen = CanvasRenderingContext2D.prototype, write = pen.fillText;
      pen.fillText = function (text, x, y) { const half = this.measureText(text).width / 2;
        names.push([x - half, y - 6, x + half, y + 6]); write.call(this, text, x, y); }; drawMap(); })()""")
    names = np.array(browser.value("names"))
    assert 10 < len(names) <= 64
    for i, one in enumerate(names):
        others = np.delete(names, i, axis=0)
        assert not ((others[:, :2] < one[2:]) & (one[:2] < others[:, 2:])).all(axis=1).any()
    shown = "[...document.querySelectorAll('.heat')].filter(h => h.checkVisibility()).length"
    assert browser.value(shown) == 3 * 9
    browser.value("document.querySelectorAll('#along details').forEach(d => { d.open = true; })")
    assert browser.value(shown) == 3 * 63 and browser.faults == []


def test_a_stopped_run_says_so_and_how_to_repeat_it(stopped, browser, tmp_path):
    path, faults = write_report(stopped, tmp_path / "page.html")
    assert faults == []
    browser.open(path)
    text = browser.value("document.body.innerText")
    assert "Stopped at 36 h. fracflow resume goes on." in text and "fracflow run scene.toml" in text
    assert "Young's modulus 50 GPa" in text and "law hyperbolic-coulomb" in text and "locked fractures" in text
    charts, _ = drawn(browser)
    assert {"onsets", "energy", "profile", "probe-pressure"} <= set(charts) and all(charts.values())
    browser.value("document.querySelectorAll('#repeat details').forEach(d => { d.open = true; })")
    kept = browser.value("document.querySelector('#repeat details pre').textContent")
    assert kept.splitlines() == (stopped / "scene.toml").read_text().splitlines()
    assert browser.faults == []


def test_a_run_under_way_has_a_page(stopped, tmp_path, browser):
    """Written by another process, as a person would, which needs no PETSc."""
    seen = []

    def progress(_):
        seen.append(None)
        if len(seen) == 4:
            code = "import sys; sys.modules['petsc4py'] = None; from fracflow.run_report import write_report;"
            code += f" path, faults = write_report({str(tmp_path / 'out')!r}); assert not faults, faults"
            subprocess.run([sys.executable, "-c", code], check=True)
            browser.open(tmp_path / "out" / "report.html")
            seen[-1] = browser.value("document.body.innerText"), drawn(browser)[0]

    run(fracflow.load(stopped / "scene.toml"), tmp_path / "out", progress=progress)
    text, charts = seen[3]
    assert "Under way, at 24 h so far." in text
    assert {"energy", "profile"} <= set(charts) and all(charts.values()) and browser.faults == []


@pytest.mark.parametrize(
    "lacking",
    [
        "events.csv",
        "plan.json",
        "mesh.h5",
        "profiles.h5",
        "history.h5",
        "fields/fractures_mesh.h5",
        "log.txt",
        "status.json",
    ],
)
def test_a_page_says_what_is_damaged_and_shows_the_rest(stopped, tmp_path, lacking):
    for kind in ("damaged", "missing"):
        folder = tmp_path / kind
        shutil.copytree(stopped, folder)
        if kind == "damaged":
            (folder / lacking).write_bytes(b"\xff\x00 no such thing")
        else:
            (folder / lacking).unlink()
        path, faults = write_report(folder)
        text = path.read_text()
        assert "Stage 1" in text and "<footer>" in text
        if kind == "damaged" and lacking != "status.json":
            name = lacking.rpartition("/")[2]
            assert [fault for fault in faults if name in fault] and name in re.sub("<[^>]*>", "", text)


def forged_plan(folder):
    (folder / "plan.json").write_text('{"decisions": [{"part": 3, "value": []}], "card": [{"name": null}]}')


def forged_places(folder):
    with h5py.File(folder / "history.h5", "r+") as file:
        del file["seal"], file.attrs["seal"]
        file.attrs["wells"] = '{"well": [0]}'


def forged_fractures(folder):
    for path in (folder / "fields").glob("fractures_0*.h5"):
        with h5py.File(path, "r+") as file:
            del file["seal"], file.attrs["seal"]
            file["cell/fracture"][...] = 10**9


@pytest.mark.parametrize(
    ("forge", "faults"),
    [(forged_plan, 0), (forged_places, 1), (forged_fractures, 1)],
    ids=lambda x: getattr(x, "__name__", ""),
)
def test_values_of_strangers_make_no_page_fail(stopped, tmp_path, forge, faults):
    shutil.copytree(stopped, tmp_path / "out")
    forge(tmp_path / "out")
    path, found = write_report(tmp_path / "out")
    assert len(found) == faults and "<footer>" in path.read_text()


def test_an_error_of_the_program_is_no_damage_of_a_file(stopped, monkeypatch):
    def broken(_):
        raise TypeError("a slip of ours")

    monkeypatch.setattr("fracflow.run_report.data.read_events", broken)
    with pytest.raises(TypeError, match="a slip of ours"):
        read_run(stopped)


@pytest.mark.parametrize("states", [0, 1])
def test_a_run_that_has_just_started_has_a_page(stopped, tmp_path, browser, states):
    (tmp_path / "out").mkdir()
    for name in ("scene.toml", "plan.json", "mesh.h5", ".fracflow"):
        (tmp_path / "out" / name).write_bytes((stopped / name).read_bytes())
    if states:
        with HistoryFile(tmp_path / "out" / "history.h5", {"units": SI}) as history:
            history.append({"time": 0.0, "energy/kinetic": 0.0, "step/dt": 0.0})
    path, faults = write_report(tmp_path / "out")
    browser.open(path)
    assert faults == [] and browser.faults == []
    assert ("No state is on record yet." in browser.value("document.body.innerText")) == (not states)


def test_the_command_names_its_page_and_refuses_other_folders(stopped, tmp_path, monkeypatch, capfd):
    assert spoken(["report", stopped, "-o", tmp_path / "page.html"], monkeypatch, capfd)[0] == 0
    assert (tmp_path / "page.html").stat().st_size > 1e4
    assert spoken(["report", tmp_path], monkeypatch, capfd) == (
        2,
        f"fracflow: {tmp_path}: holds no run of fracflow; name the folder of one",
    )
    assert spoken(["report", stopped, "-o", tmp_path / "no" / "page.html"], monkeypatch, capfd)[0] == 3
    (tmp_path / "elsewhere").write_text("mine")
    (stopped / "report.html").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=r"report\.html"):
        write_report(stopped)
    (stopped / "report.html").unlink()
    assert (tmp_path / "elsewhere").read_text() == "mine"


def test_profiles_are_those_of_the_states_and_survive_a_resume(stopped, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(stopped, folder)
    before = read_profiles(folder)
    mesh, history = load_mesh(folder / "mesh.h5"), fracflow.open(folder).history
    assert before["time"].tolist() == history["time"][before["step"]].tolist()
    assert before["pressure"].shape == (len(before["time"]), 2 * len(mesh.joint_bottom))
    assert np.abs(before["plastic_slip"]).max(axis=1).tolist()[0] == 0.0 < np.abs(before["plastic_slip"][-1]).max()
    resume(folder)
    run(fracflow.load(stopped / "scene.toml"), tmp_path / "whole")
    mine, whole = read_profiles(folder), read_profiles(tmp_path / "whole")
    assert mine.keys() == whole.keys() and all(np.array_equal(mine[key], whole[key]) for key in mine)


@pytest.mark.parametrize("lost", [False, True])
def test_a_checkpoint_without_profiles_is_resumed(stopped, tmp_path, lost):
    """That of an earlier version, which wrote none; and one whose profiles are lost: those of the states since begin anew."""
    folder = tmp_path / "out"
    shutil.copytree(stopped, folder)
    steps = len(fracflow.open(folder).history["time"])
    (folder / "profiles.h5").unlink()
    if not lost:
        with changed_notes(folder / "checkpoint.h5") as notes:
            del notes["totals"]["profiles"]
    resume(folder)
    mine, run = read_profiles(folder), read_run(folder)
    assert mine["step"][0] == steps and mine["time"].tolist() == run.times[mine["step"]].tolist()
    kept = read_notes(folder / "checkpoint.h5")["totals"]["profiles"]
    assert kept["rows"] == len(mine["time"])
    assert any("the profiles begin anew" in line for line in run.log) == lost
    assert write_report(folder)[1] == []


def test_profiles_are_few_and_even_in_time():
    table, kept = Timetable(), []
    for step in range(5000):
        if table.is_due(0.01 * step, 1):
            table.add(0.01 * step, 1)
            kept.append(0.01 * step)
    late = [time for time in kept if time > 25.0]
    assert MOST / 4 <= len(late) <= MOST and len(kept) < 5 * MOST
    assert np.diff(late).max() < 1.1
    assert table.is_due(50.0, 2) and not table.is_due(table.time, 1)  # where the regime changes; not twice at one time


def test_ends_of_pieces_are_put_in_the_order_of_their_trace():
    """Pieces in any order, of a bent trace and of one with a gap."""
    points = np.array([[1, 1], [2, 0], [0, 0], [1, 1], [9, 9], [9, 8], [5, 5], [6, 5.0]])
    cells = np.arange(8).reshape(-1, 2)
    rows, numbers, ends, along = _traces(points, cells, np.array([0, 0, 1, 1]), 2)
    assert ends == [slice(0, 3), slice(3, 7)]
    assert along[:3] == pytest.approx([0.0, 2**0.5, 2 * 2**0.5])
    assert rows[numbers < 4].tolist() == [1, 2, 0, 1]


def test_units_and_numbers_are_those_a_person_would_choose():
    shown = [(name, round(factor * size, 9)) for dimension, size in (
        ("time", 30 * DAYS), ("time", 3 * 3600.0), ("force/length**2", 17.3e6), ("length", 0.087), ("length", 2000.0),
        ("length**3/time", 1e-4)) for factor, name in [suited_unit(dimension, size, SI)]]  # fmt: skip
    assert shown == [("days", 30.0), ("h", 3.0), ("MPa", 17.3), ("mm", 87.0), ("m", 2000.0), ("L/s", 0.1)]
    assert suited_unit("length", 0.087, {"length": "ft", "force": "lbf", "time": "s"})[1] == "ft"
    texts = [number(value) for value in (1764.0, 0.25, -1.5, 1.2345678e-6, 2e10, 0.0, 99999.0)]
    assert texts == ["1764", "0.25", "−1.5", "1.235×10⁻⁶", "2×10¹⁰", "0", "1×10⁵"]


def test_a_thinned_line_keeps_its_peaks():
    x = np.linspace(0.0, 1.0, 100_000)
    y = np.sin(3.0 * x)
    y[54321] = 7.0
    found = thinned(x, y)
    assert (
        len(found[0]) < 1100
        and found[1].max() == 7.0
        and found[1].min() == y.min()
        and found[0][[0, -1]].tolist() == [0.0, 1.0]
    )
    assert thinned(np.array([0.0, np.nan, 1.0]), np.array([np.inf, 1.0, 2.0]))[1].tolist() == [2.0]


def test_the_data_of_a_page_are_the_fields_of_the_run(tmp_path):
    run = read_run(made_up(tmp_path))
    frames = read_frames(run)
    assert frames.times.tolist() == run.times.tolist() and len(frames.names) == 6
    assert frames.fields["plastic_slip"][-1, frames.ends[2]] == pytest.approx(
        [0.0, 0.5e-3 * (COUNT - 1), 1e-3 * (COUNT - 1)]
    )
    text = write_report(tmp_path)[0].read_text()
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])
    assert data["charts"]["probe-pressure"]["series"][0]["y"][-1] == pytest.approx(13.9)
