"""S9: a rupture in explicit steps: how far the normal traction rings behind its front, and by how much slip is off.

By the damping of the cells at the fault, by the asymmetry of its walls (quadrilaterals of unlike heights above and below; the
other meshes are triangles), and by k_n h/E'. Predicted: no ringing on mirror images; damped cells keep it below a hundredth,
whatever k_n is; undamped, unlike walls ring.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, GREEN, INK, ORANGE, PALE, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.model.terms.fault_damping import ALIKE, AUTO, asymmetry
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import run

SCENE = """
output = {pictures = false}
method = {stepper = "explicit"}
rock.rock = {youngs_modulus = "80 GPa", poissons_ratio = 0.25, density = 2670}
initial_stress = {xx = "-120 MPa", yy = "-120 MPa", xy = "70 MPa", unbalanced = "carried"}
absorbing = [{on = ["west", "east", "south", "north"]}]
stage = [{kind = "dynamic", time_step = "10 ms", end = "3.6 s"}]
[fracture.main]
law = "slip-weakening"
normal_stiffness = "1000 GPa/m"
shear_stiffness = "1000 GPa/m"
aperture = "1 m"
friction_coefficient = 0.677
dynamic_friction_coefficient = 0.525
slip_weakening_distance = "0.4 m"
[fracture.main.initial_shear_traction]
along = ["0 km", "3.499 km", "3.501 km", "6.499 km", "6.501 km", "10 km"]
value = ["70 MPa", "70 MPa", "81.6 MPa", "81.6 MPa", "70 MPa", "70 MPa"]
"""
PLACES = (-2.5, 0.0, 2.5)  # km
TRIANGLES = """
[geometry]
domain = ["-8 km", "-4 km", "8 km", "4 km"]
size = "500 m"
size_at_fractures = "125 m"
growth = 0.3
[[geometry.fracture]]
name = "main"
points = [["-5 km", 0], ["5 km", 0]]
"""
GEO = """
h = 125;
For j In {{0:2}}
  Point(4*j + 1) = {{-8000, 4000*(j - 1), 0}}; Point(4*j + 2) = {{-5000, 4000*(j - 1), 0}};
  Point(4*j + 3) = {{5000, 4000*(j - 1), 0}}; Point(4*j + 4) = {{8000, 4000*(j - 1), 0}};
  For i In {{1:3}}
    Line(10*j + i) = {{4*j + i, 4*j + i + 1}};
    Transfinite Curve{{10*j + i}} = (i == 2 ? 80 : 24) + 1;
  EndFor
EndFor
For i In {{1:4}}
  Line(100 + i) = {{i, i + 4}}; Transfinite Curve{{100 + i}} = {below} + 1;
  Line(110 + i) = {{i + 4, i + 8}}; Transfinite Curve{{110 + i}} = {above} + 1;
EndFor
For i In {{1:3}}
  Curve Loop(i) = {{i, 101 + i, -(10 + i), -(100 + i)}}; Plane Surface(i) = {{i}};
  Curve Loop(10 + i) = {{10 + i, 111 + i, -(20 + i), -(110 + i)}}; Plane Surface(10 + i) = {{10 + i}};
EndFor
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {{1, 2, 3, 11, 12, 13}};
Physical Curve("main") = {{12}};
Physical Curve("south") = {{1, 2, 3}}; Physical Curve("north") = {{21, 22, 23}};
Physical Curve("west") = {{101, 111}}; Physical Curve("east") = {{104, 114}};
"""
LATER = 0.3  # s after the front, from when on the normal traction is judged
MODULUS = 80e9 / (1.0 - 0.25**2)
SIZE, STIFF = 125.0, 1e12
SLIP = 0.02  # of slip, at cells of this size
RINGS = 0.005  # rms of the normal traction over its value


def scene_of(folder: Path, mesh: str, settings: list[str]) -> Scene:
    """The scene on ``mesh``: triangles of the program, or quadrilaterals of a geometry."""
    if mesh != TRIANGLES:
        (folder / "fault.geo").write_text(mesh)
    probes = "".join(f'[[probe]]\nname = "{x:g}"\nat = ["{x:g} km", 0]\non = "main"\n' for x in PLACES)
    (folder / "scene.toml").write_text(
        SCENE + probes + (TRIANGLES if mesh == TRIANGLES else '[mesh]\nfile = "fault.geo"\n')
    )
    return load(folder / "scene.toml", settings)


def unlike(mesh: str) -> float:
    """The median of the program's own measure of asymmetry over the joints of a mesh."""
    with tempfile.TemporaryDirectory() as name:
        scene = scene_of(Path(name), mesh, [])
        return float(np.median(asymmetry(prepare(scene, MPI.COMM_SELF).operators.blocks, scene)))


