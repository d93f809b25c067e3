"""Events in rock that is meshed once they need it, against a mesh from the start: event_mesh.py [MARGIN...] [--joints].

Pressure lets a fault of 100 m go that weakens with slip. Both runs have absorbing sides, MARGIN metres away, and cells
of 12.5 m there. Prints for each margin the differences of slip and moment, CPU seconds of both runs, and those that
``fracflow check`` foresees for the event. Exit code 1 where a difference is above 2 %. The defaults take 80 CPU s.
With ``--joints``: an event at once, and what the log says of the stress that it leaves frozen, by joints and tips; 30 CPU s.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fracflow._petsc import MPI
from fracflow.api import run
from fracflow.cli.check import price_of_events
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene

MOST = 0.02  # of slip and moment
FAULT = {
    "law": "slip-weakening", "friction_coefficient": 0.6, "dynamic_friction_coefficient": 0.5,
    "slip_weakening_distance": 2e-3, "normal_stiffness": 50e9, "shear_stiffness": 20e9, "aperture": 2e-4,
    "pressure": [[0, 0], [1000, 4e6]],
}  # fmt: skip


def scene(margin: float, is_meshed: bool) -> Scene:
    """The fault in rock that is meshed from the start, or once its event needs that."""
    domain = [-50.0 - margin, -margin, 50.0 + margin, margin] if is_meshed else "unbounded"
    sides: dict[str, Any] = {"absorbing": [{"on": ["west", "east", "south", "north"]}], "model": "full"}
    return Scene.from_data(
        {
            "geometry": {
                "domain": domain, "size": 12.5, "size_at_fractures": 5.0, "growth": 0.3,
                "fracture": [{"name": "fault", "points": [[-50.0, 0.0], [50.0, 0.0]]}],
                **({} if is_meshed else {"event_margin": margin}),
            },
            "rock": {"rock": {"youngs_modulus": 30e9, "poissons_ratio": 0.25, "density": 2700.0}},
            "initial_stress": {"xx": -20e6, "yy": -20e6, "zz": -20e6, "xy": 11e6},
            "fluid": {"viscosity": 1e-3, "initial_pressure": 0.0},
            "fracture": {"fault": FAULT},
            "method": {"stepper": "generalised-alpha", "rho_infinity": 0.8, "events": "at-step-ends", "tips": "corrected"},
            "output": {"pictures": False, "event_length": 1.0},
            "stage": [{"kind": "auto", "time_step": 50.0, "end": 600.0, "dynamic_time_step": 1e-3, "at_rest": 0.1}],
            **(sides if is_meshed else {}),
        }
    )  # fmt: skip


def frozen(size: float, tips: str, folder: Path) -> list[str]:
    """Slip and moment of an event whose strength drops at once, and lines on what it leaves frozen, with joints of a size."""
    data = scene(200.0, False).model_dump(exclude_unset=True)
    data["geometry"]["size_at_fractures"], data["geometry"]["size"] = size, 25.0
    data["method"] |= {"tips": tips, "rho_infinity": 0.6}
    laws = ("law", "dynamic_friction_coefficient", "slip_weakening_distance")
    data["fracture"] = {"fault": {k: v for k, v in FAULT.items() if k not in laws} | {"stick_slip_ratio": 0.9}}
    data["stage"] = [{"kind": "auto", "time_step": 10.0, "end": 421.0, "dynamic_time_step": 3e-3, "at_rest": 0.1}]
    where = folder / f"{size:g}-{tips}"
    (found,) = (row for row in run(Scene.from_data(data), where).events if row["kind"] == "event")
    size_of_it = f"slip {1e3 * found['slip']:.2f} mm, moment {1e-9 * found['moment']:.2f} GN m/m"
    lines = (where / "log.txt").read_text(encoding="utf-8").splitlines()
    return [size_of_it, *(line for line in lines if "rock without a mesh; at" in line or "leaves frozen" in line)]


def event(margin: float, is_meshed: bool, folder: Path) -> tuple[Mapping[str, Any], float]:
    """The event of a run, and the CPU seconds of the run."""
    began = time.process_time()
    rows = run(scene(margin, is_meshed), folder / f"{margin:g}-{is_meshed}").events
    (found,) = (row for row in rows if row["kind"] == "event")
    return found, time.process_time() - began


def foreseen(margin: float) -> float:
    """CPU seconds of an event, as a check of the scene tells them."""
    said = price_of_events(prepare(scene(margin, False), MPI.COMM_SELF))["each event in stage auto, about"]
    return float(said.partition("from ")[2].split()[0])


def main() -> int:
    """Run all margins; 1 where a difference is too large."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("margin", type=float, nargs="*", default=[200.0, 400.0])
    parser.add_argument("--joints", action="store_true", help="what an event leaves frozen, by joints and tips")
    given, wrong = parser.parse_args(), 0
    with tempfile.TemporaryDirectory() as folder:
        for size, tips in itertools.product((10.0, 5.0, 2.5), ("plain", "corrected")) if given.joints else ():
            print(f"joints of {size:g} m, {tips} tips:", *frozen(size, tips, Path(folder)), sep="\n", flush=True)
        for margin in given.margin if not given.joints else ():
            (later, cpu), (meshed, cpu_meshed) = (event(margin, each, Path(folder)) for each in (False, True))
            off = {key: abs(later[key] / meshed[key] - 1.0) for key in ("slip", "moment")}
            wrong += max(off.values()) > MOST
            said = ", ".join(f"{key} {value:.1%} off" for key, value in off.items())
            price = f"{cpu:.1f} CPU s, {foreseen(margin):.2g} foreseen, meshed from the start {cpu_meshed:.1f}"
            print(f"margin {margin:g} m: {said}; {price}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
