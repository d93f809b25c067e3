"""1, 2 and 3 ranks: the same events in the same order, histories equal to 1e-10 of each field's natural size."""

import os
import subprocess
import sys

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

CRACK = ("slip", "plastic_slip", "opening", "displacement", "displacement_bottom")
SCENES = {  # natural sizes f_n0/k_n0 and f_n0
    "report_5_1": (1.0, 1.0),
    "report_5_2": (1.0, 1.0),
    "report_5_3": (1.7e-3, 1.7e5),
    "report_5_4": (1.7e-3, 1.7e5),
    "report_5_5": (1.7e-3, 1.7e5),
    "crossings": (9e6 / 50e9, 9e6),
}
SHORTER = {"report_5_3": 150, "report_5_4": 40, "report_5_5": 150}  # steps of the stage failure, in which all slip
UNSETTLED = 1e-9
IMPEDANCE = 1e7  # of rock [kg/(m2 s)]: a stress that drops moves walls at about its share of it
KEPT = (
    "PATH", "HOME", "PETSC_DIR", "PYTHONPATH", "PYTHONNOUSERSITE", "OMP_NUM_THREADS", "MPLBACKEND", "OMPI_ALLOW_RUN_AS_ROOT",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe", "OMPI_MCA_mpi_yield_when_idle",
    "OMPI_MCA_hwloc_base_binding_policy",
)  # fmt: skip


SETTINGS = {name: ["output.pictures=false"] for name in SCENES}
for _name, _steps in SHORTER.items():
    SETTINGS[_name].append(f"stage.failure.steps={_steps}")
PROGRAM = """
import sys
from pathlib import Path
from fracflow.scene.scene import load
from fracflow.simulation.run import run
for name, settings in {settings!r}.items():
    try:
        run(load(f"meshes/{{name}}/scene.toml", settings), Path(sys.argv[1]) / name)
    except Exception as error:  # the same on every rank, which go on with the next scene
        print(f"{{name}}: {{error!r}}", file=sys.stderr)
"""


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Ranks -> folder of the runs of all scenes, on one rank in this process, else in ranks of their own; and their errors."""
    folders, said = {ranks: tmp_path_factory.mktemp(f"ranks{ranks}-") for ranks in (1, 2, 3)}, {1: ""}
    for name, settings in SETTINGS.items():
        run(load(f"meshes/{name}/scene.toml", settings), folders[1] / name)
    clean = {k: v for k, v in os.environ.items() if k in KEPT}  # MPI, initialised here, has put more there
    for ranks in (2, 3):
        words = [sys.executable, "-c", PROGRAM.format(settings=SETTINGS), str(folders[ranks])]
        done = subprocess.run(
            ["mpirun", "-n", str(ranks), *words],
            capture_output=True,
            text=True,
            env=clean,
            timeout=300 * len(SCENES),
            stdin=subprocess.DEVNULL,
        )
        assert done.returncode == 0, done.stderr
        said[ranks] = done.stderr
    return folders, said


def _read(ran, scene, ranks):
    folders, said = ran
    assert f"{scene}: " not in said[ranks], said[ranks]
    folder = folders[ranks] / scene
    return read_history(folder / "history.h5"), read_events(folder / "events.csv")


def _compared(name):
    skip = ("residual", "newton", "krylov", "factorisations", "coupling", "slip_margin", "round_off")
    return not any(word in name for word in skip)


def _settled(history):
    """Rows before the first decision nearer to its threshold than arithmetic settles."""
    close = np.flatnonzero(history["step/slip_margin"] < UNSETTLED)
    return close[0] if len(close) else len(history["time"])


def assert_agree(one, many, rows, length, stress):
    """Histories, up to so many rows, to 1e-10 of each field's natural size, of a length and a stress of the scene."""
    natural = {**dict.fromkeys(CRACK, length), "shear_traction": stress, "normal_traction": stress}
    natural |= dict.fromkeys(("velocity", "slip_rate"), stress / IMPEDANCE)
    natural["acceleration"] = 4.0 * length / one["step/dt"].max() ** 2  # as (4.1a) makes it of displacements
    sizes = dict(natural) | {"dt": one["time"].max()}  # a step to an event is a difference of times
    names = [name for name in one if _compared(name)]
    whole = ("energy", "volume")  # terms of a balance, each to round-off of the largest
    kind = {n: n.partition("/")[0] if n.startswith(whole) else n.rsplit("/", 1)[-1] for n in names}
    for name in names:
        sizes[kind[name]] = max(sizes.get(kind[name], 0.0), np.nanmax(np.abs(one[name]), initial=0.0))
    for name in names:
        apart = np.nanmax(np.abs(one[name][:rows] - many[name][:rows]), initial=0.0)
        assert apart <= 1e-10 * sizes[kind[name]], (name, apart, sizes[kind[name]])


@pytest.mark.serial
@pytest.mark.starts_ranks
@pytest.mark.parametrize("scene", SCENES)
def test_ranks_agree(scene, ran):
    length, stress = SCENES[scene]
    one, events = _read(ran, scene, 1)
    assert events, "the scene slips"
    for ranks in (2, 3):
        many, same = _read(ran, scene, ranks)
        rows = min(_settled(one), _settled(many))
        assert rows > 0.5 * len(one["time"]), f"the first {rows} rows alone are settled"
        until = one["time"][rows - 1]
        order, starts = [], []
        for log in (events, same):
            begun = [e for e in log if e["start"] <= until + 1e-9]
            order.append([(e["kind"], e["fracture"], e["node"]) for e in begun])
            starts.append([e["start"] for e in begun])
        assert order[0] == order[1] and starts[0] == pytest.approx(
            starts[1], rel=1e-9
        )  # located as well as ranks agree
        assert_agree(one, many, rows, length, stress)


def test_what_ranks_decide_by_is_one_number(shared_tmp):
    """Largest pressures and powers so far: a rank with others would stop, or go on, alone."""
    seen = []
    scene = load("meshes/crossings/scene.toml", ["output.pictures=false", "stage.1.steps=2"])
    run(
        scene,
        shared_tmp / "out",
        progress=lambda step: seen.append((step.state.max_overpressure, step.state.max_dissipation)),
    )
    assert seen[-1][0] > 0.0
    assert MPI.COMM_WORLD.allgather(seen) == [seen] * MPI.COMM_WORLD.size
