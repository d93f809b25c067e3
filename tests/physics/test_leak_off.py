"""Leak-off into the rock behind the walls, against Laplace transforms, and its memory on ranks and over a stop."""

import numpy as np
import pytest
from scipy.special import erfc

from fracflow.api import open as opened
from fracflow.errors import InputError
from fracflow.laws.leak_off import exponentials, leak_off_coefficient, leaked_volume, memory_after
from fracflow.model.terms.leak_off import kernel_of
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

from .test_along_fractures import RIGID

D0, SOFT, MU, LENGTH, JUMP = 1e-4, 1e-8, 1e-3, 3.0, 1e4
SCENE = (
    RIGID.replace('{along = [0, 3], value = ["1 mm", "0.25 mm"]}', f'"{D0} m"')
    .replace("viscosity = 1e-3", f"viscosity = {MU}\ncompressibility = {SOFT}")
    .replace("size = 0.5", "size = 0.05")
    .replace('kind = "steady"', 'kind = "quasi-static"')
    + f"""
[fracture.slot.leak_off]
permeability = 1
storage = 1
[[well]]
name = "in"
at = {{fracture = "slot", end = "start"}}
pressure = {JUMP}
"""
)
DIFFUSED = D0**2 / (12 * MU * SOFT)  # of the fracture [m^2/s]
TIME = 0.04 * LENGTH**2 / DIFFUSED  # in which a pressure comes half through it


def inverted(transform, time, terms=32):
    """f(t) of a Laplace transform by the fixed Talbot contour (Abate and Valko 2004)."""
    r = 2.0 * terms / (5.0 * time)
    theta = np.arange(1, terms) * np.pi / terms
    s = r * theta * (1.0 / np.tan(theta) + 1j)
    sigma = theta + (theta / np.tan(theta) - 1.0) / np.tan(theta)
    return (
        r
        / terms
        * (0.5 * np.exp(r * time) * transform(r).real + (np.exp(time * s) * transform(s) * (1 + 1j * sigma)).real.sum())
    )


def leaking(b, steps=(40, 99)):
    """Settings of a scene with this b, in short steps first: dimensionless times end at 1."""
    storage = 1e-10
    permeability = MU * (b * D0 * SOFT) ** 2 / TIME / storage
    short, long = TIME / 100 / steps[0], 0.99 * TIME / steps[1]
    stage = [f"{{kind='quasi-static', time_step={dt!r}, steps={n}}}" for dt, n in ((short, steps[0]), (long, steps[1]))]
    given = [f"fracture.slot.leak_off={{permeability={permeability!r}, storage={storage!r}}}"] if b else []
    return [f"stage=[{', '.join(stage)}]", *given]


@pytest.mark.parametrize("b", [0.0, 0.5, 2.0])
def test_pressure_in_a_fracture_that_leaks(run_scene, b):
    """p = L^-1 exp(-X sqrt(s + 2 b sqrt(s)))/s at T = 1; without leak-off erfc(X/2)."""
    scene = SCENE if b else SCENE.replace("[fracture.slot.leak_off]\npermeability = 1\nstorage = 1\n", "")
    found = run_scene(scene, *leaking(b))
    x = 0.75 / np.sqrt(DIFFUSED * TIME)
    exact = inverted(lambda s: np.exp(-x * np.sqrt(s + 2.0 * b * np.sqrt(s))) / s, 1.0)
    if not b:
        assert exact == pytest.approx(erfc(x / 2.0), rel=1e-9)
    assert found.probe("quarter", "pressure")[-1] / JUMP == pytest.approx(exact, rel=5e-3)
    assert (
        found.closes()
        and np.abs(found.history["volume/unaccounted"]).max() < 1e-13 * found.history["volume/injected"][-1]
    )


