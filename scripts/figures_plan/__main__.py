"""``scripts/figures plan [-o DIR] [--only NAME ...] [--seeds N] [--wide N] [--join]``: scenes as planned against all in them.

Every scene of meshes/ (by its folder), the injection of W7, a network, random scenes, and random ones in wide rock are run
twice, as they stand and with ``model = "full"``. Exit code 1 where what they tell is further apart than the tolerance, where
one run alone fails, where a longer run takes more time as the plan has it, where no injection takes a third of the time, or
where fewer than ten of all scenes do. With ``--join`` scenes that have a row in DIR/plan.csv are not run again, and those that
are run join them: the figure may be made in parts. ``--order`` shows the order that meshes of wide scenes have, and draws none.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from figures_work_precision.problems import w7
from sheets import BLUE, GREEN, GRID, INK, ORANGE, PALE, ROOT, STYLE, Check, judge, made_with, save, sheet

import fracflow
from figures_plan.scenes import network, scene
from figures_plan.twins import TooLong, full_of, once, refinements, twins
from figures_plan.wide import JOINTS, wide
from fracflow.errors import InputError
from fracflow.scene.scene import Scene

COMMAND = "scripts/figures plan"
MESHES = ROOT / "meshes"
NAMES = sorted(str(path.parent.relative_to(MESHES)) for path in MESHES.rglob("scene.toml"))
SHORTENED = {"rupture": ("stage.0.end=1", "first second of 6.6")}
"""Scene -> settings of both runs, and what they leave of it: its run with all in it takes more than ten minutes."""
INJECTION = "W7"
NETWORK = "network"  # sixty fractures that a fault does not feel
CELLS, STEPS = 128, 24  # of W7: 33 000 displacements
COUPLED = (INJECTION, "injection_cycle")
LONG, SLOWER, FASTER = 10.0, 1.1, 3.0  # [s]; times
LONG_ENOUGH = 1.0  # [s] of scenes in wide rock, which have no other cost than their rock's
MANY, ALL = 10, 50  # scenes that take a third of the time, at least, of so many or more
TRIES = 3  # of a time that misses its bar: other programs take their share of the machine
MOST = 600  # records of a random scene; most have 21
NAMED = 6  # scenes but those in wide rock that take a third of the time, of which most time is saved
ONE = 0.8  # least order that is taken for the first
LEAST = 1e-6  # error over tolerance, below which scenes are counted, not named
RANDOM = ("random", "wide")
PARTS = ("probes", "events", "energy")
COLUMNS = ("scene", "cpu_full_s", "cpu_reduced_s", *PARTS, "tolerance", "ratio", "worst", "stopped", "remark")


class Entry(NamedTuple):
    """A row: a scene, the CPU seconds of both runs, and what there is to say of them.

    errors   largest of each of PARTS, nan where there is none
    ratio    the worst one over the tolerance; infinite where one run alone has failed
    worst    where that is
    stopped  why a run ended early, else empty
    """

    name: str
    full: float
    reduced: float
    errors: tuple[float, ...]
    tolerance: float
    ratio: float
    worst: str
    stopped: str
    remark: str

    @property
    def both_failed(self) -> bool:
        """Whether neither run came to its end."""
        return bool(self.stopped) and self.ratio < np.inf


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "plan", metavar="DIR")
    known = (*NAMES, INJECTION, NETWORK, "random", "wide")
    several = f"{', '.join(known)}, or one as 'wide 13'"
    parser.add_argument("--only", nargs="+", type=asked, default=known, metavar="NAME", help=several)
    parser.add_argument("--seeds", type=int, default=24, help="random scenes that at least one run solves (24)")
    parser.add_argument("--wide", type=int, default=30, help="random scenes in wide rock (30)")
    parser.add_argument(
        "--reduced", nargs="+", default=(), metavar="TABLE.KEY=VALUE", help="settings of the reduced runs alone"
    )
    parser.add_argument("--join", action="store_true", help="keep the rows that are in DIR/plan.csv, and add to them")
    parser.add_argument(
        "--order",
        action="store_true",
        help="run named scenes in wide rock with all in them, on three meshes, and no others",
    )
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    if given.order:
        return orders(given.only)
    rows = given.output / "plan.csv"
    known_rows = {entry.name: entry for entry in read(rows)} if given.join and rows.exists() else {}
    entries = list(known_rows.values())
    with tempfile.TemporaryDirectory() as folder:
        once(scene_of("r01_inclined_joint", Path(folder)))  # what is loaded once is no one's time
        for entry in measure(given.only, (given.seeds, given.wide), given.reduced, Path(folder), known_rows):
            print(f"{entry.name}: {told(entry)}", flush=True)
            entries.append(entry)
            write(entries, rows)  # a run that is stopped keeps its rows
    with matplotlib.rc_context(STYLE):
        draw(entries, given.output)
    return judge(check(entries), given.output)


def orders(names: Sequence[str]) -> int:
    """Print how far results are apart on JOINTS/2, JOINTS and 2 JOINTS joints a fracture; 1 where any order is below ONE."""
    found = []
    for name in (name for name in names if name.startswith("wide ")):
        coarse = Scene.from_data(wide(int(name.partition(" ")[2]), JOINTS // 2), MESHES / "wide.toml")
        first, second = refinements(coarse)
        found.append(float(np.log2(first / second)))
        print(f"{name}: {first:.3g}, {second:.3g} of the largest: order {found[-1]:.2f}", flush=True)
    return int(min(found, default=0.0) < ONE)


def asked(name: str) -> str:
    """A name of ``--only``; raises ValueError for others."""
    kind, _, seed = name.partition(" ")
    if name not in (*NAMES, INJECTION, NETWORK, *RANDOM) and not (kind in RANDOM and seed.isdecimal()):
        raise ValueError(name)
    return name


def scene_of(name: str, folder: Path) -> Scene:
    """A scene of meshes/, the network, or that of W7, whose files go into a folder."""
    if name == NETWORK:
        return Scene.from_data(network(), MESHES / "network.toml")
    if name == INJECTION:
        return fracflow.load(w7.written(folder, CELLS, STEPS))
    kind, _, seed = name.partition(" ")
    if kind in RANDOM:
        return Scene.from_data((scene if kind == "random" else wide)(int(seed)), MESHES / f"{kind}.toml")
    settings = [SHORTENED[name][0]] if name in SHORTENED else []
    return fracflow.load(MESHES / name / "scene.toml", ["output.pictures=false", *settings])


def measure(
    names: Sequence[str], seeds: tuple[int, int], reduced: Sequence[str], folder: Path, known: Mapping[str, Entry]
) -> Iterator[Entry]:
    """All twins that are asked for but not ``known``; a random scene that neither solves gives way to the next seed."""
    for name in names:
        if name not in (*RANDOM, *known):
            long = LONG_ENOUGH if name.startswith("wide") else LONG
            yield pair(name, scene_of(name, folder), reduced, SHORTENED.get(name, ("", ""))[1], long=long)
    solved = 0
    for seed in count() if "random" in names else ():
        if solved == seeds[0]:
            break
        name = f"random {seed}"
        if name in known:
            solved += not known[name].both_failed
            continue
        try:
            entry = pair(name, scene_of(name, folder), reduced, "", most=MOST)
        except TooLong:
            print(f"{name}: more than {MOST} records; the next seed takes its place", flush=True)
            continue
        solved += not entry.both_failed
        yield entry
    for seed in range(seeds[1] if "wide" in names else 0):
        if (name := f"wide {seed}") not in known:
            yield pair(name, scene_of(name, folder), reduced, "", long=LONG_ENOUGH)


def pair(
    name: str, scene: Scene, reduced: Sequence[str], remark: str, most: float = np.inf, long: float = LONG
) -> Entry:
    """Run the twins; of runs that take ``long`` the shortest time of TRIES counts, as far as the bar asks for it."""
    try:
        found = twins(scene, *reduced, most=most)
    except InputError as error:  # settings that are not for this scene
        found, remark = twins(scene, most=most), f"not {' '.join(reduced)}: {error}"
    full, less = found.full.seconds, found.reduced.seconds
    for _ in range(TRIES - 1):
        if max(full, less) > long and less > SLOWER * full and not reduced:
            full, less = min(full, once(full_of(scene)).seconds), min(less, once(scene).seconds)
    if found.coarse is not None:
        remark = f"against the limit of its mesh and one twice as fine, from which its own is {found.coarse:.2g} away"
    errors = tuple(found.gaps[part].error if part in found.gaps else np.nan for part in PARTS)
    stopped = found.full.failure or found.reduced.failure
    return Entry(name, full, less, errors, found.tolerance, found.ratio, found.worst, stopped, remark)


def told(entry: Entry) -> str:
    """One line."""
    apart = ", ".join(f"{name} {error:.1e}" for name, error in zip(PARTS, entry.errors, strict=True) if error == error)
    times = f"full {entry.full:.2f} s, reduced {entry.reduced:.2f} s"
    where = f"; worst {entry.worst}" if entry.ratio > 1.0 else ""
    failed = f"; both stopped: {entry.stopped}" if entry.both_failed else ""
    return f"{times}; {apart}; error/tolerance {entry.ratio:.1e}{where}{failed}{'; ' if entry.remark else ''}{entry.remark}"


def check(entries: Sequence[Entry]) -> list[Check]:
    """The bars."""
    worst = max(entries, key=lambda entry: entry.ratio)
    apart = [entry.name for entry in entries if not entry.ratio <= 1.0]
    checks = [
        Check("worst error over tolerance", f"{worst.ratio:.2g} ({worst.name})", "<= 1", not apart),
        Check("scenes beyond it", ", ".join(apart) or "none", "none", not apart),
    ]
    wide_ones = [entry for entry in entries if entry.name.startswith("wide")]
    for some, long in ((entries, LONG), (wide_ones, LONG_ENOUGH)):
        longer = [entry for entry in some if max(entry.full, entry.reduced) > long]
        if longer:
            slow = max(longer, key=lambda entry: entry.reduced / entry.full)
            ratio = slow.reduced / slow.full
            name, what = "in wide rock, " if some is wide_ones else "", f"{ratio:.2f} ({slow.name})"
            checks.append(
                Check(f"CPU reduced over full, {name}above {long:g} s", what, f"<= {SLOWER}", ratio <= SLOWER)
            )
    if len(entries) >= ALL:
        many = sum(entry.full >= FASTER * entry.reduced for entry in entries)
        checks.append(Check("scenes in a third of the CPU", f"{many} of {len(entries)}", f">= {MANY}", many >= MANY))
    coupled = [entry for entry in entries if entry.name in COUPLED]
    if coupled:
        fast = max(coupled, key=lambda entry: entry.full / entry.reduced)
        ratio = fast.full / fast.reduced
        what = f"{ratio:.2f} ({fast.name})"
        checks.append(Check("CPU full over reduced, coupled injection", what, f">= {FASTER:g}", ratio >= FASTER))
    return checks


def write(entries: Sequence[Entry], path: Path) -> None:
    """A row a scene, under the machine and the versions."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for line in (*made_with(), f"command: {COMMAND}"))
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for entry in entries:
            numbers = [f"{n:.4g}" for n in (entry.full, entry.reduced, *entry.errors, entry.tolerance, entry.ratio)]
            rows.writerow([entry.name, *numbers, entry.worst, entry.stopped, entry.remark])


