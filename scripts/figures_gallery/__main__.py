"""``scripts/figures gallery [-o DIR] [--only NAME ...] [--all] [--into-meshes]``: run the scenes of meshes/, draw them.

Each scene leaves NAME-before.png, NAME-overview.png and NAME-probes.png. Runs that are there are drawn again, not run again.
``--all`` takes those of minutes too. ``--into-meshes`` puts pictures that meshes/ shows in their place.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image
from sheets import ROOT

QUICK = (
    "three_fractures", "own_traces", "wave_at_joint", "pressurised_crack", "crossings", "r01_inclined_joint",
    "report_5_1", "report_5_2", "report_5_3", "report_5_4", "report_5_5",
)  # fmt: skip
LONG = ("rupture", "injection_cycle")
CONVERGED = ("pressurised_crack",)  # run on three meshes
SHOWN = {
    "three_fractures-overview": "three_fractures/overview.png",
    "three_fractures-before": "three_fractures/before.png",
    "r01_inclined_joint-overview": "r01_inclined_joint/overview.png",
    "own_traces-before": "own_traces/before.png",
    "pressurised_crack-converge": "pressurised_crack/converge.png",
    "crossings-overview": "crossings/overview.png",
    "report_5_5-overview": "report_5_5/overview.png",
}
"""Name of a picture -> where meshes/ shows it."""
WIDE = 1400  # pixels of a picture in meshes/: sharp at the width of a page, and below a megabyte


def main() -> int:
    """Exit code 1 if a scene cannot be run or drawn."""
    parser = argparse.ArgumentParser(prog="scripts/figures gallery", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "gallery", metavar="DIR")
    parser.add_argument("--only", nargs="+", choices=(*QUICK, *LONG), metavar="NAME", help="these scenes")
    parser.add_argument("--all", action="store_true", help="scenes of minutes too")
    parser.add_argument("--into-meshes", action="store_true", help="replace the pictures that meshes/ shows")
    given = parser.parse_args()
    names = given.only or (*QUICK, *(LONG if given.all else ()))
    given.output = given.output.resolve()
    given.output.mkdir(parents=True, exist_ok=True)
    failed = [name for name in names if not all(_drawn(name, given.output))]
    if given.into_meshes:
        for name, shown in SHOWN.items():
            if name.partition("-")[0] in names and (given.output / f"{name}.png").exists():
                _show(given.output / f"{name}.png", ROOT / "meshes" / shown)
    print(f"{len(names) - len(failed)} of {len(names)} scenes drawn into {given.output}")
    for name in failed:
        print(f"{name}: failed")
    return 1 if failed else 0


def _show(picture: Path, shown: Path) -> None:
    """Put a picture where a page shows it, no wider than that needs."""
    with Image.open(picture) as image:
        image.thumbnail((WIDE, image.height), Image.Resampling.LANCZOS)
        image.convert("RGB").save(shown, optimize=True)


def _drawn(name: str, output: Path) -> list[bool]:
    """Whether each command on a scene went well."""
    scene, run = ROOT / "meshes" / name / "scene.toml", output / "runs" / name
    again = ["picture", run] if (run / "history.h5").exists() else ["run", scene, "-o", run]
    if name in CONVERGED:  # levels that are there are not run again
        again = ["run", scene, "-o", run, "--converge"]
    done = [_fracflow("picture", scene, "-o", output / f"{name}-before.png"), _fracflow(*again)]
    for picture in (*(run / "pictures").glob("*.png"), *run.glob("converge.png")):
        shutil.copyfile(picture, output / f"{name}-{picture.name}")
    return done


def _fracflow(*words: object) -> bool:
    print("fracflow", *words, flush=True)
    command = [sys.executable, "-m", "fracflow", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL).returncode == 0


if __name__ == "__main__":
    raise SystemExit(main())
