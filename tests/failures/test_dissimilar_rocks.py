"""F8: between unlike rocks a sliding fault makes waves grow: as the dispersion relation says, capped by k_n; the card warns."""

import json
from dataclasses import replace

import numpy as np
import pytest
from figures_stability.s7 import Waves
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.cli.app import app
from fracflow.integrators import Newmark
from fracflow.laws.base import HELD
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.request import StepRequest

pytestmark = pytest.mark.serial
SCENE = "meshes/failures/dissimilar_rocks/scene.toml"
FRICTION, STIFFNESS, DEPTH, PERIOD = 0.84, 0.1, 10.0, 20.0
SLOW, FAST = (1.0, 0.25, 1.0), (1.44, 0.25, 1.0)  # mu, nu, rho
ALIKE = "fracture.fault.friction_coefficient=0.84"  # no seed


def _compliance(p, mu, nu, rho, depth):
    """Displacement (u_x, u_y) at y = 0 of unit (s_xy, s_yy) on a layer held at y = ``depth``; exp(i x + p t)."""
    lame = 2 * mu * nu / (1 - 2 * nu)
    decay_p, decay_s = (np.sqrt(1 + p * p * rho / modulus + 0j) for modulus in (lame + 2 * mu, mu))

    def shapes(y):
        up, down = ((1j, -decay_p), (1j, decay_p)), ((decay_s, 1j), (-decay_s, 1j))
        rates = np.array([-decay_p, decay_p, -decay_s, decay_s])
        return np.array([*up, *down]).T * np.exp(rates * y), rates

    (u, rates), (far, _) = shapes(0.0), shapes(depth)
    held = np.linalg.svd(far)[2][2:].conj().T
    s_xy = mu * (u[0] * rates + 1j * u[1])
    s_yy = lame * (1j * u[0] + u[1] * rates) + 2 * mu * u[1] * rates
    return u @ held @ np.linalg.inv(np.array([s_xy, s_yy]) @ held)


def _dispersion(wavenumber, guess):
    """P of a wave on the sliding fault between both layers: s_xy = -f s_yy, opening = s_yy/k_n; Newton from ``guess``."""
    depth, stiffness = DEPTH * wavenumber, STIFFNESS / wavenumber

    def gap(p):
        jump = _compliance(p, *SLOW, depth) - _compliance(p, *FAST, -depth)
        return -FRICTION * jump[1, 0] + jump[1, 1] - 1.0 / stiffness

    p = guess / wavenumber
    for _ in range(50):
        slope = (gap(p + 1e-7) - gap(p - 1e-7)) / 2e-7
        p -= gap(p) / slope
    assert abs(gap(p)) < 1e-6 / stiffness
    return p * wavenumber


def _fastest(waves, wavenumber):
    p, shapes = waves.modes(wavenumber)
    chosen = np.argmax(p.real)
    return p[chosen], shapes[:, chosen]


@pytest.fixture(scope="module")
def models():
    return {mesh: prepare(load(SCENE, [f"mesh.file={mesh}.geo", ALIKE]), MPI.COMM_SELF) for mesh in ("coarse", "fine")}


def test_growth_is_that_of_the_dispersion_relation(models):
    """Waves of 20 and 10 cells, of 40 and 20 on half the cells: second order, within 1 % of the growth on the finer one."""
    for number, coarse_limit in ((1, 0.01), (2, 0.04)):
        errors = []
        for mesh in ("coarse", "fine"):
            p, _ = _fastest(Waves(models[mesh]), 2 * np.pi * number / PERIOD)
            exact = _dispersion(2 * np.pi * number / PERIOD, p)
            assert exact.real > 0.08 * STIFFNESS
            errors.append(abs(p - exact) / abs(exact))
            assert p.real == pytest.approx(exact.real, rel=coarse_limit if mesh == "coarse" else 0.01)
        assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_the_stiffness_of_the_joint_caps_the_growth_of_resolved_waves(models):
    """Published: 0.096 k_n c_s/mu; on joints without give growth doubles with the wave number, and the mesh has no say here."""
    for mesh in models:
        waves = Waves(models[mesh])
        cells = 2 * np.pi / waves.wavenumbers / (waves.length / len(waves.places))
        assert waves.growth()[cells >= 5 - 1e-9].max() <= 0.096 * STIFFNESS
    stiff = {}
    for mesh in models:
        model = prepare(
            load(SCENE, [f"mesh.file={mesh}.geo", ALIKE, "fracture.fault.normal_stiffness=100"]), MPI.COMM_SELF
        )
        stiff[mesh] = Waves(model).growth().max()
    capped = {mesh: Waves(model).growth().max() for mesh, model in models.items()}
    assert stiff["fine"] / stiff["coarse"] == pytest.approx(2.0, rel=0.1)
    assert capped["fine"] <= capped["coarse"]  # even of waves of less than five cells


