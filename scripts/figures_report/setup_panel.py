"""The set-up of a fault problem: mesh, numbered nodes, wells, and the pressure along the fault before it fails."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from sheets import AMBER, BLUE, HALO, INK, ORANGE, PALE, ROOT

from figures_report.common import Run, dynamic, probe


def draw_setup(mesh_axes: Axes, pressure_axes: Axes, scene: str, run: Run, wells: Mapping[str, float]) -> None:
    """Mesh and pressure side by side, y upwards.

    wells  name of the probe at a well -> its share of the pumping, positive into the fault
    """
    from fracflow.reduction.prepare import read_split
    from fracflow.scene.scene import load

    loaded = load(ROOT / "meshes" / scene / "scene.toml")
    mesh = read_split(loaded)
    points = 1e-3 * mesh.points
    quads = PolyCollection(list(points[mesh.cells]), facecolors="#f4f1ea", edgecolors="#cfc8b8", linewidths=0.7)
    mesh_axes.add_collection(quads)
    fault = points[mesh.joint_bottom].reshape(-1, 2)
    mesh_axes.plot(fault[:, 0], fault[:, 1], color=INK, lw=2.2, solid_capstyle="butt")
    places = {item.name: 1e-3 * np.array(item.at, dtype=float) for item in loaded.probe}
    for name, (x, y) in places.items():
        on_fault, share = abs(x) < 1e-9, wells.get(name, 0.0)
        marker = "o" if share == 0.0 else "^" if share > 0.0 else "v"
        colour = "white" if share == 0.0 else ORANGE if share > 0.0 else BLUE
        mesh_axes.plot(x, y, marker, ms=9 if share else 5.5, mfc=colour, mec=INK, mew=0.9, zorder=5)
        said = name.removeprefix("node") + _pumped(share)
        mesh_axes.annotate(
            said, (x, y), (8, 3 if on_fault else 4), textcoords="offset points", fontsize=8, zorder=6, path_effects=HALO
        )
    mesh_axes.set(title="mesh (R)", xlabel="x [1000 ft]", ylabel="y [1000 ft]")
    mesh_axes.grid(False)
    mesh_axes.autoscale_view()
    mesh_axes.margins(0.04)
    on_fault = [name for name in places if abs(places[name][0]) < 1e-9]
    failure = int(np.argmax(dynamic(run)))
    profile = np.array([probe(run, name, "pressure")[failure] for name in on_fault]) * 1e-4
    height = np.array([places[name][1] for name in on_fault])
    rest = probe(run, on_fault[0], "pressure")[0] * 1e-4
    pressure_axes.fill_betweenx(
        height, rest, profile, where=profile >= rest, color=ORANGE, alpha=0.22, lw=0, interpolate=True
    )
    pressure_axes.fill_betweenx(
        height, rest, profile, where=profile <= rest, color=BLUE, alpha=0.22, lw=0, interpolate=True
    )
    pressure_axes.plot(profile, height, color=INK, marker="o", ms=3.5)
    pressure_axes.axvline(rest, color=AMBER, lw=1.0, ls=(0, (4, 3)))
    pressure_axes.annotate(
        "$p_0$", (rest, 0.02), (4, 0), ("data", "axes fraction"), "offset points", color=PALE, fontsize=8
    )
    pressure_axes.set(title="pressure at failure", xlabel="[10$^4$ lbf/ft²]")
    pressure_axes.tick_params(labelleft=False)
    pressure_axes.sharey(mesh_axes)


def _pumped(share: float) -> str:
    size = "" if abs(share) == 1.0 else f"{abs(share):g} "
    return f"  {'+' if share > 0.0 else '−'}{size}Q" if share else ""
