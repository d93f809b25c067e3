"""The command line: fracflow new, check, mesh, picture, run, resume, report, export, schema, help."""

from __future__ import annotations

import gc
import json
import os
import re
import sys
import warnings
from copy import copy
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from fracflow.cli.exit import abort, stop
from fracflow.cli.reference import EXAMPLES, markdown
from fracflow.cli.run import Terminal, keep_imports, run_levels, run_with_progress, with_levels
from fracflow.errors import DiskError, InputError, Interrupted, SolveError
from fracflow.remarks import bare, marked, note, parted

if TYPE_CHECKING:
    from fracflow.diagnostics import Number

while (_free := os.open(os.devnull, os.O_RDWR)) <= 2:  # a closed terminal's numbers are no file's of a run
    pass
os.close(_free)
sys.stdout, sys.stderr = sys.stdout or open(os.devnull, "w"), sys.stderr or open(os.devnull, "w")
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # pydantic would look through all packages for them
WIDTH = None if sys.stdout.isatty() else 100  # columns of tables in a file
console_of = partial(Terminal, highlight=False, emoji=False, width=WIDTH)
BEGIN = "Begin with: fracflow new first"
USAGE: Any = typer.BadParameter.__mro__[2]  # ClickException, wherever typer has it from
app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help=__doc__, epilog=BEGIN
)
SceneFile = Annotated[Path, typer.Argument(help="the scene, a TOML file")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="path.to.key=value; arrays by the name of their entry")
]
Trust = Annotated[
    bool, typer.Option("--trust", help="let Gmsh run the scene's .geo as it is; it may do all that you may")
]
Output = Annotated[
    Path | None, typer.Option("-o", "--output", help="run folder; by default runs/<name of the scene's folder>")
]


def show_versions(is_asked: bool) -> None:
    """Print the versions and end. Collective. Raises Exit."""
    if is_asked:
        from fracflow.cli.versions import versions

        for line in versions():
            typer.echo(line)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=show_versions, is_eager=True, help="print versions, to report a fault")
    ] = False,
) -> None:
    """Options that stand before a command."""


