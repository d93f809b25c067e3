"""Messages and bytes of a step: messages.py [CELLS...] [--refine N] [--ranks N...] [--ways WAY...] [--out DIR].

Runs of ``large``, in which Open MPI counts what each rank sends to each other one: those of libraries and of collective
calls too. Explicit steps are the difference of a run of 14 and one of 4. Of a quasi-static step, which slides, it is the
whole run. Ranks may be more than cores: counts do not depend on the time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import _network as network
import large

CELLS, RANKS, WAYS, STEPS = (3_000,), (2, 4, 8), ("explicit", "quasi-static"), (4, 14)


def sent(prefix: Path) -> list[tuple[int, int]]:
    """Messages and bytes that each rank has sent, from the files that Open MPI wrote."""
    found = []
    for path in sorted(prefix.parent.glob(f"{prefix.name}.*.prof")):
        lines = [line.split("\t") for line in path.read_text(encoding="utf-8").splitlines()]
        rows = [(int(words[4].split()[0]), int(words[3].split()[0])) for words in lines if words[0] in ("E", "I")]
        found.append((sum(many for many, _ in rows), sum(size for _, size in rows)))
        path.unlink()
    return found


def counted(way: str, scene: Path, ranks: int, out: Path) -> tuple[list[tuple[int, int]], dict[str, float]]:
    """Messages and bytes that each rank has sent in a run, and facts of the run."""
    prefix = out / f"sent-{scene.stem}-{ranks}"
    settings = {"enable": "1", "enable_output": "3", "filename": str(prefix)}
    given = {f"OMPI_MCA_pml_monitoring_{key}": value for key, value in settings.items()}
    os.environ.update(given)
    try:
        facts = large.measure(way, scene, ranks, 0, out)
    finally:
        for key in given:
            del os.environ[key]
    return sent(prefix), facts


def rows_of(way: str, scenes: list[Path], ranks: int, out: Path) -> dict[str, float | str]:
    """A line on a way: of the rank that sends most, and of all together."""
    runs = [counted(way, scene, ranks, out) for scene in scenes]
    (last, facts), per = runs[-1], float(STEPS[1] - STEPS[0]) if way == "explicit" else 1.0
    before = runs[0][0] if len(runs) > 1 else [(0, 0)] * ranks
    messages, size = zip(*((m - n, b - c) for (m, b), (n, c) in zip(last, before, strict=True)), strict=True)
    row: dict[str, float | str] = {"way": way, "cells": facts["cells"], "ranks": ranks}
    row |= {"messages": round(max(messages) / per), "kB": round(max(size) / per / 1e3, 1)}
    row |= {"all_messages": round(sum(messages) / per), "all_kB": round(sum(size) / per / 1e3, 1)}
    return row | {key: facts[key] for key in ("newton", "krylov") if way != "explicit"}


def main() -> None:
    """Count all, and print a line for each."""
    parser = argparse.ArgumentParser(prog="scripts/bench messages", description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="*", type=int, default=CELLS, help="numbers of triangles of the coarse mesh")
    parser.add_argument("--refine", type=int, default=1, help="how often the ranks cut each cell in four")
    parser.add_argument("--ranks", type=int, nargs="+", default=RANKS)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--out", type=Path, default=Path("runs/bench/messages"))
    given = parser.parse_args()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for cells in given.cells:
        mesh = out / f"network-{cells}.msh"
        if not mesh.exists():
            subprocess.run([sys.executable, network.__file__, str(cells), str(mesh)], check=True)
        for way in given.ways:
            scenes = []
            for steps in STEPS if way == "explicit" else (1,):
                scenes.append(out / f"{way}-{cells}-{given.refine}-{steps}.toml")
                scenes[-1].write_text(large.scene_of(way, mesh, cells, given.refine, steps), encoding="utf-8")
            for ranks in given.ranks:
                print(json.dumps(rows_of(way, scenes, ranks, out)), flush=True)


if __name__ == "__main__":
    main()
