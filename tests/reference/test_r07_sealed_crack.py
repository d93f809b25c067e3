"""R07: fluid pumped into a crack without outlet, in elastic rock; nowhere is a pressure prescribed.

Sneddon's crack in a periodic row, which a strip with smooth sides is.
"""

import numpy as np
import pytest
from figures_verification.cases import r07

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

HALF, PERIOD, HEIGHT = 1.0, 4.0, 6.0  # what the row makes is gone at 1.5 W: exp(-2 pi y/W) = 1e-4
MODULUS = 1000 / (1 - 0.25**2)
RATE, END = 1e-3, 2.0
GEO = """
x[] = {-2, -1, 1, 2};
For j In {0:2}
  For i In {0:3}
    Point(10*j + i) = {x[i], 6*(j - 1), 0};
  EndFor
  For i In {0:2}
    Line(100 + 10*j + i) = {10*j + i, 10*j + i + 1};
    Transfinite Curve {100 + 10*j + i} = (x[i + 1] - x[i])*m + 1;
  EndFor
EndFor
For i In {0:3}
  Line(200 + i) = {10 + i, i};
  Line(210 + i) = {10 + i, 20 + i};
  Transfinite Curve {200 + i, 210 + i} = n + 1 Using Progression 12^(1/(n - 1));
EndFor
For i In {0:2}
  Curve Loop(1 + i) = {-(200 + i), 110 + i, 201 + i, -(100 + i)};
  Curve Loop(11 + i) = {210 + i, 120 + i, -(211 + i), -(110 + i)};
  Plane Surface(1 + i) = {1 + i};
  Plane Surface(11 + i) = {11 + i};
EndFor
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {1:3, 11:13};
Physical Curve("crack") = {111};
Physical Curve("sides") = {200, 203, 210, 213};
Physical Curve("bottom") = {100:102};
Physical Curve("top") = {120:122};
"""
"""m squares to the half length of the crack, n rows above and below that grow twelvefold, the first about square."""
SCENE = """
units = "none"
[output]
pictures = false
[mesh]
file = "crack.geo"
[rock.rock]
youngs_modulus = 1000
poissons_ratio = 0.25
[fluid]
viscosity = 1e-9
[[support]]
on = "sides"
components = ["x"]
[[support]]
on = "bottom"
components = ["y"]
[[well]]
name = "in"
at = [0, 0]
flow_rate = 0.001
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 2
[fracture.crack]
aperture = 0.01
shear_stiffness = 1
"""
"""The top is free: held, it would press against the volume that is pumped in."""
OPEN = {
    "touching": "normal_stiffness = 1\nfriction_angle_deg = 30\n",  # no initial stress: open with the first drop
    "soft": 'law = "linear"\nnormal_stiffness = 1e-9\n',
    "closed": "normal_stiffness = 1e4\nfriction_angle_deg = 30\n"  # the rock's load of 0.2 has to be lifted first
    + '[initial_stress]\nyy = -0.2\n[[load]]\non = "top"\ntraction = "initial-stress"\n',
}


@pytest.fixture
def pumped(shared_tmp):
    """Function (m, crack, *overrides) -> (x, pressure, opening, history) at the end. Collective."""
    comm, count = MPI.COMM_WORLD, [0]

    def once(m, crack, *overrides):
        count[0] += 1
        folder, x = shared_tmp / f"crack{count[0]}", np.linspace(-HALF, HALF, 2 * m + 1)
        if comm.rank == 0:
            folder.mkdir()
            rows = round(HEIGHT * np.log(12) / 11 * m)
            (folder / "crack.geo").write_text(f"m = {m};\nn = {rows};\n{GEO}", encoding="utf-8")
            probes = "".join(
                f'[[probe]]\nname = "{i}"\nat = [{a!r}, 0]\non = "crack"\nquantities = ["pressure", "opening"]\n'
                for i, a in enumerate(x.tolist())
            )
            (folder / "scene.toml").write_text(SCENE + OPEN[crack] + probes, encoding="utf-8")
        comm.barrier()
        run(load(folder / "scene.toml", overrides), folder / "run", comm)
        found = comm.bcast(read_history(folder / "run" / "history.h5") if comm.rank == 0 else None)
        pressure, opening = (
            np.array([found[f"probe/{i}/{q}"][-1] for i in range(len(x))]) for q in ("pressure", "opening")
        )
        return x, pressure, opening, found

    return once


def volume(x, opening):
    return float(np.sum((opening[1:] + opening[:-1]) / 2 * np.diff(x)))


def closes(history):
    largest = max(np.abs(v).max() for k, v in history.items() if k.startswith("energy/"))
    return np.abs(history["energy/residual"]).max() <= 1e-10 * largest


def exact(x):
    """Pressure and opening at the volume RATE * END."""
    p = RATE * END / r07.volume(PERIOD, 1.0, MODULUS)
    return p, r07.opening(x, PERIOD, p, MODULUS)


@pytest.mark.serial
def test_pressure_and_opening_by_sneddon(pumped):
    """O(h): pressure too high by 0.57 h, centre by 0.25 h, opening up to 0.9 a off by 0.27 h of the centre's; a = 1."""
    errors = []
    for m in (8, 16, 32):
        x, pressure, opening, history = pumped(m, "touching")
        p, w = exact(x)
        inner = np.abs(x) <= 0.9 * HALF
        assert volume(x, opening) == pytest.approx(RATE * END, rel=1e-11)
        assert closes(history)
        errors.append(
            [np.abs(pressure / p - 1).max(), abs(opening[m] / w[m] - 1), np.abs(opening - w)[inner].max() / w[m]]
        )
    assert np.all(errors[-1] <= np.array([1.8e-2, 7.8e-3, 8.4e-3]))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(1.0, abs=0.15)


def test_the_volume_is_what_was_pumped_however_the_crack_opens(pumped):
    """From touching walls, soft filling, or against a load that adds to the pressure: the same opening, and its volume."""
    x, pressure, opening, _ = pumped(8, "touching")
    for crack in ("soft", "closed"):
        _, other, width, history = pumped(8, crack)
        assert volume(x, width) == pytest.approx(RATE * END, rel=1e-11)
        assert width == pytest.approx(opening, abs=1e-8 * opening.max())
        assert other - pressure == pytest.approx(0.2 if crack == "closed" else 0.0, abs=1e-6 * pressure.max())
        assert closes(history)


def test_rock_and_fluid_by_turns_refuse(pumped):
    """With the walls held nothing can flow in: the volume has no solution, and the message says what has."""
    with pytest.raises(SolveError, match=r"no pressure is prescribed in crack .*monolithic"):
        pumped(4, "touching", "method.coupling=fixed-point")