@app.command("run", context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def run_command(
    context: typer.Context,
    scene: SceneFile,
    output: Output = None,
    set_: Overrides = None,
    converge: Annotated[
        int | None,
        typer.Option(
            metavar="[LEVELS]",
            help="run it on 3 (or so many) meshes, cells and steps halved from one to the next, and estimate errors",
        ),
    ] = None,
    trust: Trust = False,
) -> None:
    """Run a scene, alone or under mpirun; what follows -- goes to PETSc."""
    from fracflow._petsc import MPI, PETSc

    petsc_options(PETSc, context.args)
    from fracflow.cli.answer import report_checks
    from fracflow.diagnostics import as_records
    from fracflow.mesh.agreement import on_root
    from fracflow.output.folder import check_folder
    from fracflow.scene.advice import advice
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run

    keep_imports()
    comm = MPI.COMM_WORLD
    given = load(scene, set_ or [], trust)
    console = console_of(quiet=comm.rank > 0)
    for line in advice(given):
        console.print(marked(line), soft_wrap=True, markup=False)  # lines name [tables]
    if converge is not None:
        run_levels(given, output or Path("runs") / f"{given.name}-converge", converge, console, comm)
        return
    folder = output or Path("runs") / given.name
    if output is None and folder.is_symlink():  # the user has not named it: files beside a scene may come from anybody
        raise InputError(f"{folder}: is a link; name the run folder with -o")
    on_root(comm, lambda: check_folder(folder))
    replaces = (folder / "history.h5").exists()

    def show_card(numbers: list[Number]) -> None:
        if replaces:  # not before: a scene that is refused replaces nothing
            say(note(f"the run that was in {folder} is replaced"))
        report_checks(as_records(numbers), console)

    def say(line: str) -> None:
        console.print(marked(line), soft_wrap=True, markup=False)

    run_with_progress(
        given, folder, console, comm, lambda tick: run(given, folder, comm, tick, show_card, say), is_new=True
    )


@app.command("resume", context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def resume_command(
    context: typer.Context, folder: Annotated[Path, typer.Argument(help="a run folder")], trust: Trust = False
) -> None:
    """Go on with a run that was stopped, on any number of ranks; what follows -- goes to PETSc."""
    from fracflow._petsc import MPI, PETSc

    petsc_options(PETSc, context.args)
    from fracflow.mesh.agreement import on_root
    from fracflow.output.folder import check_folder
    from fracflow.scene.scene import load
    from fracflow.simulation.run import has_ended, require_run, resume

    keep_imports()
    comm = MPI.COMM_WORLD
    on_root(comm, lambda: check_folder(folder, resume=True))
    on_root(comm, lambda: require_run(folder))
    console = console_of(quiet=comm.rank > 0)
    if on_root(comm, lambda: has_ended(folder)):
        console.print(note(f"the run in {folder} has ended; this is what it left"), soft_wrap=True, markup=False)
    run_with_progress(
        load(folder / "scene.toml"), folder, console, comm, lambda tick: resume(folder, comm, tick, trust)
    )


@app.command("new")
def new_command(
    where: Annotated[
        Path, typer.Argument(metavar="FOLDER|FILE.toml", help="a folder for scene.toml, or the scene's file")
    ],
    traces: Annotated[
        Path | None,
        typer.Option(
            "--traces", metavar="FILE.csv", help="of the traces of your own table: name,x,y in metres; or map.geojson"
        ),
    ] = None,
    mesh: Annotated[
        Path | None, typer.Option("--mesh", metavar="FILE", help="of your own mesh or geometry; it names what is in it")
    ] = None,
    trust: Trust = False,
) -> None:
    """Write a scene with comments that runs as it is, of three fractures or of your own; nothing is written over."""
    from fracflow.cli.new import write_scene

    path = write_scene(where, traces, mesh, trust)
    typer.echo(f"{path}; try: fracflow check {path}")


@app.command()
def check(
    scene: SceneFile,
    set_: Overrides = None,
    as_json: Annotated[bool, typer.Option("--json", help="machine-readable")] = False,
    whole: Annotated[bool, typer.Option("--all", help="every number, criterion, size and note")] = False,
    trust: Trust = False,
) -> None:
    """Validate a scene with its mesh, wells and initial state: what to change first, its cost, what is modelled."""
    from fracflow.cli.answer import short_answer, whole_answer
    from fracflow.cli.check import set_up
    from fracflow.diagnostics import as_records as card_records
    from fracflow.output.folder import to_json
    from fracflow.reduction import as_records
    from fracflow.scene.advice import advice
    from fracflow.scene.scene import load

    keep_imports()
    given = load(scene, set_ or [], trust)
    found, moved, numbers, decisions, network = set_up(given)
    lines, card, plan = [*advice(given), *moved], card_records(numbers), as_records(decisions)
    if as_json:
        warnings, told = parted(lines)[0], [*map(bare, lines)]
        record = {"sizes": found, "plan": plan, "card": card, "notes": told, "warnings": warnings}
        typer.echo(to_json({**record, "network": asdict(network)}, indent=1))
        return
    console = Console(highlight=False, width=WIDTH)
    if whole:
        whole_answer(found, lines, card, plan, console)
    else:
        short_answer(given.title or given.name, found, lines, card, plan, console)


@app.command("mesh")
def mesh_command(
    scene: SceneFile,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="keep it, split, as NAME.h5, which [mesh] file reads")
    ] = None,
    set_: Overrides = None,
    trust: Trust = False,
) -> None:
    """Mesh and split only, with a summary; the mesh may be kept for runs where there is no Gmsh."""
    from fracflow._petsc import MPI
    from fracflow.cli.mesh import mesh_lines
    from fracflow.mesh.agreement import on_root
    from fracflow.scene.scene import load

    keep_imports()
    given = load(scene, set_ or [], trust)
    for line in on_root(MPI.COMM_WORLD, lambda: [*mesh_lines(given, output)]) or ():
        typer.echo(line)