def read(path: Path) -> list[Entry]:
    """The rows of such a file, whose numbers have four digits."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(line for line in file if not line.startswith("#"))][1:]
    found = []
    for name, full, reduced, *rest in rows:
        *errors, tolerance, ratio = map(float, rest[:-3])
        found.append(Entry(name, float(full), float(reduced), tuple(errors), tolerance, ratio, *rest[-3:]))
    return found


def draw(entries: Sequence[Entry], folder: Path) -> None:
    """CPU of the two against each other, and the error of each scene over its tolerance."""
    apart = sorted((entry for entry in entries if entry.ratio > LEAST), key=lambda entry: -entry.ratio)
    figure, axes = sheet(
        "Scenes without the parts that they do not need",
        'Each scene as it stands and with model = "full", which leaves nothing out: its cost, and how far results are apart.',
        [["cpu", "error"]], (8.8, max(5.0, 2.0 + 0.17 * len(apart))), width_ratios=[1.15, 1.0],
    )  # fmt: skip
    full, reduced = (np.array([getattr(entry, name) for entry in entries]) for name in ("full", "reduced"))
    errors = np.array([entry.ratio for entry in apart])
    colours = [colour_of(entry) for entry in entries]
    ends = np.array([0.7 * min(full.min(), reduced.min()), 1.4 * max(full.max(), reduced.max())])
    for times, text, side in ((1.0, "equal ", "right"), (1.0 / FASTER, f"  {FASTER:g} times less", "left")):
        axes["cpu"].plot(ends, times * ends, "-", color=GRID, lw=2, zorder=0)
        above = "bottom" if side == "right" else "top"
        axes["cpu"].annotate(text, (1.5 * ends[0], 1.5 * times * ends[0]), fontsize=8, color=PALE, ha=side, va=above)
    axes["cpu"].scatter(full, reduced, c=colours, s=14, zorder=3)
    alone = [each for each in entries if not each.name.startswith("wide") and each.full >= FASTER * each.reduced]
    for entry in sorted(alone, key=lambda entry: entry.reduced - entry.full)[:NAMED]:
        axes["cpu"].annotate(
            entry.name, (entry.full, entry.reduced), xytext=(4, -9), textcoords="offset points", fontsize=8
        )
    axes["cpu"].set(
        xscale="log", yscale="log", xlabel='CPU seconds, model = "full"', ylabel="CPU seconds, as it stands"
    )
    place = np.arange(len(apart))[::-1]
    shades = [colour_of(entry) for entry in apart]
    axes["error"].scatter(np.clip(errors, LEAST, 1e3), place, c=shades, s=14, zorder=3)
    axes["error"].axvline(1.0, color=INK, lw=1)
    axes["error"].annotate("tolerance ", (1.0, -0.8), fontsize=8, color=PALE, ha="right", va="center")
    label = f"largest error / tolerance ({len(entries) - len(apart)} more below {LEAST:g})"
    axes["error"].set(
        xscale="log", xlim=(0.3 * LEAST, max(10.0, 3.0 * min(errors.max(initial=1.0), 1e3))), xlabel=label
    )
    axes["error"].set_ylim(-1.4, len(apart))
    axes["error"].set_yticks(place, [entry.name for entry in apart], fontsize=8)
    save(
        figure,
        folder,
        "plan",
        f"Blue: meshes/, {INJECTION}, {NETWORK}; orange: random; green: random in wide rock. {COMMAND}{left_out(entries)}",
    )


def left_out(entries: Sequence[Entry]) -> str:
    """Scenes that were not run, and are not drawn, in words; empty where all were."""
    run = {entry.name for entry in entries}
    missing = [name for name in (*NAMES, INJECTION, NETWORK) if name not in run]
    missing += [f"all {kind}" for kind in RANDOM if not any(name.startswith(f"{kind} ") for name in run)]
    return f"\nNot run: {', '.join(missing)}." if missing else ""


def colour_of(entry: Entry) -> str:
    """By the kind of scene."""
    return {"random": ORANGE, "wide": GREEN}.get(entry.name.partition(" ")[0], BLUE)


if __name__ == "__main__":
    raise SystemExit(main())
