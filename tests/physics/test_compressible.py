"""A compressible fluid, of density exp(c_f (p - p0)): what it stores and keeps, how fast pressure spreads, orders and books."""

import numpy as np
import pytest
import winkler

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.output import list_steps, read_step
from fracflow.scene.scene import load

FILM = {"backward-euler": 1, "bdf2": 2, "trapezoid": 2}
SOFT = winkler.SCENE.replace("viscosity = 1", "viscosity = 1\ncompressibility = 0.1")
STIFF = SOFT.replace(
    "[rock.springs]\nyoungs_modulus = 1e-15\npoissons_ratio = 0\n", "[rock.springs]\nrigid = true\n"
).replace('[[support]]\non = "top"', '[[support]]\non = "springs"\ncomponents = ["x", "y", "rotation"]')
LINEAR = STIFF.replace("compressibility = 0.1", "compressibility = 1e-7").replace("aperture = 10\n", "aperture = 1e7\n")
"""c_f d = 1 and conductance 1: the diffusivity is 1; walls that answer or do not move, and a density that hardly changes."""
INFLOW = '[[well]]\nname = "in"\nat = {fracture = "film", end = "start"}\nflow_rate = 0.3\n'
PROBE = '[[probe]]\nname = "far"\nat = [%g, 0]\non = "film"\n'


def stage(kind, end, steps):
    return f'[[stage]]\nkind = "{kind}"\ntime_step = {end / steps}\nsteps = {steps}\n'


def closes(history):
    largest = max(np.abs(values).max() for key, values in history.items() if key.startswith("energy/"))
    assert np.abs(history["energy/residual"]).max() <= 1e-10 * largest
    return largest


@pytest.mark.parametrize("film", FILM)
@pytest.mark.parametrize("kind", ["quasi-static", "dynamic"])
def test_a_sealed_slot_stores_what_flows_in(shared_tmp, kind, film):
    """Walls that do not move: V (exp(c_f p) - 1) = Q t, as a mean, and anywhere once fluid runs freely."""
    x, text = np.array([0.0, 1.0, 1.5, 4.0]), STIFF.format(pressure=0) + PROBE % 4 + INFLOW
    history, fields = winkler.ran(shared_tmp, x, text + stage(kind, 2.0, 5), f"method.flow_integrator={film}")
    length = np.repeat(np.diff(x), 2)
    assert 0.5 * length @ np.expm1(0.1 * np.ravel(fields["pressure"])) * 10.0 == pytest.approx(0.3 * 2.0, rel=1e-11)
    assert history["probe/far/pressure"][-1] < 0.1  # it is still spreading
    closes(history)
    text = text.partition("[[well]]")[0] + evenly(x, 0.3)
    history, _ = winkler.ran(shared_tmp, x, text + stage(kind, 2.0, 5), f"method.flow_integrator={film}")
    volume = 0.3 * history["time"]
    assert history["probe/far/pressure"] == pytest.approx(10.0 * np.log1p(volume / 40.0), rel=1e-11)
    brought = 10.0 * volume / (40.0 + volume)  # int dp/rho, of which (2.33b) takes the mean in each step
    stored = np.cumsum(0.5 * (brought[1:] + brought[:-1]) * np.diff(volume))
    assert history["energy/fluid_storage"][1:] == pytest.approx(stored, rel=1e-11)


