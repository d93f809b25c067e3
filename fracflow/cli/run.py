"""Runs at the command line, with a progress bar, a report and pictures."""

from __future__ import annotations

import gc
import os
import re
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from fracflow.cli.exit import ExitReport
from fracflow.errors import InputError, Interrupted, SolveError
from fracflow.remarks import ACT, GIVEN_UP, marked

if TYPE_CHECKING:
    from fracflow._petsc import MPI
    from fracflow.scene.scene import Scene
    from fracflow.simulation.observer import Observer
    from fracflow.simulation.refinement import Level
    from fracflow.simulation.totals import Totals


class Terminal(Console):
    """A console that goes quiet when whoever read has seen enough; the run goes on."""

    def on_broken_pipe(self) -> None:
        """Say no more."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())


def run_with_progress(
    scene: Scene,
    folder: Path,
    console: Console,
    comm: MPI.Comm,
    job: Callable[[Observer], Totals],
    title: str = "",
    is_shown: bool = True,
    is_new: bool = False,
) -> None:
    """Do a job with a progress bar, then report and draw its results. Raises the errors of the job. Collective.

    is_new  whether the job writes every file of the folder itself, so that none is a stranger's
    """
    from fracflow.cli.progress import RunProgress, Screen
    from fracflow.mesh.agreement import on_root
    from fracflow.output.status import last_line
    from fracflow.solve.options import forget

    totals, failure, on_disk = None, None, 0

    def saved(steps: int) -> None:
        nonlocal on_disk
        on_disk = steps
        words.saved(steps)

    screen = Screen(Terminal(stderr=True, quiet=comm.rank > 0), title or scene.title or str(folder))
    with ExitReport(comm, folder) as words, screen:
        try:
            totals = job(RunProgress(scene, screen.show, on_saved=saved, on_trial=screen.follow))
        except SolveError as error:
            failure = error
        except Interrupted as error:
            raise Interrupted(last_line(error, folder)) from error
        except KeyboardInterrupt as error:  # a second one: the first waits for the end of the step
            if not on_disk:
                raise
            cut = Interrupted(f"interrupted within a step; the state after {on_disk} steps is on disk")
            raise Interrupted(last_line(cut, folder)) from error
        finally:
            forget()
    if is_shown or failure is not None:
        on_root(comm, lambda: show(folder, console, scene.output.pictures, failure is not None, is_new))
    comm.barrier()  # all ranks end together, in whichever way
    if failure is not None:
        raise SolveError(last_line(failure, folder))
    if totals is not None:
        console.print(totals.in_words() + totals.besides(), soft_wrap=True)
        for line in totals.doubts:
            console.print(marked(scene.with_time_units(line)), soft_wrap=True, markup=False)


def show(folder: Path, console: Console, pictures: bool, failed: bool, is_new: bool) -> None:
    """Tell what a run folder holds, and draw it."""
    from fracflow.cli.report import report
    from fracflow.output.pictures import draw
    from fracflow.storage.reader import trusting

    paths: list[Path] = []
    try:
        with trusting(folder) if is_new and not failed else nullcontext():
            report(folder, console, failed)
            paths = draw(folder) if pictures else paths
    except (OSError, InputError) as error:  # of the files, or of a full disk; the run itself is whole
        why = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
        if isinstance(error, BrokenPipeError) or (isinstance(error, OSError) and not error.filename):
            raise
        line = marked(f"report and pictures incomplete: {why}; again with: fracflow picture {folder}")
        console.print(line, soft_wrap=True, markup=False)
    for path in paths:
        console.print(f"picture: {path}", soft_wrap=True, markup=False)
    for line in warned_in(folder) if failed else ():
        console.print(line, soft_wrap=True, markup=False)


def warned_in(folder: Path) -> list[str]:
    """Warnings of a run that has failed since its first stage began, those alike once; its last error says what it gave up."""
    from fracflow.output.reader import log_of
    from fracflow.output.remarks import alike
    from fracflow.storage.files import shown_plain

    log = log_of(folder)
    first = next((k for k, line in enumerate(log) if line.startswith("stage ")), len(log))
    warned = alike(line for line in log[first:] if line.startswith(ACT) and not line.startswith(f"{ACT}{GIVEN_UP}"))
    return [shown_plain(line) for line in warned]


def run_levels(scene: Scene, folder: Path, count: int, console: Console, comm: MPI.Comm) -> None:
    """Run a scene level by level, and report the finest run and its errors by comparison of levels."""
    from fracflow.output.convergence_plot import tell
    from fracflow.simulation.levels import order_in_time
    from fracflow.simulation.refinement import check_levels, converge, has_tips

    def each(level: Level) -> None:
        is_last, there = level.number == count - 1, {"all": "is there", "a part": "goes on"}.get(level.found, "")
        console.print(f"level {level.number} of {count - 1}: {level.folder} {there}".rstrip(), soft_wrap=True)
        name = f"level {level.number} {scene.title}".rstrip()
        try:
            run_with_progress(level.scene, level.folder, console, comm, level.run, name, is_last)
        except Interrupted as error:
            raise Interrupted(
                f"{str(error).partition(';')[0]} of level {level.number}; go on with the same command"
            ) from error

    check_levels(count, "command line: --converge")
    rows = converge(scene, folder, count, each, comm)
    if comm.rank == 0:
        for ending in ("csv", "json", "png"):
            console.print(f"convergence: {folder / f'converge.{ending}'}", soft_wrap=True)
        tell(rows, console, count, order_in_time(scene), has_tips(folder), scene.method.tips == "corrected")
    comm.barrier()


def with_levels(words: list[str]) -> list[str]:
    """The words of a command, with the usual number of levels where ``--converge`` names none."""
    if "--converge" not in words:
        return words
    at = words.index("--converge") + 1
    is_given = at < len(words) and re.fullmatch(r"[-+]?[\d.]+", words[at]) is not None
    return words if is_given else [*words[:at], "3", *words[at:]]


def keep_imports() -> None:
    """Let Python's collector begin, past all that is imported."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
