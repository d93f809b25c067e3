"""R14: the discrete decay rate of a pressure mode cos(qx) on a uniform mesh, for every pair of matrices and every rule.

A film on springs k_n, closed at both ends, conductance c: K_F p + E_F v = 0 with k_n w = J^-1 E p, J lumped. On a uniform
mesh cos(qx) is a mode of all of them; with e = (2 + cos qh)/3, e_F = (1 + cos qh)/2 and 1 for lumped matrices
    s_h = c k_n 2 (1 - cos qh)/h^2 / (w_force w_storage).
In space-time a rule multiplies the mode by what its formula says of s_h dt, from which s_h is had back without error.
"""

from pathlib import Path

import numpy as np
import pytest
import winkler

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.run import run
from fracflow.scene import load

PAIRS = {
    "lumped": ("lumped", "lumped"),
    "consistent": ("e", "e"),
    "averaging": ("e_F", "e_F"),
    "report": ("e", "e_F"),
    "consistent-lumped": ("e", "lumped"),
}
WEIGHT = {"e": lambda c: (2 + c) / 3, "e_F": lambda c: (1 + c) / 2, "lumped": lambda c: 1 + 0 * c}
LEADING = {"lumped": -1 / 12, "consistent": 1 / 4, "averaging": 5 / 12, "report": 1 / 3, "consistent-lumped": 1 / 12}
RULES = {  # s dt from three successive amplitudes, the first at the pulse: the trapezoid knows of it for a step
    "backward-euler": lambda a0, a1, a2: a0 / a1 - 1,
    "trapezoid": lambda a0, a1, a2: 2 * (a1 - a2) / (a1 + a2),
    "bdf2": lambda a0, a1, a2: (2 * a1 - a0 / 2) / a2 - 3 / 2,
}
N = 16
MODES = np.arange(1, N)
CUT = np.pi * MODES / N  # q h, with h = 1
STEP = 1.0
PULSE = f"""
[[well]]
name = "pulse"
at = {{fracture = "film", end = "start"}}
flow_rate = [[0, 0], [{STEP}, 1], [{2 * STEP}, 0]]
[[stage]]
kind = "quasi-static"
time_step = {STEP}
steps = 3
""" + "".join(f'[[probe]]\nname = "{i}"\nat = [{i}, 0]\non = "film"\nquantities = ["pressure"]\n' for i in range(N + 1))


@pytest.fixture(scope="module")
def amplitudes(tmp_path_factory):
    """Function (storage, film) -> amplitudes (n, k) of the modes in the pressures of a run. Collective."""
    comm, known = MPI.COMM_WORLD, {}
    x = np.arange(N + 1)

    def once(storage, film):
        if (storage, film) not in known:
            folder = Path(comm.bcast(str(tmp_path_factory.mktemp("r14")) if comm.rank == 0 else None))
            file = winkler.write(folder, comm, x.astype(float), winkler.SCENE.format(pressure=0) + PULSE)
            options = (f"method.storage={storage}", f"method.film={film}", "method.coupling=whole-lu")
            run(load(file, options), folder / "run", comm)
            found = comm.bcast(read_history(folder / "run" / "history.h5") if comm.rank == 0 else None)
            pressure = np.array([found[f"probe/{i}/pressure"] for i in x])
            ends = np.where((x == 0) | (x == N), 0.5, 1.0)
            known[storage, film] = (np.cos(np.outer(CUT, x)) * ends @ pressure).T * 2 / N
        return known[storage, film]

    return once


def rates(storage):
    """s_h of all modes, c = k_n = h = 1."""
    force, volume = (WEIGHT[name](np.cos(CUT)) for name in PAIRS[storage])
    return 2 * (1 - np.cos(CUT)) / (force * volume)


@pytest.mark.parametrize("film", RULES)
@pytest.mark.parametrize("storage", PAIRS)
def test_decay_rate_of_every_mode(amplitudes, storage, film):
    """To round-off: the digits that the largest pressure leaves to the smallest amplitude, through the rule's formula."""
    found, exact = amplitudes(storage, film)[1:4], rates(storage)
    x = exact * STEP
    wrong = np.abs(RULES[film](*found) / x - 1)
    digits = np.finfo(float).eps * np.abs(found).max() / np.abs(found).min(axis=0)
    assert np.all(wrong <= 4 * digits * (1 + x) ** 2 / x), wrong
    assert wrong[:8].max() <= 1e-12


def test_error_of_the_longest_mode(amplitudes):
    """Leading error (qh)^2 times -1/12 lumped, 1/12, 1/4, 1/3 the report's, 5/12; (qh)^4 is left over."""
    for storage, coefficient in LEADING.items():
        rate = RULES["backward-euler"](*amplitudes(storage, "backward-euler")[1:4])[0] / STEP
        assert (rate / CUT[0] ** 2 - 1) / CUT[0] ** 2 == pytest.approx(coefficient, abs=0.15 * CUT[0] ** 2)