WALLS = {"held": STIFF, "give": SOFT, "give alone": winkler.SCENE}
WAYS = {
    "lu": ["method.coupling=whole-lu"],
    "multigrid": ["method.rock_solver=multigrid"],
    "staggered": ["method.coupling=fixed-point", "method.fixed_point=added-storage"],
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("walls", WALLS)
def test_a_sealed_slot_stores_what_flows_in_however_long_the_step(shared_tmp, walls, way):
    """Steps of 1e9 s: all that it stores is 1e-15 of what each joint conducts, and less than its round-off.

    It is so under a pressure at rest too, whose round-off is 1e-10 of what pressures change.
    """
    x, dt = np.array([0.0, 1.0, 1.5, 4.0]), 1e9
    for resting, rel in ((0.0, 1e-11), (1e5, 1e-9)):
        text = WALLS[walls].format(pressure=resting).replace("conductance = 1", "conductance = 1e6")
        text += PROBE % 4 + INFLOW.replace("0.3", f"{0.3 / dt}") + stage("quasi-static", 2 * dt, 2)
        history, fields = winkler.ran(shared_tmp, x, text, *WAYS[way])
        aperture, pressure = np.ravel(fields["aperture"]), np.ravel(fields["pressure"]) - resting
        denser = np.exp(0.1 * pressure) if "compressibility" in text else 1.0
        assert 0.5 * np.repeat(np.diff(x), 2) @ (aperture * denser) - 40.0 == pytest.approx(0.6, rel=rel)
        most = 10 if way == "staggered" else 3 + (resting > 0.0)
        assert not history["step/rejected"].any() and history["step/newton"].max() <= most
        closes(history)


@pytest.mark.parametrize("way", WAYS)
def test_what_a_pinched_element_conducts_is_in_the_balance_of_its_parts_however_long_the_step(shared_tmp, way):
    """1e-16 of what is beside it, and more than its parts store: V_B (exp(c_f p_B) - 1) = dt sum of K (p_A - p_B)."""
    x, dt, profile = np.arange(5.0), 1e11, "[0, 1, 1.001, 1.999, 2, 4], value = [1e6, 1e6, 1e-10, 1e-10, 1e6, 1e6]"
    text = STIFF.format(pressure=0).replace("conductance = 1", f"conductance = {{along = {profile}}}")
    text += (PROBE % 0).replace("far", "near") + PROBE % 4 + INFLOW.replace("0.3", f"{9.0 / dt}")
    history, _ = winkler.ran(shared_tmp, x, text + stage("quasi-static", 2 * dt, 2), *WAYS[way])
    near, far = (history[f"probe/{name}/pressure"] for name in ("near", "far"))
    passed = 1e-10 * dt * np.cumsum((near - far)[1:])
    assert 25.0 * np.expm1(0.1 * far[1:]) == pytest.approx(passed, rel=1e-9) and passed[-1] > 0.3
    assert 15.0 * np.expm1(0.1 * near[1:]) == pytest.approx(9.0 * np.array([1.0, 2.0]) - passed, rel=1e-9)
    assert not history["step/rejected"].any() and history["step/newton"].max() <= (10 if way == "staggered" else 6)
    closes(history)


@pytest.mark.parametrize("share", [1.5e-15, 1e-14, 1e-11])
@pytest.mark.parametrize("chain", [(np.nan, 1e-2, 1e2, 1e6), (1e6, 1e3, np.nan), (1e6, np.nan, 1e6, 1e6)])
def test_a_weak_link_passes_what_it_conducts_however_long_the_step(shared_tmp, chain, share):
    """Its flow has no digits in the balances beside it: these are summed up to it, in place of one that others imply."""
    x, chain = np.arange(len(chain) + 1.0), np.array(chain)
    link = int(np.argmax(np.isnan(chain)))
    chain[link] = share * np.nanmax(chain[max(link - 1, 0) : link + 2])
    along, value = np.sort([*(x[:-1] + 1e-3), *(x[1:] - 1e-3)]).tolist(), np.repeat(chain, 2).tolist()
    text = STIFF.format(pressure=0).replace("conductance = 1", f"conductance = {{along = {along}, value = {value}}}")
    text += "".join((PROBE % at).replace("far", f"at {at}") for at in x)
    text += INFLOW.replace('{fracture = "film", end = "start"}', "[2, 0]").replace("0.3", f"{chain[link]}")
    history, _ = winkler.ran(shared_tmp, x, text + stage("quasi-static", 1.0 / chain[link], 1))
    p = np.array([history[f"probe/at {at}/pressure"][-1] for at in x])
    stored = 10.0 * np.convolve(np.diff(x), [0.5, 0.5], "full") * np.expm1(0.1 * p)
    passed = (p[link + 1] - p[link]) if link < 2 else (p[link] - p[link + 1])
    behind = stored[: link + 1] if link < 2 else stored[link + 1 :]
    assert behind.sum() == pytest.approx(passed, rel=1e-9) and passed > 0.05
    assert stored.sum() == pytest.approx(1.0, rel=1e-11)
    assert not history["step/rejected"].any() and history["step/newton"].max() <= 6
    closes(history)


OUTLET = '[[well]]\nname = "out"\nat = {fracture = "film", end = "end"}\npressure = [[0, 0], [%g, 0.1]]\n'


@pytest.mark.parametrize("way", ["lu", "staggered"])
@pytest.mark.parametrize("walls, film", [("give alone", "trapezoid"), ("held", "backward-euler"), ("give", "bdf2")])
def test_prescribed_pressures_bring_what_is_stored_however_long_the_step(shared_tmp, walls, film, way):
    """By a well that comes to its limit, then by one whose pressure rises while another pumps: their flow is round-off."""
    x = np.array([0.0, 1.0, 1.5, 4.0])
    for dt, wells in (1e5, "maximum_pressure = 0.1\n"), (1e9, "maximum_pressure = 0.1\n"), (1e9, OUTLET % 4e9):
        text = WALLS[walls].format(pressure=0).replace("conductance = 1", "conductance = 1e6")
        text += INFLOW.replace("0.3", f"{0.3 / dt}") + wells + stage("quasi-static", 4 * dt, 4)
        history, fields = winkler.ran(shared_tmp, x, text, *WAYS[way], f"method.flow_integrator={film}")
        aperture, pressure = np.ravel(fields["aperture"]), np.ravel(fields["pressure"])
        denser = np.exp(0.1 * pressure) if "compressibility" in text else 1.0
        stored = 0.5 * np.repeat(np.diff(x), 2) @ (aperture * denser) - 40.0
        brought = sum(values[-1] for key, values in history.items() if key.startswith("well/") and "volume" in key)
        assert brought == pytest.approx(stored, rel=1e-8) and stored > 0.3
        closes(history)


def evenly(x, rate):
    """Wells at all nodes of x that give each its share of ``rate``, so that no fluid has to run anywhere."""
    share = np.convolve(np.diff(x), [0.5, 0.5], "full") / (x[-1] - x[0])
    return "".join(
        f'[[well]]\nname = "at {at}"\nat = [{at}, 0]\nflow_rate = {rate * part}\n'
        for at, part in zip(x, share, strict=True)
    )


@pytest.mark.parametrize("coupling", ["monolithic", "fixed-point"])
def test_without_a_pressure_anywhere_each_coupling_has_a_solution(shared_tmp, coupling):
    """Sealed, with walls that give: (10 + p/k_n) exp(c_f p) = 10 + Q t/L, k_n = 1, whatever the time step."""
    x, c = np.array([0.0, 1.0, 1.5, 4.0]), 10.0
    text = SOFT.format(pressure=0).replace("compressibility = 0.1", f"compressibility = {c}") + PROBE % 4
    text += evenly(x, 40.0) + stage("quasi-static", 1.0, 4)
    history, _ = winkler.ran(shared_tmp, x, text, f"method.coupling={coupling}")
    p = history["probe/far/pressure"]
    assert (10.0 + p) * np.exp(c * p) == pytest.approx(10.0 + 10.0 * history["time"], rel=1e-9)
    closes(history)


@pytest.mark.parametrize("rule", [*FILM, "dynamic", "steady", "fixed-point"])
def test_a_load_that_comes_and_goes_leaves_the_fluid_it_found(shared_tmp, rule):
    """Sealed, c_f dp = 0.4: sum of d exp(c_f (p - p0)) L/2 stays in every step, and the pressure comes back."""
    x, kind = np.array([0.0, 0.3, 1.0, 1.4, 2.5, 3.1, 4.0]), rule if rule in ("dynamic", "steady") else "quasi-static"
    thin = 1e-3 if rule == "dynamic" else 1e-5  # the balances are solved to 1e-11 of what runs through at full pressure
    text = SOFT.format(pressure=0.1).replace("compressibility = 0.1", "compressibility = 1")
    text = text.replace("aperture = 10\nconductance = 1", "aperture = {along = [0, 4], value = [0.6, 0.5]}")
    text = text.replace("youngs_modulus = 1e-15", "youngs_modulus = 5").replace(
        "viscosity = 1\n", f"viscosity = {thin}\n"
    )
    text = text.replace(
        'on = "top"', 'on = "top"\ncomponents = ["x"]\n[[load]]\non = "top"\ntraction = "initial-stress"'
    )
    text += '[[load]]\non = "top"\ntraction = [0, [[0, 0], [1, -0.8], [2, 0], [3, -0.8], [4, 0], [9, 0]]]\n'
    text += '[[probe]]\nname = "far"\nat = [1.4, 0]\non = "film"\n' + stage(kind, 4.0, 8)
    options = ["method.coupling=fixed-point", "method.on_divergence=monolithic"] if rule == "fixed-point" else []
    options += [f"method.flow_integrator={rule}"] if rule in FILM else []
    folder = shared_tmp / "cycle"
    MPI.COMM_WORLD.barrier()
    folder.mkdir(exist_ok=True)
    MPI.COMM_WORLD.barrier()
    history, _ = winkler.ran(folder, x, text, "output.fields_every=1", *options)
    MPI.COMM_WORLD.barrier()
    ran = next(path for path in folder.iterdir() if path.is_dir()) / "run"
    kept = []
    for _, file in list_steps(ran, "fractures"):
        _, fields, _ = read_step(file)
        aperture, pressure = np.ravel(fields["aperture"]), np.ravel(fields["pressure"])
        kept.append(0.5 * np.repeat(np.diff(x), 2) @ (aperture * np.exp(pressure - 0.1)))
    assert len(kept) == 9
    assert kept == pytest.approx(np.full(9, kept[0]), rel=1e-9)
    pressure = history["probe/far/pressure"]
    assert np.ptp(pressure) > 0.35
    if rule not in ("dynamic", "trapezoid", "bdf2"):
        assert pressure[[4, 8]] == pytest.approx(0.1, abs=1e-4)  # but for what still runs to and fro
    closes(history)


@pytest.mark.parametrize("softness, conductance", [(0.0, 1), (1e-8, 1), (0.3, 1), (0.3, 1e-30)])
def test_a_sealed_film_under_load_is_exact_in_the_steps_that_were_asked_for(shared_tmp, softness, conductance):
    """d exp(c_f p) = 10 everywhere: no fluid runs, so that a tolerance has nothing to shorten steps for. f_n = p - load.

    A film that lets nothing through does the same.
    """
    text = SOFT.format(pressure=0.1).replace("compressibility = 0.1", f"compressibility = {softness}")
    text = text.replace("youngs_modulus = 1e-15", "youngs_modulus = 5")
    text = text.replace("conductance = 1", f"conductance = {conductance}").replace(
        'on = "top"', 'on = "top"\ncomponents = ["x"]\n[[load]]\non = "top"\ntraction = "initial-stress"'
    )
    text += '[[load]]\non = "top"\ntraction = [0, [[0, 0], [2, -3]]]\n' + PROBE % 1.5 + stage("quasi-static", 2.0, 4)
    history, _ = winkler.ran(shared_tmp, np.array([0.0, 1.0, 1.5, 4.0]), text, "accuracy.tolerance=1e-3")
    assert history["time"] == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    p = history["probe/far/pressure"] - 0.1  # k_n = 1: the opening is p less the load
    assert (10.0 + p - 1.5 * history["time"]) * np.exp(softness * p) == pytest.approx(10.0, rel=1e-9)
    assert p[-1] > 0.8
    closes(history)


def driven(rate, end):
    """int_0^end 3 s^2 exp(-rate (end - s)) ds."""
    return 3 * (end**2 / rate - 2 * end / rate**2 + 2 / rate**3 - 2 * np.exp(-rate * end) / rate**3)


def series(x, end, length, spacing=0.0):
    """Pressure at x where it is t^3 at 0 and no fluid leaves at the far end, after Carslaw and Jaeger 3.4.

    With a ``spacing`` the finite series of nodes that far apart, whose storage is lumped.
    """
    count = round(length / spacing) if spacing else 4000
    wave = (2 * np.arange(count) + 1) * np.pi / (2 * length)
    rate, weight = wave**2, 2 / (wave * length)
    if spacing:
        rate = (2 / spacing * np.sin(wave * spacing / 2)) ** 2
        weight = spacing / length / np.tan(wave * spacing / 2)
    return end**3 - np.sum(weight * np.sin(wave * x) * driven(rate, end))


def spread(folder, count, steps, *options, kind="quasi-static"):
    """Pressure at the closed end of a slot of length 1.5 at time 1, and the history."""
    times = np.linspace(0, 1, steps + 1)
    text = LINEAR.format(pressure=0) + PROBE % 1.5 + INFLOW.partition("flow_rate")[0]
    text += f"pressure = {np.stack([times, times**3], 1).tolist()}\n" + stage(kind, 1.0, steps)
    history, _ = winkler.ran(folder, np.linspace(0, 1.5, count + 1), text, *options)
    return history["probe/far/pressure"][-1], history


def test_pressure_spreads_by_the_diffusion_equation(shared_tmp):
    """Order 2 in the spacing, against Fourier's series."""
    wrong = [
        abs(spread(shared_tmp, count, 100, "method.flow_integrator=trapezoid")[0] - series(1.5, 1.0, 1.5))
        for count in (3, 6, 12)
    ]
    assert np.log2(wrong[0] / wrong[1]) == pytest.approx(2, abs=0.15)
    assert np.log2(wrong[1] / wrong[2]) == pytest.approx(2, abs=0.15)
    assert wrong[2] < 1e-3


@pytest.mark.serial
@pytest.mark.parametrize("film", [*FILM, "newmark"])
def test_order_in_time(shared_tmp, film):
    """Against the finite series of the same nodes; a dynamic stage goes by Newmark's gamma."""
    exact, wrong = series(1.5, 1.0, 1.5, 0.25), []
    kind, options = ("dynamic", ()) if film == "newmark" else ("quasi-static", (f"method.flow_integrator={film}",))
    for steps in (20, 40, 80):
        pressure, history = spread(shared_tmp, 6, steps, *options, kind=kind)
        wrong.append(abs(pressure - exact))
        closes(history)
        if film == "newmark":  # no more than the trapezoid loses
            assert np.abs(history["energy/scheme"]).max() <= 1e-12
    assert np.log2(wrong[1] / wrong[2]) == pytest.approx(FILM.get(film, 2), abs=0.15)


@pytest.mark.parametrize("gamma", [0.5, 0.7])
def test_walls_and_fluid_together_in_a_dynamic_stage(shared_tmp, gamma):
    """Cubic law and walls that move: pressure, opening and books of order 2 from the first instant, 1 for gamma > 1/2.

    The fluid begins to flow at once, at rates that the balance gives.
    """
    ends, x = [], np.array([0.0, 1.0, 2.5, 4.0])
    for steps in (20, 40, 80):
        times = np.linspace(0, 1, steps + 1)
        text = SOFT.format(pressure=0.2).replace("aperture = 10\nconductance = 1", "aperture = 2") + PROBE % 4
        text += 'quantities = ["pressure", "opening"]\n' + INFLOW
        text += '[[well]]\nname = "out"\nat = {fracture = "film", end = "end"}\n'
        text += f"pressure = {np.stack([times, 0.2 + np.sin(times)], 1).tolist()}\n"
        text = text.replace("at = [4, 0]", "at = [1, 0]") + stage("dynamic", 1.0, steps)
        history, _ = winkler.ran(shared_tmp, x, text, f"method.newmark_gamma={gamma}", "method.coupling=whole-lu")
        closes(history)
        names = ("probe/far/pressure", "probe/far/opening", "energy/fluid_storage", "energy/work_wells")
        ends.append([history[name][-1] for name in names])
    change = np.abs(np.diff(ends, axis=0))
    assert np.log2(change[0] / change[1]) == pytest.approx(2.0 if gamma == 0.5 else 1.0, abs=0.25)


@pytest.mark.parametrize("film", FILM)
def test_books_from_stage_to_stage(shared_tmp, film):
    """Steady, film and inertia, with an aperture that opens and pressures that jump as a stage begins."""
    text = SOFT.format(pressure=0.2).replace("aperture = 10\nconductance = 1", "aperture = 1.5") + PROBE % 4
    text += '[[well]]\nname = "in"\nat = {fracture = "film", end = "start"}\n'
    text += "pressure = [[0, 0.5], [1, 0.5], [1.000001, 0.1], [2, 0.4], [9, 0.3]]\n"
    for kind in ("steady", "quasi-static", "dynamic", "quasi-static"):
        text += stage(kind, 1.0, 4)
    history, _ = winkler.ran(shared_tmp, np.array([0.0, 1.0, 2.5, 4.0]), text, f"method.flow_integrator={film}")
    largest = closes(history)
    assert np.abs(history["energy/fluid_storage"]).max() > 0.01 * largest
    assert np.diff(history["energy/viscous"]).min() >= 0.0


def test_without_storage_what_compresses_the_fluid_is_outer_work(shared_tmp):
    """No well brings it: V ((exp(c_f p) - 1)/c_f - p) between rigid walls, of which a step takes the mean of its ends."""
    ends = (INFLOW + INFLOW.replace('"in"', '"out"').replace('"start"', '"end"')).replace(
        "flow_rate = 0.3", "pressure = [[0, 0], [1, 2]]"
    )
    history, _ = winkler.ran(
        shared_tmp, np.array([0.0, 1.0, 4.0]), STIFF.format(pressure=0) + ends + stage("steady", 1.0, 40)
    )
    pressure = 2.0 * history["time"]
    assert history["energy/work_pressure"] == pytest.approx(
        40.0 * (np.expm1(0.1 * pressure) / 0.1 - pressure), rel=1e-4, abs=1e-3
    )
    largest = closes(history)
    assert (
        largest == history["energy/fluid_storage"][-1] == pytest.approx(history["energy/work_pressure"][-1], rel=1e-12)
    )
    assert max(abs(history[f"energy/{name}"]).max() for name in ("work_wells", "scheme", "viscous")) < 1e-12 * largest


def test_a_fluid_that_stores_needs_an_aperture(shared_tmp):
    """A conductance of the scene alone says nothing about the volume."""
    comm = MPI.COMM_WORLD
    text = SOFT.format(pressure=0).replace("aperture = 10\n", "") + INFLOW + stage("steady", 1.0, 1)
    file = winkler.write(shared_tmp, comm, np.arange(3.0), text)
    with pytest.raises(InputError, match=r"fracture\.film.aperture: missing; a fluid with compressibility"):
        load(file)


ROW = """
output.pictures = false
rock.rock = {youngs_modulus = 30e9, poissons_ratio = 0.22, density = 2600}
initial_stress = {xx = -10e6, yy = -12e6, xy = 0}
fluid = {viscosity = 1e-3, initial_pressure = 1e6, compressibility = 1e-8}
absorbing = [{on = ["west", "south", "east", "north"]}]
stage = [{kind = "dynamic", time_step = 1e-4, steps = 3}]
[geometry]
domain = [0, 0, 100, 80]
size = 15
fracture = [{name = "kept", points = [[20, 40], [50, 40]]}, {name = "free", points = [[50, 40], [80, 40]]}]
[fracture]
default = {law = "linear", normal_stiffness = 50e9, shear_stiffness = 20e9, aperture = 1e-3}
kept.pressure = {along = [0, 30], value = [1e6, 1e6]}
"""


def test_pressures_kept_along_a_part_of_the_network_leave_it_at_rest(run_scene):
    """As inertia sets in each kept node has a rate of its own, here none: there are fewer of them than nodes."""
    probe = "[[probe]]\nname = 'end'\nat = {fracture = 'free', end = 'end'}\n"
    found = run_scene(ROW + probe)
    assert found.probe("end", "pressure") == pytest.approx(1e6, rel=1e-9)
    assert np.abs(found.probe("end", "flow_rate")).max() < 1e-12
