"""Steppers with inertia through the whole program: a rod with a joint, against the algebra of the papers in NumPy."""

import numpy as np
import pytest

DENSITY, STIFF, JOINT, PUSH = 2.0, 3.0, 5.0, 0.7
ROD = f"""
units = "none"
[output]
pictures = false
[rock.rock]
youngs_modulus = {STIFF}
poissons_ratio = 0
density = {DENSITY}
[geometry]
domain = [0, 0, 2, 1]
size = 1
cells = "quads"
[[geometry.fracture]]
name = "joint"
points = [[1, 0], [1, 1]]
[fracture.joint]
law = "linear"
normal_stiffness = {JOINT}
shear_stiffness = {JOINT}
[[support]]
on = ["north", "south"]
components = ["y"]
[[support]]
on = "west"
components = ["x"]
[[load]]
on = "east"
traction = [{PUSH}, 0]
[[probe]]
name = "end"
at = [2, 0]
[[probe]]
name = "joint"
at = [1, 0]
on = "joint"
[[stage]]
kind = "dynamic"
time_step = 0.1
end = 4
"""
# two elements of length 1/2 on each side (all-quad meshes halve the size asked for); unknowns at x = 1/2, the joint's left
# and right face, 3/2 and the end; per unit height, masses lumped
MASS = DENSITY * np.array([0.5, 0.25, 0.25, 0.5, 0.25])
CHAIN = np.array([2 * STIFF, JOINT, 2 * STIFF, 2 * STIFF])
SPRING = (
    np.diag([4 * STIFF, 2 * STIFF + JOINT, 2 * STIFF + JOINT, 4 * STIFF, 2 * STIFF])
    - np.diag(CHAIN, 1)
    - np.diag(CHAIN, -1)
)
FORCE = np.array([0.0, 0.0, 0.0, 0.0, PUSH])
# scheme: scene settings; beta, gamma, share of the old acceleration and of the old forces
SCHEMES = {
    "newmark": ((), (0.25, 0.5, 0.0, 0.0)),
    "newmark damped": (("method.newmark_gamma=0.7", "method.newmark_beta=0.36"), (0.36, 0.7, 0.0, 0.0)),
    "hht": (("method.hht_alpha=-0.2",), (0.36, 0.7, 0.0, 0.2)),
    "generalised-alpha": (("method.rho_infinity=0.5",), (4 / 9, 5 / 6, 0.0, 1 / 3)),
    "generalised-alpha stiff": (("method.rho_infinity=0",), (1.0, 1.5, -1.0, 0.0)),
    "implicit-euler": ((), None),
}


def settings(name):
    return (f"method.stepper={name.partition(' ')[0]}", *SCHEMES[name][0])


def exact(times):
    """u'' M + K u = F from rest, by modes."""
    root = np.sqrt(MASS)
    values, vectors = np.linalg.eigh(SPRING / np.outer(root, root))
    still = np.linalg.solve(SPRING, FORCE)
    return still - (np.cos(np.outer(times, np.sqrt(values))) * (vectors.T @ (root * still))) @ vectors.T / root


def marched(name, dt, steps):
    """Displacement, velocity after each step, as the papers write the scheme down."""
    u, v, a = np.zeros(5), np.zeros(5), FORCE / MASS
    out = [(u, v)]
    for _ in range(steps):
        if SCHEMES[name][1] is None:
            new = np.linalg.solve(np.diag(MASS) / dt**2 + SPRING, FORCE + MASS * (u / dt**2 + v / dt))
            u, v, a = new, (new - u) / dt, ((new - u) / dt - v) / dt
        else:
            beta, gamma, m, f = SCHEMES[name][1]
            guess = u + dt * v + dt**2 * (0.5 - beta) * a
            left = (1 - m) * np.diag(MASS) + (1 - f) * beta * dt**2 * SPRING
            right = FORCE - m * MASS * a - (1 - f) * SPRING @ guess - f * SPRING @ u
            new = np.linalg.solve(left, right)
            u, v, a = guess + dt**2 * beta * new, v + dt * ((1 - gamma) * a + gamma * new), new
        out.append((u, v))
    return np.array(out)