@app.command()
def picture(
    what: Annotated[Path, typer.Argument(metavar="RUN|SCENE", help="a run folder, or a scene before its run")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="of a scene: NAME.png, by default runs/<its name>-before.png")
    ] = None,
    set_: Overrides = None,
    trust: Trust = False,
) -> None:
    """Draw the pictures of a run again; or a scene: mesh, wells, and how near each fracture is to slip."""
    from fracflow.output.pictures import draw

    keep_imports()
    if what.is_file():
        from fracflow.cli.picture import picture_of_scene
        from fracflow.scene.scene import load

        for line in picture_of_scene(load(what, set_ or [], trust), output):
            typer.echo(line)
        return
    if output is not None or set_:
        raise InputError(
            f"{what}: -o and --set are for scenes; leave them out, as a run is drawn into its own folder, as it was run"
        )
    try:
        paths = draw(what)
    except OSError as error:
        raise DiskError.of(error, what) from error
    for path in paths:
        typer.echo(str(path))


@app.command("report")
def report_command(
    folder: Annotated[Path, typer.Argument(help="a run folder, also of a run that is under way or was stopped")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="the file; by default FOLDER/report.html")
    ] = None,
) -> None:
    """Write a page on a run: one HTML file with its scene, plots, map, events and energy balance, which opens offline."""
    from fracflow.run_report import write_report

    keep_imports()
    try:
        path, faults = write_report(folder, output)
    except OSError as error:
        raise DiskError.of(error, folder if output is None else output.parent) from error
    for line in faults:
        typer.echo(note(line))
    typer.echo(str(path))


@app.command()
def export(
    folder: Annotated[Path, typer.Argument(help="a run folder")],
    as_csv: Annotated[
        bool, typer.Option("--csv", help="comma-separated values, the unit in each column's head")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="a folder, by default FOLDER/csv; or NAME.csv, all in one table"),
    ] = None,
    quakeml: Annotated[
        Path | None,
        typer.Option(
            "--quakeml", metavar="FILE", help="the events as QuakeML 1.2, placed by the table site of the scene"
        ),
    ] = None,
) -> None:
    """Write a run for other programs: steps, energies and each probe as CSV, the catalogue of events as QuakeML."""
    from fracflow.output.export import export_csv
    from fracflow.output.quakeml import export_quakeml

    keep_imports()
    if not as_csv and quakeml is None:
        raise InputError("export: no format is named; give --csv or --quakeml FILE")
    for path in export_csv(folder, output) if as_csv else ():
        typer.echo(str(path))
    if quakeml is not None:
        typer.echo(f"{quakeml}: {export_quakeml(folder, quakeml)} events")


@app.command()
def schema(
    as_json: Annotated[
        bool, typer.Option("--json", help="as JSON Schema (draft 7), by which editors complete and check scenes")
    ] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="as a page in Markdown")] = False,
) -> None:
    """Every key of a scene: its values or dimension, its default, its meaning."""
    from rich.markup import escape
    from rich.table import Table

    from fracflow.scene.editor import editor_schema
    from fracflow.scene.scene import Scene
    from fracflow.scene.schema import markdown, note_on_meanings, rows

    keys = Scene.json_schema()
    if note := note_on_meanings(keys):
        typer.echo(note, err=True)
    if as_json:
        typer.echo(json.dumps(editor_schema(keys), indent=1))
        return
    if as_markdown:
        typer.echo(markdown(keys), nl=False)
        return
    table = Table(box=None, pad_edge=False)
    for head, share in (("key", 7), ("values", 6), ("default", 3), ("meaning", 10)):
        table.add_column(head, ratio=share, overflow="fold")
    for row in rows(keys):
        table.add_row(*map(escape, row), style="bold" if row[0].startswith("[") else "")
    Console(highlight=False, width=WIDTH).print(table)