def test_a_seeded_wave_grows_in_a_run_as_its_eigenvalue_says():
    """The trapezoidal rule multiplies it by (1 + p dt/2)/(1 - p dt/2) a step, while the fault slides at a steady rate."""
    dt, steps, speed = 0.5, 120, 0.05
    model = prepare(load(SCENE, [ALIKE, f"initial_stress.xy={FRICTION * (1 - 1e-9)}"]), MPI.COMM_SELF)
    refuse_imbalance(model)
    waves = Waves(model)
    wavenumber = 2 * np.pi / PERIOD
    p, shape = _fastest(waves, wavenumber)
    wave = 1e-5 * np.exp(1j * wavenumber * waves.places)[:, None] * shape
    state, nodes = equilibrium_state(model), model.operators.blocks.solid
    upper = np.unique(nodes.unknown[nodes.piece == nodes.piece[nodes.points[:, 1].argmax()], 0])
    u, v = state.motion.displacement, state.motion.velocity
    v.getArray()[upper] = speed
    u.getArray()[waves.unknowns] += wave.real
    v.getArray()[waves.unknowns] += (p * wave).real
    joints = model.operators.joints
    past = tuple({**history, "sliding": np.ones_like(history["sliding"])} for history in joints.initial_history())
    strain = joints.strain(u)
    sections = replace(joints.evaluate(strain, past, HELD), blur=state.sections.blur, record=state.sections.record)
    state = replace(state, sections=sections)
    stepping, rule = Stepping(model), Newmark()
    now, found = stepping.enter(state, rule, dt), []
    roots, shapes = waves.modes(wavenumber)
    left = np.linalg.inv(shapes[:, : len(shape)])[roots.real.argmax() % len(shape)]
    for step in range(1, steps + 1):
        last = now
        now, _ = stepping.step(last, StepRequest(step * dt, dt, {}, stepping.model.loads), rule)
        last.destroy()
        moved = now.motion.displacement.getArray()[waves.unknowns]
        harmonic = np.exp(-1j * wavenumber * waves.places) @ moved / len(waves.places) * 2
        found.append(left @ harmonic)
    factor = (1 + p * dt / 2) / (1 - p * dt / 2)
    amplitudes = np.abs(np.array(found))
    assert abs(factor) ** (steps - 1) > 1.6
    assert amplitudes[-1] / amplitudes[0] == pytest.approx(abs(factor) ** (steps - 1), rel=0.01)


def test_the_card_warns_of_unlike_rock_and_of_it_only():
    def number(*settings):
        words = [word for setting in settings for word in ("--set", setting)]
        card = json.loads(CliRunner().invoke(app, ["check", SCENE, "--json", *words]).output)["card"]
        return next(each for each in card if each["name"] == "dissimilar rock")

    found = number()
    assert found["value"] == pytest.approx(0.096 * STIFFNESS * 150, rel=1e-9)  # c_s = mu = 1, T = 150
    assert found["out_of_range"] and found["limit"] == 1.0 and found["where"] == "fault"
    assert "1.2 times" in found["remedy"] and "normal_stiffness below 0.069" in found["remedy"]
    assert not number("stage.slide.end=100")["out_of_range"]
    assert number("rock.fast.youngs_modulus=2.5")["value"] is None
    assert number("fracture.fault={law = 'linear', normal_stiffness = 1, shear_stiffness = 1}")["value"] is None