@cache
def ruptured(mesh: str, *settings: str) -> tuple[float, float, Floats]:
    """A run: rms and largest deviation of the normal traction behind the front, over its value; final slips [length]."""
    with tempfile.TemporaryDirectory() as name:
        run(scene_of(Path(name), mesh, list(settings)), Path(name) / "run")
        found = read_history(Path(name) / "run" / "history.h5")
    off, slips = [], []
    for x in PLACES:
        slip = np.abs(found[f"probe/{x:g}/slip"]).ravel()
        behind = found["time"] > found["time"][np.argmax(slip > 1e-3)] + LATER
        off.append(found[f"probe/{x:g}/normal_traction"].ravel()[behind] / -120e6 - 1.0)
        slips.append(slip[-1])
    rms = max(float(np.sqrt(np.mean(each**2))) for each in off)
    return rms, max(float(np.abs(each).max()) for each in off), np.array(slips)


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s9`` into ``folder`` and return the bars."""
    brief = ["stage.0.end=2"] if small else []
    ratios = np.array([0.0, AUTO] if small else [0.0, 0.02, 0.05, 0.1, AUTO, 0.5])
    rows = np.array([32, 48] if small else [32, 34, 40, 48, 64])
    stiff = np.array([1e12] if small else [1e10, 1e11, 1e12, 1e13])
    quads = [GEO.format(below=32, above=above) for above in rows]
    alphas = np.array([unlike(mesh) for mesh in quads])
    none = "method.fault_damping=0"
    by_rows = [ruptured(mesh, none, *brief) for mesh in quads]
    by_rows_damped = [ruptured(mesh, *brief) for mesh in quads]
    right = by_rows[0][2]
    by_ratio = [ruptured(TRIANGLES, f"method.fault_damping={ratio}", *brief) for ratio in ratios.tolist()]
    by_stiffness = {
        damping: [
            ruptured(
                TRIANGLES,
                f"method.fault_damping={damping}",
                *(f"fracture.main.{part}_stiffness={each}" for part in ("normal", "shear")),
                *brief,
            )
            for each in stiff.tolist()
        ]
        for damping in (0.0, AUTO)
    }
    error = np.array([np.abs(slips / right - 1.0).max() for _, _, slips in by_ratio])
    ringing = np.array([rms for rms, _, _ in by_ratio])
    figure, axes = sheet(
        "S9  Explicit ruptures: where the normal traction rings behind the front",
        "A fault of 10 km, cells of 125 m, after the front by 0.3 s; dashed: the bar; dotted: what the program does of itself.",
        [["damping", "asymmetry", "stiffness"]], (10.2, 4.3),
    )  # fmt: skip
    _by_damping(axes["damping"], ratios, ringing, error)
    _line(axes["asymmetry"], alphas, by_rows, ORANGE, "undamped")
    _line(axes["asymmetry"], alphas, by_rows_damped, GREEN, "as the program does")
    axes["asymmetry"].set(xlabel="asymmetry of the walls (quadrilaterals)", title="By the asymmetry of the mesh")
    axes["asymmetry"].axvline(ALIKE, color=INK, ls=":")
    axes["asymmetry"].set_xscale("symlog", linthresh=1e-3)
    axes["asymmetry"].set_xlim(-2e-4, 0.5)
    numbers = stiff * SIZE / MODULUS
    _line(axes["stiffness"], numbers, by_stiffness[0.0], ORANGE, "undamped")
    _line(axes["stiffness"], numbers, by_stiffness[AUTO], GREEN, "as the program does")
    axes["stiffness"].set(xlabel="$k_n h/E'$ (triangles)", title="By the stiffness of joints", xscale="log")
    for axis in (axes["asymmetry"], axes["stiffness"]):
        axis.legend(loc="best")
    save(
        figure,
        folder,
        "s9",
        "Measured with fracflow's own explicit steps; slip against quadrilaterals that are mirror images.",
    )
    columns = {
        "fault_damping": ratios, "rms_over_value": ringing, "slip_error": error, "asymmetry": alphas,
        "rms_undamped": np.array([each[0] for each in by_rows]),
        "rms_as_it_does": np.array([each[0] for each in by_rows_damped]), "kn_h_over_E_prime": numbers,
        "rms_undamped_by_stiffness": np.array([each[0] for each in by_stiffness[0.0]]),
        "rms_damped_by_stiffness": np.array([each[0] for each in by_stiffness[AUTO]]),
    }  # fmt: skip
    write_csv(folder, "s9", columns, ["scripts/figures stability --only S9"])
    own = int(np.flatnonzero(ratios == AUTO)[0])
    worst = by_ratio[own][1]
    damped = max(each[0] for each in (*by_rows_damped, *by_stiffness[AUTO]))
    rings = min(each[0] for each in (*by_stiffness[0.0], by_ratio[0]))
    mirrored, bar, off = by_rows[0][0], f"<= {RINGS:g}", float(error[own])
    return [
        Check(
            "S9 triangles, rms of the normal traction over its value",
            float(ringing[own]),
            bar,
            bool(ringing[own] <= RINGS),
        ),
        Check("S9 triangles, largest deviation over its value", worst, "<= 0.015", worst <= 0.015),
        Check("S9 triangles, slip off that of mirror images", off, f"<= {SLIP:g}", off <= SLIP),
        Check("S9 undamped mirror images, rms", mirrored, "<= 1e-6", mirrored <= 1e-6),
        Check("S9 as the program does, largest rms of all", damped, bar, damped <= RINGS),
        Check("S9 undamped triangles ring whatever k_n is: least rms", rings, f"> {RINGS:g}", rings > RINGS),
    ]


def _by_damping(axis: Axes, ratios: Floats, ringing: Floats, error: Floats) -> None:
    axis.plot(ratios, ringing, "o-", color=BLUE, label="rms of the normal traction")
    axis.plot(ratios, error, "s-", color=ORANGE, label="error of slip")
    axis.axhline(RINGS, color=PALE, ls="--")
    axis.axvline(AUTO, color=INK, ls=":")
    axis.set(
        xlabel="fault_damping (triangles)", ylabel="over its value", yscale="log", title="By the damping of the cells"
    )
    axis.legend(loc="best")


def _line(axis: Axes, x: Floats, found: list[tuple[float, float, Floats]], colour: str, label: str) -> None:
    axis.plot(x, [max(rms, 1e-6) for rms, _, _ in found], "o-", color=colour, label=label)
    axis.axhline(RINGS, color=PALE, ls="--")
    axis.set(yscale="log", ylabel="rms of the normal traction over its value")