@pytest.mark.parametrize("name", SCHEMES)
def test_rod_with_a_joint_moves_as_the_scheme_says(run_scene, name):
    """Motion to round-off; and the books give the scheme what the energy of rod, joint and load has lost."""
    found = run_scene(ROD, *settings(name))
    motion = marched(name, 0.1, 40)
    u, v = motion[:, 0], motion[:, 1]
    assert found.probe("end", "displacement")[:, 0] == pytest.approx(u[:, 4], rel=1e-9, abs=1e-12)
    assert found.probe("joint", "opening") == pytest.approx(u[:, 2] - u[:, 1], rel=1e-9, abs=1e-11)
    total = 0.5 * (v**2 @ MASS) + 0.5 * np.einsum("ni,ij,nj->n", u, SPRING, u) - u @ FORCE
    largest = np.abs(found.history["energy/work_boundaries"]).max()
    assert found.history["energy/scheme"] == pytest.approx(-total, abs=1e-11 * largest)
    if name in ("newmark", "hht"):
        assert np.abs(total[-1]) <= (1e-12 if name == "newmark" else 0.1) * largest
    else:
        assert found.history["energy/scheme"][-1] > 1e-4 * largest
    assert found.closes()


@pytest.mark.serial
@pytest.mark.parametrize("name, order", [("newmark", 2), ("hht", 2), ("generalised-alpha", 2), ("implicit-euler", 1)])
def test_order_on_the_rod(run_scene, name, order):
    errors = []
    for dt in (0.02, 0.01) if order == 1 else (0.1, 0.05, 0.025):
        found = run_scene(ROD, *settings(name), f"stage.0.time_step={dt}", "stage.0.end=2")
        right = exact(found.history["time"])[:, 4]
        errors.append(np.abs(found.probe("end", "displacement")[:, 0] - right).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(order, abs=0.12), errors


@pytest.mark.parametrize("name", SCHEMES)
def test_books_close_through_slip_opening_and_a_moving_support(run_scene, name):
    """A joint that slides and opens, a side moved by jerks, a film, sides that absorb: nothing is left over."""
    scene = """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
[geometry]
domain = [0, 0, 4, 3]
size = 0.8
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 2]]
[fracture.crack]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_angle_deg = 20
[initial_stress]
xx = -5e6
yy = -5e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
[[support]]
on = "south"
[[support]]
on = "north"
displacement = {x = [[0, 0], [2e-4, 0], [1e-3, 3e-3]], y = [[0, 0], [5e-4, 1.5e-3], [1e-3, 1.5e-3]]}
[[absorbing]]
on = ["east", "west"]
[[well]]
name = "in"
at = {fracture = "crack", end = "start"}
pressure = 2e6
[[well]]
name = "out"
at = {fracture = "crack", end = "end"}
pressure = "initial"
[[stage]]
kind = "dynamic"
time_step = 1e-4
steps = 10
"""
    found = run_scene(scene, *settings(name))
    assert found.history["step/slipping"].max() > 0 and found.history["step/open"].max() > 0
    assert found.history["energy/friction"][-1] > 0.0 and found.history["energy/radiated"][-1] > 0.0
    assert found.closes()


@pytest.mark.parametrize("name", ["newmark", "hht", "generalised-alpha", "generalised-alpha stiff", "implicit-euler"])
def test_a_motion_given_up_is_dropped_whatever_the_scheme(run_scene, name):
    """v M v/2 and the energy of u about the rest; schemes that look back leave M a that is not -S."""
    found = run_scene(
        ROD,
        *settings(name),
        "stage=[{kind='dynamic', time_step=0.1, steps=13}, {kind='quasi-static', time_step=1, steps=1}]",
    )
    u, v = marched(name, 0.1, 13)[-1]
    off = u - np.linalg.solve(SPRING, FORCE)
    moving = 0.5 * (v**2 @ MASS) + 0.5 * off @ SPRING @ off
    assert found.history["energy/dropped"][-1] == pytest.approx(moving, rel=1e-9)
    assert moving > 0.05 and found.closes()
