"""The rupture of meshes/rupture on triangles, against quadrilaterals that mirror themselves in the fault: rupture_triangles.py.

--sizes H... of the triangles at the fault [m], falling; --reference H of the quadrilaterals; --growth G of triangles from the
fault, at 100 m; --keep-growth keeps it at all sizes, and is no uniform refinement; --ratio for method.fault_damping; --out DIR.

Prints, for each size, the error of the final slip at seven places, its order, how far the normal traction is off from 0.3 s
after the front on, how well the books close, and CPU seconds. Exit code 1 where a bar is missed: slip within 2 % of 100 m, and
as the size; normal traction within 1 % rms and 3 % at worst; order 1.4 in the last refinement; books 1e-10. Scenes, and runs
that can be looked at, stay in the folder; runs that are there are read, and not repeated. Quadrilaterals of 25 m are off too,
and those of 50 m from them by 0.09 %, so that error and order at triangles of 25 m are rough. All sizes take 8 CPU minutes.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from sheets import Check, judge

Floats = NDArray[np.float64]

SCENE = Path(__file__).parents[2] / "meshes" / "rupture"
PLACES = (-12.0, -7.5, -4.5, 0.0, 4.5, 7.5, 12.0)  # km
FAR = 6  # times the size at the fault, as the quadrilaterals at the sides of the box
GROWTH, AT = 0.1, 100.0  # of sizes per length, and the size at the fault that has it [m]
TIME_STEP = "8 ms"  # taken in parts that are stable
NORMAL, SLIPS, LATER = -120e6, 1e-3, 0.3  # normal traction [Pa]; slip behind the front [m], judged so much later [s]
SLIP_BAR, RMS_BAR, WORST_BAR, ORDER_BAR, BOOKS_BAR = 0.02, 0.01, 0.03, 1.4, 1e-10


@dataclass(frozen=True)
class Found:
    """The result of a run: final slips (7,) [m], error of the normal traction (rms, largest), energy balance, CPU seconds."""

    slips: Floats
    rms: float
    worst: float
    books: float
    seconds: float


def write_scene(folder: Path, mesh: str) -> Path:
    """The scene of meshes/rupture with probes at the seven places and another mesh."""
    tables = re.split(r"(?m)^(?=\[)", (SCENE / "scene.toml").read_text(encoding="utf-8"))
    kept = "".join(table for table in tables if not table.startswith(("[[probe]]", "[mesh]")))
    probes = "".join(f'[[probe]]\nname = "{x:g}"\nat = ["{x:g} km", 0]\non = "fault"\n' for x in PLACES)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.toml").write_text(f"{kept}\n{probes}{mesh}", encoding="utf-8")
    return folder / "scene.toml"


def quadrilaterals(folder: Path, size: float) -> Path:
    """The scene on quadrilaterals of that size along the fault."""
    scene = write_scene(folder, '[mesh]\nfile = "fault.geo"\n')
    geometry = (SCENE / "fault.geo").read_text(encoding="utf-8")
    (folder / "fault.geo").write_text(geometry.replace("h = 100;", f"h = {size:g};"), encoding="utf-8")
    return scene


def triangles(folder: Path, size: float, growth: float) -> Path:
    """The scene on triangles of that size along the fault, FAR times as large from some distance on."""
    return write_scene(
        folder,
        f'[geometry]\ndomain = ["-20 km", "-12 km", "20 km", "12 km"]\nsize = {FAR * size:g}\nsize_at_fractures = {size:g}\n'
        f'growth = {growth:g}\n[[geometry.fracture]]\nname = "fault"\npoints = [["-15 km", 0], ["15 km", 0]]\n',
    )


def measure(scene: Path, *settings: str) -> Found:
    """Run, unless that is done, and read."""
    import fracflow

    folder, cost = scene.parent / "run", scene.parent / "cost.txt"
    given = ["method.stepper=explicit", f"stage.0.time_step={TIME_STEP}", "output.pictures=false", *settings]
    if not cost.exists():
        command = [sys.executable, "-m", "fracflow", "run", str(scene), "-o", str(folder)]
        before = os.times()
        with (scene.parent / "said.txt").open("w", encoding="utf-8") as said:
            subprocess.run([*command, *(f"--set={each}" for each in given)], check=True, stdout=said)
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        cost.write_text(f"{spent:.2f}\n", encoding="utf-8")
    history = fracflow.open(folder).history
    time, slips, off = history["time"], [], []
    for x in PLACES:
        slip = np.abs(history[f"probe/{x:g}/slip"]).ravel()
        behind = time > time[np.argmax(slip > SLIPS)] + LATER
        slips.append(slip[-1])
        off.append(history[f"probe/{x:g}/normal_traction"].ravel()[behind] / NORMAL - 1.0)
    largest = max(np.abs(values).max() for key, values in history.items() if key.startswith("energy/"))
    return Found(
        np.array(slips), max(float(np.sqrt(np.mean(each**2))) for each in off),
        max(float(np.abs(each).max()) for each in off),
        float(np.abs(history["energy/residual"]).max() / largest), float(cost.read_text(encoding="utf-8")),
    )  # fmt: skip


def checks(sizes: list[float], found: list[Found], right: Floats, orders: list[float]) -> list[Check]:
    """The bars."""
    result = []
    for size, each in zip(sizes, found, strict=True):
        bars = {
            "largest error of slip": (float(np.abs(each.slips / right - 1.0).max()), SLIP_BAR * size / AT),
            "normal traction, rms": (each.rms, RMS_BAR),
            "normal traction, worst": (each.worst, WORST_BAR),
            "books": (each.books, BOOKS_BAR),
        }
        result += [
            Check(f"{size:g} m, {name}", value, f"<= {bar:.3g}", value <= bar) for name, (value, bar) in bars.items()
        ]
    if orders:
        result.append(Check("order of slip, last", orders[-1], f">= {ORDER_BAR:g}", orders[-1] >= ORDER_BAR))
    return result


def main() -> int:
    """Measure, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", type=float, default=[200.0, 100.0, 50.0, 25.0])
    parser.add_argument("--reference", type=float, default=25.0)
    parser.add_argument("--growth", type=float, default=GROWTH)
    parser.add_argument("--keep-growth", action="store_true")
    parser.add_argument("--ratio", default="auto")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/rupture_triangles"))
    given = parser.parse_args()
    sizes, damping = sorted(given.sizes, reverse=True), f"method.fault_damping={given.ratio}"
    reference = measure(quadrilaterals(given.out / f"quadrilaterals-{given.reference:g}", given.reference))
    print(f"quadrilaterals of {given.reference:g} m: {reference.seconds:.0f} CPU s, books {reference.books:.1e}")
    print(f"size [m], growth, error of slip at {', '.join(f'{x:g}' for x in PLACES)} km [%], rms [%], order,"
          " normal traction rms [%], worst [%], books, CPU s")  # fmt: skip
    found, errors, orders = [], [], []
    for size in sizes:
        growth = given.growth * (1.0 if given.keep_growth else size / AT)
        scene = triangles(given.out / f"triangles-{size:g}-{growth:g}-{given.ratio}", size, growth)
        found.append(measure(scene, damping))
        off = found[-1].slips / reference.slips - 1.0
        errors.append(float(np.sqrt(np.mean(off**2))))
        if len(errors) > 1:
            orders.append(float(np.log(errors[-2] / errors[-1]) / np.log(sizes[len(errors) - 2] / size)))
        print(
            f"{size:g}, {growth:g}, {' '.join(f'{100 * each:.2f}' for each in off)}, {100 * errors[-1]:.3f},"
            f" {f'{orders[-1]:.2f}' if orders else '-'}, {100 * found[-1].rms:.2f}, {100 * found[-1].worst:.2f},"
            f" {found[-1].books:.0e}, {found[-1].seconds:.0f}", flush=True,
        )  # fmt: skip
    return judge(checks(sizes, found, reference.slips, orders), given.out)


if __name__ == "__main__":
    sys.exit(main())