@app.command("help")
def help_command(
    context: typer.Context,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="as a page in Markdown")] = False,
) -> None:
    """Every command; with --markdown its arguments and options too."""
    if as_markdown:
        typer.echo(markdown(commands()), nl=False)
    elif context.parent is not None:
        typer.echo(context.parent.get_help(), nl=False)


for _command in app.registered_commands:
    assert _command.callback is not None
    _command.epilog = f"Example: {EXAMPLES[_command.name or _command.callback.__name__]}"


def commands() -> dict[str, Any]:
    """The commands by name, each with its help and parameters."""
    group: Any = typer.main.get_command(app)
    found: dict[str, Any] = group.commands
    return found


def only(words: list[str]) -> typer.Typer:
    """The program with the command that the words begin with, or with all of them: to build one takes a while."""
    asked = [
        each for each in app.registered_commands if words[:1] == [each.name or getattr(each.callback, "__name__", "")]
    ]
    if not asked or asked[0].callback is help_command:
        return app
    found = copy(app)
    found.registered_commands = asked
    return found


def petsc_options(petsc: Any, words: list[str]) -> None:
    """Put options such as ``-solid_pc_type cholesky`` into PETSc's database. Raises InputError for stray words."""
    database = petsc.Options()
    words = [word for word in words if word != "--"]
    while words:
        key = words.pop(0)
        if not re.fullmatch("-[A-Za-z].*", key):
            from fracflow.scene.messages import nearest

            near = nearest(key, [word for one in commands()["run"].params for word in one.opts])
            meant = f"; {near}" if near.startswith("did you mean") else ""
            if re.fullmatch(r"[\w.-]+\.\w+=.*", key):
                meant = f"; a key of the scene stands behind --set: --set {key}"
            raise InputError(
                f"command line: {key}: neither an option of fracflow (see --help) nor one of PETSc, such as"
                f" -solid_pc_type lu{meant}"
            )
        is_value = bool(words) and (not words[0].startswith("-") or words[0][1:2].isdigit())
        database.setValue(key.lstrip("-"), words.pop(0) if is_value else "")
        database.setValue("options_left", "")
        if key.startswith("-log_view"):
            petsc.Log.begin()  # PETSc itself looks for it as it starts, before any scene is read


def wrong_words(message: str) -> str:
    """The fault of the words of a command, and a remedy."""
    if not message:
        return f"no command; see fracflow --help. {BEGIN}"
    if (found := re.match("No such command '(.*?)'", message)) is None:
        return f"{message.rstrip('.')}; see fracflow --help"
    if found[1].endswith(".toml"):
        return f"{found[0]}. Did you mean: fracflow run {found[1]}? Or see fracflow --help"
    from fracflow.scene.messages import nearest

    near = nearest(found[1], commands())
    return f"{found[0]}. {near[0].upper()}{near[1:]}{'' if near.endswith('?') else '.'} Or see fracflow --help"


def main() -> None:
    """Run a command; bad input is one line from rank 0 and exit code 2, a failed solve 3, an interrupt 130."""
    warnings.formatwarning = lambda message, *_: f"{note(str(message))}\n"
    gc.disable()  # it would look again and again through imports, which stay to the end
    try:
        words = with_levels(sys.argv[1:])
        code = only(words)(words, standalone_mode=False)
        if code == 130:  # typer's word for an interrupt, after which it would have this rank leave the others behind
            raise KeyboardInterrupt
        sys.exit(code)
    except USAGE as error:
        stop(f"command line: {wrong_words(error.format_message())}", 2)
    except typer.Abort:
        stop("interrupted; start it again with the same command", 130)
    except InputError as error:
        stop(str(error), 2)
    except (SolveError, DiskError) as error:
        stop(str(error), 3)
    except Interrupted as error:
        stop(str(error), 130)
    except KeyboardInterrupt:
        stop("interrupted before the first step; start it again with the same command", 130)
    except BrokenPipeError:  # whoever read has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except OSError as error:
        stop(str(DiskError.of(error, "standard output")), 3)
    except Exception:
        abort()
    finally:
        gc.enable()