@pytest.mark.parametrize(("rule", "order"), [("backward-euler", 1.0), ("bdf2", 2.0), ("trapezoid", 2.0)])
def test_each_rule_has_its_order(run_scene, rule, order):
    """With a pressure that rises evenly, on one mesh; the fluid that leaks is exact for pressures that change evenly."""
    rising = SCENE.replace(f"pressure = {JUMP}", f"pressure = [[0, 0], [{TIME!r}, {JUMP}]]").replace("0.05", "0.5")
    leak, found = leaking(0.5)[1], []
    for steps in (10, 20, 40):
        stage = f"stage=[{{kind='quasi-static', time_step={TIME / steps!r}, steps={steps}}}]"
        ran = run_scene(rising, leak, stage, f"method.flow_integrator='{rule}'")
        assert ran.closes()
        found.append(ran.probe("quarter", "pressure")[-1])
    coarse, fine = np.abs(np.diff(found))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


def test_the_sum_of_exponentials():
    """1/sqrt(pi t) over nine decades; what leaks under an even rise of pressure, as one step or as a thousand."""
    kernel, times = exponentials(1e-3, 1e6), np.logspace(-3, 6, 50)
    assert kernel.kernel(times) * np.sqrt(np.pi * times) == pytest.approx(1.0, abs=2e-4) and len(kernel.rates) < 40
    for steps in (1, 1000):
        memory, volume = np.zeros((1, len(kernel.rates))), 0.0
        for _ in range(steps):
            change = np.full(1, 1.0 / steps)
            volume += leaked_volume(kernel, memory, change, 1.0 / steps)[0][0]
            memory = memory_after(kernel, memory, change, 1.0 / steps)
        assert volume == pytest.approx(4.0 / 3.0 / np.sqrt(np.pi), rel=3e-4)
    assert leak_off_coefficient(np.array(4e-18), np.array(1e-10), 1e-3) == pytest.approx(
        4.0 * np.sqrt(1e-25), rel=1e-12
    )


@pytest.mark.parametrize("stepper", ["newmark", "explicit"])
def test_with_inertia_and_events_over_a_stop(shared_tmp, comm, stepper):
    """A steady stage, then waves in leaking fractures: books close, and a run that was cut goes on as it would have."""
    leak = "fracture.default.leak_off={permeability='1e-15 m^2', storage='1e-9 1/Pa'}"
    steps = "stage.1.steps=8" if stepper == "newmark" else "stage.1.steps=4"
    given = load(
        "meshes/crossings/scene.toml", [leak, f"method.stepper='{stepper}'", steps, "output.checkpoint_every=1"]
    )
    run(given, shared_tmp / "whole", comm)
    comm.barrier()
    middle = float(np.median(opened(shared_tmp / "whole").history["time"]))

    def stop(step):
        if step.state.time > middle:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(given, shared_tmp / "cut", comm, progress=stop)
    comm.barrier()
    resume(shared_tmp / "cut", comm)
    comm.barrier()
    one, other = (opened(shared_tmp / name).history for name in ("whole", "cut"))
    for key in (key for key in one if not key.startswith("step/")):
        if comm.size == 1:
            assert np.array_equal(one[key], other[key], equal_nan=True), key
        elif key.endswith(("/leak_off", "/pressure", "/volume")):  # sums of messages in any order
            assert np.allclose(one[key], other[key], rtol=0.0, atol=1e-6 * np.abs(one[key]).max()), key
    largest = max(np.abs(one[key]).max() for key in one if key.startswith("energy/"))
    assert np.abs(one["energy/residual"]).max() < 1e-10 * largest and one["volume/leak_off"].any()
    passed = max(np.abs(one[key]).max() for key in one if key.startswith("volume/"))
    assert np.abs(one["volume/unaccounted"]).max() < 1e-10 * passed


