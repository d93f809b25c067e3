"""S7: what grows of itself: waves along a fault that slides between unlike rocks; graded films, by pair of matrices.

Fault: the layers of meshes/failures/dissimilar_rocks repeat themselves along x and their cells are alike, so that every wave
exp(i kappa x + p t) is an eigenvector of the program's own matrices, with the tangent of sections that slide:
p^2 M + K(kappa) = 0. A wave is resolved on five cells or more; shorter ones are the mesh's own, and grow too.
Films: seven nodes at random places, random apertures, a wall on springs: p^2 m + p B K_F^-1 B_F' + k = 0, with the
program's element matrices.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from scipy import sparse
from sheets import BLUE, GREEN, HALO, INK, ORANGE, ROOT, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.diagnostics import pre_run_checks
from fracflow.elements.flow import conductivity, storage_matrix
from fracflow.laws.base import HELD
from fracflow.model.flow import STORAGE as PAIRS
from fracflow.model.setup import Model, place
from fracflow.reduction.prepare import prepare, read_split
from fracflow.scene.scene import Scene, load

SCENE = ROOT / "meshes" / "failures" / "dissimilar_rocks" / "scene.toml"
RESOLVED = 5.0  # cells a wave
NOTHING = 1e-7  # of k_n c_s/mu: square roots of round-off
SPREAD = 0.7  # of the logarithms of spacing and aperture of the films
CAP = 0.13  # of k_n c_s/mu: between walls that are held; 0.096 without them


class Waves:
    """Waves along the fault of a model whose cells are alike along x: rows of K and M of the first column of nodes.

    blocks (c, a, a)  K from the unknowns of column c to those of the first; places (c,), mass (a,), length of the period
    """

    def __init__(self, model: Model, friction_sign: float = 1.0) -> None:
        """Let all sections slide in the direction of ``friction_sign``, on one process."""
        ops, nodes = model.operators, model.operators.blocks.solid
        x = np.round(nodes.points[:, 0], 9)
        places = np.unique(x)
        kinds, kind = np.unique(np.c_[np.round(nodes.points[:, 1], 9), nodes.piece], axis=0, return_inverse=True)
        self.places, self.length = places[:-1], float(np.ptp(places))
        column = np.zeros((len(self.places), len(kinds)), dtype=np.int64)
        for number, place_ in enumerate(self.places):
            here = np.flatnonzero(x == place_)
            column[number, kind.ravel()[here]] = here
        unknowns = nodes.unknown[column].reshape(len(self.places), -1)
        held = np.concatenate([part.numbers for part in model.loads.supports])
        self.unknowns = unknowns[:, ~np.isin(unknowns[0], held)]
        stiff = tangent(model, friction_sign)[self.unknowns[0]]
        self.blocks = np.stack([stiff[:, here].toarray() for here in self.unknowns])
        diagonal = ops.mass.getDiagonal()
        self.mass = diagonal.getArray()[self.unknowns[0]].copy()
        diagonal.destroy()

    @property
    def wavenumbers(self) -> Floats:
        """Those that the mesh carries, but for none."""
        return np.asarray(2.0 * np.pi * np.arange(1, len(self.places) // 2 + 1) / self.length)

    def modes(self, wavenumber: float) -> tuple[Floats, Any]:
        """All p (2a,) of p^2 M + K(kappa) = 0, and the shapes (a, 2a)."""
        stiff = np.einsum("cab,c->ab", self.blocks, np.exp(1j * wavenumber * self.places))
        squares, shapes = np.linalg.eig(stiff / self.mass[:, None])
        roots = np.sqrt(-squares + 0j)
        return np.concatenate([roots, -roots]), np.concatenate([shapes, shapes], axis=1)

    def growth(self) -> Floats:
        """Largest Re p (k,) of each wave."""
        return np.array([self.modes(kappa)[0].real.max() for kappa in self.wavenumbers])


def tangent(model: Model, friction_sign: float = 1.0) -> sparse.csr_matrix:
    """K_s + G' W D G with every section sliding, by the program's operators."""
    ops = model.operators
    joints, count = ops.joints, ops.layout.solid_count
    past = tuple({**p, "sliding": np.full_like(p["sliding"], friction_sign)} for p in joints.initial_history())
    answer = joints.evaluate(np.zeros((len(joints.weights), 2)), past, HELD)
    rows, columns, values = ops.stiffness.getValuesCSR()
    total = sparse.csr_matrix((values, columns, rows), shape=(count, count))
    for numbers, blocks in joints.tangent(answer.tangent):
        width = numbers.shape[1]
        at = np.repeat(numbers, width, axis=1).ravel(), np.tile(numbers, (1, width)).ravel()
        total = total + sparse.coo_matrix((blocks.ravel(), at), shape=(count, count)).tocsr()
    return total


def layers(contrast: float, friction: float, stiffness: float, mesh: str = "coarse") -> Scene:
    """The scene with a ratio of shear speeds, a friction, and k_n over mu of the slow layer [1/length]."""
    return load(
        SCENE,
        [
            f"mesh.file={mesh}.geo", f"rock.fast.youngs_modulus={2.5 * contrast**2}",
            f"fracture.fault.friction_coefficient={friction}", f"initial_stress.xy={0.999 * friction}",
            f"fracture.fault.normal_stiffness={stiffness}",
        ],
    )  # fmt: skip


def warned(scene: Scene) -> bool:
    """Whether the card says so, of a run as long as one e-fold takes."""
    mesh = read_split(scene)
    card = {number.name: number for number in pre_run_checks(scene, mesh, place(scene, mesh).wells)}
    return card["dissimilar rock"].value is not None


def faults(contrasts: Floats, frictions: Floats, stiffness: float) -> tuple[Floats, Floats, np.ndarray]:
    """Growth over k_n c_s/mu of resolved waves, and of all (contrasts, frictions); and where the card sees unlike rocks."""
    shape = (len(contrasts), len(frictions))
    found, whole, flagged = np.zeros(shape), np.zeros(shape), np.zeros(len(contrasts), dtype=bool)
    for row, contrast in enumerate(contrasts):
        for column, friction in enumerate(frictions):
            scene = layers(float(contrast), float(friction), stiffness)
            model = prepare(scene, MPI.COMM_SELF)
            waves = Waves(model)
            growth = waves.growth() / stiffness
            seen = waves.wavenumbers * waves.length / len(waves.places) <= 2.0 * np.pi / RESOLVED * (1 + 1e-9)
            found[row, column], whole[row, column] = growth[seen].max(), growth.max()
        flagged[row] = warned(scene)
    return found, whole, flagged


def films(pair: str, draws: int, nodes: int = 7) -> Floats:
    """Largest Re p over the highest frequency (draws,) of random films, one end drained; walls bend a little."""
    random, found = np.random.default_rng(7), np.zeros(draws)
    ends = np.stack([np.arange(nodes - 1), np.arange(1, nodes)], axis=1)
    for draw in range(draws):
        length, aperture = np.exp(random.normal(0.0, SPREAD, (2, nodes - 1)))
        lines = np.einsum("n,ij->nij", length, [[0.0, 0.0], [1.0, 0.0]])
        matrices = [storage_matrix(kind, lines) for kind in (*PAIRS[pair], "lumped")]
        matrices += [conductivity(aperture**3 / length), conductivity(1.0 / length)]
        push, squeeze, area, network, bend = (_assembled(each, ends) for each in matrices)
        damping = push[:, 1:] @ np.linalg.solve(network[1:, 1:], squeeze.T[1:])
        stiff = np.linalg.solve(area, area + 0.3 * bend)
        rate = np.block([[np.zeros((nodes, nodes)), np.eye(nodes)], [-stiff, -np.linalg.solve(area, damping)]])
        found[draw] = np.linalg.eigvals(rate).real.max() / np.sqrt(np.linalg.eigvals(stiff).real.max())
    return found


def _assembled(blocks: Floats, ends: Any) -> Floats:
    total = np.zeros((ends.max() + 1,) * 2)
    np.add.at(total, (ends[:, :, None], ends[:, None, :]), blocks)
    return total


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s7`` and return the bars."""
    contrasts = np.array([1.0, 1.2, 2.0]) if small else np.array([1.0, 1.01, 1.05, 1.1, 1.2, 1.3, 1.4, 1.6, 2.0, 3.0])
    frictions = np.array([0.3, 0.84]) if small else np.array([0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.84])
    stiffness, draws = 0.1, 150 if small else 2000
    found, whole, flagged = faults(contrasts, frictions, stiffness)
    grows = {pair: films(pair, draws) for pair in PAIRS}
    figure, axes = sheet(
        "S7  What grows of itself: waves along a fault between unlike rocks, and films whose matrices are no transposes",
        "Two rocks alike never grow; unlike ones do, at any contrast: the card tells. Films grow with the report's pair.",
        [["fault", "film"]], (11.4, 4.3), width_ratios=[1.3, 1.0],
    )  # fmt: skip
    axis = axes["fault"]
    shown = axis.pcolormesh(
        np.arange(len(contrasts) + 1), np.arange(len(frictions) + 1), np.ma.masked_less(found.T, NOTHING),
        norm=LogNorm(1e-3, 0.2), cmap="YlOrRd",
    )  # fmt: skip
    for (row, column), value in np.ndenumerate(found):
        text = f"{value:.2g}" if value > NOTHING else "0"
        axis.text(row + 0.5, column + 0.5, text, ha="center", va="center", fontsize=7.5, path_effects=HALO)
    axis.set_xticks(np.arange(len(contrasts)) + 0.5, [f"{value:g}" for value in contrasts])
    axis.set_yticks(np.arange(len(frictions)) + 0.5, [f"{value:g}" for value in frictions])
    edge = int(np.argmax(flagged)) if flagged.any() else len(contrasts)
    axis.axvline(edge, color=INK, lw=2.0, ls="--")
    axis.set(xlabel="contrast of shear speeds; dashed: from where the card warns", ylabel="friction")
    axis.set_title(r"Growth of resolved waves over $k_n c_s/\mu$", loc="left")
    axis.grid(False)
    figure.colorbar(shown, ax=axis, pad=0.01)
    axis = axes["film"]
    share = {pair: float((values > 1e-9).mean()) for pair, values in grows.items()}
    colours = [ORANGE if value > 0 else GREEN for value in share.values()]
    axis.barh(np.arange(len(share)), [100.0 * value for value in share.values()], color=colours)
    for row, (pair, value) in enumerate(share.items()):
        text = f"{100 * value:.1f} %, at most {max(grows[pair].max(), 0):.1g} $\\omega$" if value else "none"
        axis.text(100.0 * value + 0.2, row, text, va="center", fontsize=8, color=BLUE)
    axis.set_yticks(np.arange(len(share)), list(share))
    axis.set(xlabel="random graded films that grow [%]", title="Films of seven nodes, by pair of matrices")
    axis.set_xlim(0.0, 170.0 * max(share.values()) + 1.0)
    note = (
        f"Fault: eigenvalues of the program's matrices, k_n/mu = {stiffness:g} per unit length, layers 10 deep, waves of five"
        f" cells or more; shorter ones reach {whole.max():.2g}. Films: {draws} draws a pair, seed 7."
    )
    save(figure, folder, "s7", note)
    grid = np.meshgrid(contrasts, frictions, indexing="ij")
    columns = {
        "contrast": grid[0].ravel(), "friction": grid[1].ravel(), "growth_resolved": found.ravel(), "growth_all": whole.ravel(),
        **{f"film {pair}": values for pair, values in grows.items()},
    }  # fmt: skip
    write_csv(folder, "s7", columns, ["scripts/figures stability --only S7"], note)
    quiet = float(whole[~flagged].max(initial=0.0))
    default = float(max(grows["lumped"].max(), 0.0))
    return [
        Check("S7 fault, growth where the card does not warn", quiet, f"<= {NOTHING:g}", quiet <= NOTHING),
        Check("S7 fault, largest growth of resolved waves", float(found.max()), f"<= {CAP:g} k_n c_s/mu", found.max() <= CAP),
        Check("S7 film, largest growth with the default pair", default, "<= 1e-9 omega", default <= 1e-9),
        Check("S7 film, share that grows with the report's pair", share["report"], "> 0", share["report"] > 0.0),
    ]  # fmt: skip
