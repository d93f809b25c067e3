"""S2: where contact makes energy: a bar that hits a joint, by time step, stiffness of the joint and time integrator.

The scene of meshes/failures/bar_impact, run by the program's own stages; what a run has at most of kinetic and stored energy,
the joint's in closed form, over what the bar brought.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from sheets import HALO, INK, ROOT, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.stage import run_stage
from fracflow.advance.step import Stepping, stepper_of
from fracflow.errors import SolveError
from fracflow.integrators import with_inertia
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load

SCENE = ROOT / "meshes" / "failures" / "bar_impact" / "scene.toml"
CELLS = 40
DEFAULT = "redistributed"
INTEGRATORS: Mapping[str, Mapping[str, str | float]] = {
    DEFAULT: {},
    "redistributed without events": {"events": "at-step-ends"},
    "lumped": {"contact": "lumped"},
    "lumped without events": {"contact": "lumped", "events": "at-step-ends"},
    "HHT 0.1 lumped without events": {"stepper": "hht", "contact": "lumped", "events": "at-step-ends"},
    "gen-alpha 0 lumped without events": {
        "stepper": "generalised-alpha", "rho_infinity": 0.0, "contact": "lumped", "events": "at-step-ends",
    },
    "explicit without events": {"stepper": "explicit", "contact": "lumped", "events": "at-step-ends"},
}  # fmt: skip
"""Names of the maps -> keys of [method]; trapezoidal rule where no stepper is named. Those the program lacks are left out."""
LIMIT = 1e-3
OFF = 20.0  # where a run is stopped
PARTS = ("kinetic", "rock_strain", "joint_normal_closed", "joint_shear")


def impact(keys: Mapping[str, str | float], step: float, stiffness: float) -> tuple[float, int]:
    """Largest energy over that at the start, and how often the face closes, for c dt/h and k_n h/E."""
    end = 3.0 + np.pi / np.sqrt(stiffness * CELLS)  # the wave there and back, and the swing of the bar on the joint
    settings = [f"method.{key}={value if isinstance(value, float) else repr(value)}" for key, value in keys.items()]
    dt = step / CELLS
    settings += [f"stage.impact.time_step={dt}", f"stage.impact.end={dt * np.ceil(end / dt)}"]
    settings += [f"fracture.face.normal_stiffness={stiffness * CELLS}"]
    model = prepare(load(SCENE, settings), MPI.COMM_SELF)
    refuse_imbalance(model)
    state, stepping = equilibrium_state(model), Stepping(model)
    state = stepping.enter(state, stepper_of(model.scene, model.scene.stage[0]), dt)
    start, most, force, closings = 0.5 / CELLS, 0.0, 0.0, 0
    try:
        for each in run_stage(stepping, state, 0, lambda line: None, {}):
            most = max(most, sum(each.state.energy[name] for name in PARTS) / start)
            now = float(each.state.sections.traction[:, -1].min(initial=0.0))
            closings += force == 0.0 and now < 0.0
            force, state = now, each.state
            if most > OFF:
                break
    except SolveError:
        most = np.inf
    finally:
        stepping.destroy()
    return most, closings


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s2`` and return the bars; ``small`` with few points and the first maps."""
    steps = np.array([1.0, 3.0]) if small else np.array([0.25, 0.5, 1.0, 1.8, 3.0, 5.0])
    stiffnesses = np.array([1.0, 30.0]) if small else np.array([1e-2, 0.1, 1.0, 5.0, 30.0, 300.0, 1e4])
    known = {name: keys for name, keys in INTEGRATORS.items() if keys.get("stepper", "newmark") in with_inertia()}
    if small:
        known = {name: known[name] for name in (DEFAULT, "lumped", "lumped without events")}
    found = {name: np.array([[impact(keys, s, k) for s in steps] for k in stiffnesses]) for name, keys in known.items()}
    energy = {name: table[..., 0] for name, table in found.items()}
    closings = {name: table[..., 1] for name, table in found.items()}
    names = list(known)
    rows = [names[n : n + 3] for n in range(0, len(names), 3)]
    rows[-1] += ["."] * (len(rows[0]) - len(rows[-1]))
    figure, axes = sheet(
        "S2  Energy that contact makes: a bar hits a joint",
        "Largest energy over that of the impact; numbers: how often the face closes, where not once. Dashed: the longest"
        " step of explicit rules.",
        rows, (10.6, 3.6 * len(rows)),
    )  # fmt: skip
    for name in names:
        _map(axes[name], steps, stiffnesses, energy[name], closings[name], name)
    save(figure, folder, "s2", "Bar of 40 cells, E = rho = 1; the program's own stages, to the end of the rebound.")
    grid = np.meshgrid(stiffnesses, steps, indexing="ij")
    columns = {"kn_h_over_E": grid[0].ravel(), "c_dt_over_h": grid[1].ravel()}
    columns |= {f"energy {name}": energy[name].ravel() for name in names}
    columns |= {f"closings {name}": closings[name].ravel() for name in names}
    write_csv(folder, "s2", columns, ["scripts/figures stability --only S2"])
    return _checks(energy, closings)


def _map(axis: Axes, steps: Floats, stiffnesses: Floats, energy: Floats, closings: Floats, name: str) -> None:
    excess = np.log10(np.clip(energy - 1.0, 1e-4, 10.0))
    mesh = axis.pcolormesh(steps, stiffnesses, excess, cmap="RdYlGn_r", vmin=-4.0, vmax=1.0, shading="nearest")
    for row, col in zip(*np.nonzero(closings != 1), strict=True):
        axis.text(
            steps[col], stiffnesses[row], f"{closings[row, col]:.0f}", ha="center", va="center", fontsize=6.5,
            path_effects=HALO,
        )  # fmt: skip
    axis.plot(1.0 / np.sqrt(1.0 + stiffnesses), stiffnesses, color=INK, ls="--", lw=1.3)
    axis.set(xscale="log", yscale="log", xlabel="$c\\,dt/h$", ylabel="$k_n h/E$", title=f"{name}: {energy.max():.4g}")
    axis.set_xlim(steps[0] / 1.2, steps[-1] * 1.2)
    axis.grid(False)
    axis.figure.colorbar(mesh, ax=axis, label="log10 of $E_{max}/E_0 - 1$", pad=0.01)


def _checks(energy: dict[str, Floats], closings: dict[str, Floats]) -> list[Check]:
    most = float(energy[DEFAULT].max())
    often = int(closings[DEFAULT].max())
    worst = float(energy["lumped without events"].max())
    chatters = int(closings["lumped"].max())
    return [
        Check("S2 default: largest energy over the initial", most, f"<= {1.0 + LIMIT:g}", most <= 1.0 + LIMIT),
        Check("S2 default: closings", often, "<= 1", often <= 1),
        Check("S2 lumped without events: largest energy (the map can tell)", worst, "> 5", worst > 5.0),
        Check("S2 lumped: closings (the map can tell)", chatters, "> 10", chatters > 10),
    ]
