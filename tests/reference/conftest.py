"""Films on springs and cracks in rock, run through the public interface; the similarity solution they share."""

import numpy as np
import pytest
import winkler
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.run import run
from fracflow.scene import load

FAR = 8.0


@pytest.fixture
def film(shared_tmp):
    """Function (x, text of a scene on ``winkler.mesh(x)``, *overrides) -> (history, values at the nodes). Collective.

    Of the last state: pressure, opening, flow_rate, each (n,); flow_rate is the mean of the elements at a node.
    """
    comm, count = MPI.COMM_WORLD, [0]

    def once(x, text, *overrides):
        count[0] += 1
        folder = shared_tmp / f"film{count[0]}"
        if comm.rank == 0:
            folder.mkdir()
        comm.barrier()
        names = ("pressure", "opening", "flow_rate")
        text += "".join(
            f'[[probe]]\nname = "{i}"\nat = [{a!r}, 0]\non = "film"\nquantities = {list(names)}\n'
            for i, a in enumerate(np.asarray(x, dtype=float).tolist())
        )
        run(load(winkler.write(folder, comm, x, text), overrides), folder / "run", comm)
        found = comm.bcast(read_history(folder / "run" / "history.h5") if comm.rank == 0 else None)
        return found, {name: np.array([found[f"probe/{i}/{name}"][-1] for i in range(len(x))]) for name in names}

    return once


@pytest.fixture(scope="session")
def similarity():
    """Function w1 -> (w, F0) of (w^3 w')' + 2 xi w' = 0, w(0) = w1, w(inf) = 1, F0 = -w^3 w'(0), by shooting.

    Wijesinghe (1986): d_t = (d^3 p_x / 12 mu)_x with d = d0 + (p - p0)/k_n = d0 w(xi), xi = x/sqrt(4 D0 t) and
    D0 = d0^3 k_n / 12 mu. The inflow is F0 d0 sqrt(D0/t)/2.
    """

    def shoot(w1):
        def rhs(xi, y):
            slope = -y[1] / y[0] ** 3
            return [slope, 2 * xi * slope]

        def pinched(xi, y):
            return y[0] - 1e-3

        pinched.terminal = True

        def solve(flux, dense=False):
            return solve_ivp(
                rhs, (0, FAR), [w1, flux], "DOP853", rtol=1e-12, atol=1e-14, events=pinched, dense_output=dense
            )

        guess = (w1 - 1) * w1**1.5
        flux = brentq(lambda f: solve(f).y[0, -1] - 1, 0.1 * guess, 10 * guess, xtol=1e-14 * guess)
        profile = solve(flux, dense=True).sol
        return lambda xi: profile(np.minimum(xi, FAR))[0], flux

    return shoot
