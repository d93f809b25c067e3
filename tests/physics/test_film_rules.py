"""Rules of the film without inertia: their order, and the books of energy in every pair of matrices."""

import numpy as np
import pytest
import winkler

from fracflow.model.flow import STORAGE, is_transposed

RULES = {"backward-euler": 1, "bdf2": 2, "trapezoid": 2}
DRAINED = """
[[well]]
name = "drain"
at = {fracture = "film", end = "start"}
"""
FREE = DRAINED + "pressure = 1\n"
PUSHED = """
[initial.rock.springs]
displacement = [0, -1]
displacement_gradient = [[0, 0], [0, 1]]
"""


def history(folder, x, text, *options):
    return winkler.ran(folder, x, text, *options)[0]


def energies(found):
    entries = {key[len("energy/") :]: values for key, values in found.items() if key.startswith("energy/")}
    return entries, max(np.abs(values).max() for values in entries.values())


@pytest.mark.serial
@pytest.mark.parametrize("film", RULES)
def test_order_and_what_the_scheme_dissipates(shared_tmp, film):
    """A film that lets go of its load: order 1 or 2 of the pressure, and of what is booked as the scheme's.

    The pressure at the drain falls with (1 - t)^3: smooth up to where the run ends.
    """
    ends, booked = [], []
    for steps in (20, 40, 80):
        table = [[float(t), float((1 - t) ** 3)] for t in np.linspace(0, 1, steps + 1)]
        text = winkler.SCENE.format(pressure=1) + DRAINED + f"pressure = {table}\n"
        text += '[[probe]]\nname = "far"\nat = [4, 0]\non = "film"\n'
        text += f'[[stage]]\nkind = "quasi-static"\ntime_step = {1 / steps}\nsteps = {steps}\n'
        found = history(shared_tmp, np.arange(5.0), text, f"method.flow_integrator={film}", "method.coupling=whole-lu")
        energy, largest = energies(found)
        assert np.abs(energy["residual"]).max() <= 1e-10 * largest
        ends.append(found["probe/far/pressure"][-1])
        booked.append(energy["scheme"] / largest)
    change = np.abs(np.diff(ends))
    assert np.log2(change[0] / change[1]) == pytest.approx(RULES[film], abs=0.25)
    if film == "trapezoid":  # nothing but in the first step, which is one of backward Euler
        assert all(np.abs(np.diff(each)[1:]).max() <= 1e-13 for each in booked)
        return
    last = np.abs([each[-1] for each in booked])
    assert last.min() > 1e-9
    assert np.log2(last[1] / last[2]) == pytest.approx(RULES[film], abs=0.3)


def test_backward_euler_loses_what_its_identity_says(shared_tmp):
    """Let go, each mode loses (w_new - w)^2 k/2 to the scheme: their sum, and no less than nothing in each step."""
    x = np.array([0.0, 1.0, 2.5, 3.0, 5.0])
    text = winkler.SCENE.format(pressure=0) + PUSHED + DRAINED + "pressure = 0\n"
    text += "".join(
        f'[[probe]]\nname = "{i}"\nat = [{a}, 0]\non = "film"\nquantities = ["opening"]\n' for i, a in enumerate(x)
    )
    found = history(shared_tmp, x, text + '[[stage]]\nkind = "quasi-static"\ntime_step = 0.3\nsteps = 8\n')
    energy, largest = energies(found)
    share = np.array([0.5, 1.25, 1.0, 1.25, 1.0])  # of the length at each node
    opening = np.array([found[f"probe/{i}/opening"] for i in range(5)])
    assert opening[:, 0] == pytest.approx(-1.0)
    lost = 0.5 * share @ np.diff(opening, axis=1) ** 2
    # the first step starts from a pressure that does not balance the push: from then on
    assert np.diff(energy["scheme"])[1:] == pytest.approx(lost[1:], abs=1e-12 * largest)
    assert lost.min() > 0.0 and np.all(np.diff(energy["viscous"]) >= 0.0)
    assert energy["joint_normal"] == pytest.approx(0.5 * share @ opening**2, abs=1e-10 * largest)


@pytest.mark.parametrize("seed", range(8))
def test_books_of_random_graded_networks(shared_tmp, seed):
    """Spacing over a decade, apertures over a factor three and the cubic law: closed, and nothing spurious in transposes."""
    random = np.random.default_rng(seed)
    x = np.concatenate([[0.0], np.cumsum(np.exp(random.uniform(-1.2, 1.2, 6)))])
    aperture = {"along": x.tolist(), "value": np.exp(random.uniform(0.2, 1.3, 7)).tolist()}
    text = winkler.SCENE.format(pressure=0.2).replace("1e-15", "0.5")
    table = f"aperture = {{along = {aperture['along']}, value = {aperture['value']}}}"
    text = text.replace("aperture = 10\nconductance = 1", table)
    text += DRAINED + "pressure = [[0, 0.2], [0.4, 0.5], [1, 0.1]]\n"
    film, storage = list(RULES)[seed % 3], list(STORAGE)[seed % 5]
    stages = '[[stage]]\nkind = "quasi-static"\ntime_step = 0.1\nsteps = 8\n'
    stages += '[[stage]]\nkind = "dynamic"\ntime_step = 0.1\nsteps = 8\n'
    for pair in sorted({storage, "lumped"}):
        found = history(shared_tmp, x, text + stages, f"method.flow_integrator={film}", f"method.storage={pair}")
        energy, largest = energies(found)
        assert np.abs(energy["residual"]).max() <= 1e-10 * largest, pair
        assert np.any(energy["spurious"]) != is_transposed(pair)
        assert np.diff(found["energy/viscous"]).min() >= 0.0
        if film == "trapezoid":
            assert np.abs(np.diff(energy["scheme"])[1:]).max() <= 1e-12 * largest