CLOSED = """
output = {pictures = false, vtkhdf = false, checkpoint_every = 1}
rock.rock = {youngs_modulus = 5e10, poissons_ratio = 0.25, density = 2700}
initial_stress = {xx = -30e6, yy = -30e6, zz = -30e6, xy = 14.9e6}
fluid = {viscosity = 1e-3, initial_pressure = 5e6, compressibility = 4.5e-10}
well = [{name = "in", at = {fracture = "f", fraction = 0.5}, flow_rate = 1e-7}]
probe = [{name = "middle", at = {fracture = "f", fraction = 0.5}}]
geometry = {domain = "unbounded", size = 1, fracture = [{name = "f", points = [[0, 0], [3, 0]]}]}
stage = [{kind = "quasi-static", time_step = 1000, steps = 15}]
[fracture.f]
normal_stiffness = 1e14
shear_stiffness = 1e14
aperture = 1e-4
friction_coefficient = 0.6
leak_off = {permeability = 1e-15, storage = 1e-10}
"""
STATE = """
law = "rate-and-state"
reference_slip_rate = 1e-6
direct_effect = 0.01
evolution_effect = 0.005
characteristic_slip = 1e-5
initial_slip_rate = 1e-7
"""


def over_exact(found):
    """Pressure that a rate Q gives over (Q/L) sqrt(mu t/(pi k S)), that of half spaces under a uniform flux."""
    time, pressure = found["time"][1:], found["probe/middle/pressure"][1:] - 5e6
    return time, pressure / (1e-7 / 3 * np.sqrt(1e-3 * time / (np.pi * 1e-25)))


AUTO = "stage=[{kind='auto', time_step=1e5, end=1e6}]", "geometry.domain=[-3, -3, 6, 3]"


@pytest.mark.parametrize("asked", [(), AUTO, ("accuracy.tolerance=1e-3",)])
def test_substeps_far_shorter_than_a_step(tmp_path, asked):
    """Those that slip, events or errors ask for: the memory is as fast as they are."""
    (tmp_path / "scene.toml").write_text(CLOSED + ("" if asked else STATE))
    kernel = kernel_of(load(tmp_path / "scene.toml", asked))
    times = np.logspace(-4.0, 4.0, 20)
    assert kernel.kernel(times) * np.sqrt(np.pi * times) == pytest.approx(1.0, abs=2e-4)


@pytest.mark.filterwarnings("ignore:.*the scene as it is now")
@pytest.mark.parametrize(
    ("old", "new", "refused"),
    [
        ("steps = 15", "steps = 40", ""),
        ("time_step = 1000", "time_step = 1300", "amid this stage at time 9000, where its steps now are at 11700"),
        ('units = "SI"', 'units = "m-kN-s"', "units: the run began in m, N, s, and has m, kN, s now"),
    ],
)
def test_other_times_after_a_stop(shared_tmp, comm, old, new, refused):
    """More steps need slower exponentials of the memory; longer ones would not begin where it was stopped.

    The state and the mesh are numbers in the units that the run began with: pressures became a thousand times higher.
    """
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(CLOSED)
    comm.barrier()

    def stop(step):
        if step.state.time > 9500.0:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(load(shared_tmp / "scene.toml"), shared_tmp / "cut", comm, progress=stop)
    comm.barrier()
    if comm.rank == 0:
        written = shared_tmp / "cut" / "scene.toml"
        text = written.read_text().replace("1000.0", "1000")
        assert old in text
        written.write_text(text.replace(old, new))
    comm.barrier()
    if refused:
        with pytest.raises(InputError, match=refused):
            resume(shared_tmp / "cut", comm)
        return
    resume(shared_tmp / "cut", comm)
    comm.barrier()
    ratio = over_exact(opened(shared_tmp / "cut").history)[1]
    assert len(ratio) == 40 and np.abs(np.diff(ratio[5:])).max() < 1e-3 and ratio[-1] == pytest.approx(1.0, rel=2e-3)


def test_steady_stages_that_take_no_time(run_scene):
    found = run_scene(CLOSED.replace("flow_rate = 1e-7", "pressure = 6e6"), "stage=[{kind='steady', steps=1}]")
    assert found.probe("middle", "pressure")[-1] == 6e6


def test_where_no_fluid_is_modelled_it_is_refused(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.replace(f"viscosity = {MU}", "viscosity = 0"))
    with pytest.raises(InputError, match=r"fracture\.slot\.leak_off: needs \[fluid\]"):
        load(scene)
