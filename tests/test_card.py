"""The scene card against the numbers published for report example 3, and against what the scene's own matrices do."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.diagnostics import fracture_flow as flow
from fracflow.diagnostics import pre_run_checks
from fracflow.diagnostics.number import FlowStage
from fracflow.errors import InputError
from fracflow.model.setup import place
from fracflow.reduction.prepare import prepare, read_split
from fracflow.scene.scene import Scene, load

pytestmark = pytest.mark.serial

REPORT_5_3 = "meshes/report_5_3/scene.toml"


def card_of(file, *overrides):
    scene = load(file, list(overrides))
    mesh = read_split(scene)
    return {number.name: number for number in pre_run_checks(scene, mesh, place(scene, mesh).wells)}


def test_report_example_3_has_the_published_numbers():
    card = card_of(REPORT_5_3)
    assert len(card) == 12
    assert card["joint/rock stiffness"].value == pytest.approx(188, abs=0.5)
    assert card["joint length scale"].value == pytest.approx(188, abs=0.5)
    assert card["coupling, steady"].value == pytest.approx(0.09, abs=0.0005)
    assert 0.005 < card["pressure ringing"].value < 0.02
    assert card["fluid inertia"].value == pytest.approx(0.69, abs=0.005)
    assert card["fluid compressibility"].value == pytest.approx(0.022, abs=0.0005)
    assert card["nucleation length"].value == 0.0
    assert {name for name, number in card.items() if number.out_of_range} == {
        "joint length scale", "joint time step", "fluid inertia", "nucleation length",
    }  # fmt: skip
    assert all(bool(number.remedy) == number.out_of_range for number in card.values())
    assert all("fault" in number.where for number in card.values() if number.value is not None)
    assert {name for name, number in card.items() if number.value is None} == {"cohesive zone", "dissimilar rock"}


def test_joint_time_step_takes_the_mass_of_the_walls_there_are():
    # published: 2.8, for cells as deep as joints are long; those of 5.3 are twice as deep, those of 5.4 are 1000 ft deep
    assert card_of("meshes/report_5_4/scene.toml")["joint time step"].value == pytest.approx(2.8, abs=0.01)
    model = prepare(load(REPORT_5_3), MPI.COMM_SELF)
    ops = model.operators
    stiff, mass = _dense_tangent(ops), np.diag(_dense(ops.mass))
    joints = stiff - _dense(ops.stiffness)
    jump = np.zeros(len(mass))  # all of the east wall moves off: the joint alone pulls back
    normal = np.flatnonzero(np.abs(joints).sum(axis=1) > 0)
    normal = normal[normal % 2 == 0]  # x is the normal of this fault
    wall = _dense(ops.joints.jump)[1::2]
    jump[normal] = np.sign(wall.sum(axis=0)[normal])
    frequency = np.sqrt((jump @ joints @ jump) / (jump @ (mass * jump)))
    assert card_of(REPORT_5_3)["joint time step"].value == pytest.approx(0.01 * frequency, rel=1e-9)


@pytest.mark.parametrize(("length", "published"), [(1000, 53.9), (2000, 216), (4000, 865)])
def test_coupling_factor_is_the_published_one_where_walls_send_off_waves(length, published):
    stage, kappa = FlowStage("", 0.01, 200.0, 4e4, True), np.pi / length
    modulus, wave = 5e8 / (1 - 0.25**2), np.sqrt(6e8 / 5.12)
    joints = SimpleNamespace(modulus=modulus, impedance=5.12 * wave / 2, mass=0.0)
    stiff = flow.wall_stiffness(joints, 1e8, kappa, stage)
    assert flow.coupling_factor(200.0, 0.01**3 / (12 * 0.235e-4), kappa, stiff) == pytest.approx(published, rel=2e-3)


@pytest.mark.parametrize(("length", "depth", "measured"), [(1000, 125, 53.4), (2000, 250, 203), (4000, 500, 734)])
def test_coupling_factor_with_the_mass_of_cells_is_that_measured(length, depth, measured):
    """Measured in 2-D with eight cells along the fault; at 0.01 s a wave is still in its cell of the longest."""
    stage, kappa = FlowStage("", 0.01, 200.0, 4e4, True), np.pi / length
    modulus, wave = 5e8 / (1 - 0.25**2), np.sqrt(6e8 / 5.12)
    joints = SimpleNamespace(modulus=modulus, impedance=5.12 * wave / 2, mass=5.12 * depth / 4)
    stiff = flow.wall_stiffness(joints, 1e8, kappa, stage)
    assert flow.coupling_factor(200.0, 0.01**3 / (12 * 0.235e-4), kappa, stiff) == pytest.approx(measured, rel=0.012)


def test_coupling_factor_of_the_card_is_that_of_the_matrices():
    """On four joints the slowest mode is (2 - 2 cos kappa h)/(kappa h)^2 slower than in a continuum."""
    model = prepare(load(REPORT_5_3), MPI.COMM_SELF)
    ops = model.operators
    held = np.zeros(ops.layout.solid_count, dtype=bool)
    held[np.concatenate([part.numbers for part in model.loads.supports])] = True
    walls = np.linalg.inv((_dense_tangent(ops) + 4e4 * _dense(ops.mass))[~held][:, ~held])
    push = _dense(ops.flow.pressure_load)[~held]
    pressure = ops.layout.flow_vector()
    network, each = np.zeros((5, 5)), 0.01**3 / (12 * 0.235e-4 * 1000)
    for ends in ops.blocks.joints.flow:
        network[np.ix_(ends, ends)] += each * np.array([[1, -1], [-1, 1]])
    free = np.setdiff1d(np.arange(5), np.concatenate([part.numbers for part in model.loads.pressures]))
    cycle = np.linalg.solve(network[np.ix_(free, free)], (200.0 * push.T @ walls @ push)[np.ix_(free, free)])
    angle = np.pi / 4
    found = card_of(REPORT_5_3)["coupling, transient"].value * angle**2 / (2 - 2 * np.cos(angle))
    assert len(free) == 3
    assert found == pytest.approx(np.abs(np.linalg.eigvals(cycle)).max(), rel=0.01)
    pressure.destroy()


@pytest.mark.parametrize(
    ("number", "overrides", "remedy"),
    [
        ("joint/rock stiffness", ["method.quadrature=gauss2"], "nodal"),
        ("joint/rock stiffness", ["method.quadrature=one-point"], "nodal"),
        ("coupling, transient", ["method.coupling=fixed-point"], "monolithic"),
        ("aperture contrast", [
            "method.conductance=report",
            "fracture.fault.aperture={along = [0, 4000], value = [0.01, 0.002]}",
        ], "exact"),
        ("pressure ringing", ["stage.failure.time_step=10"], "time_step below"),
        ("pressure ringing", [
            "stage.failure.kind=quasi-static", "stage.failure.time_step=10", "method.flow_integrator=trapezoid",
        ], "backward-euler"),
    ],
)  # fmt: skip
def test_a_limit_warns_only_where_its_method_is_used(number, overrides, remedy):
    assert not card_of(REPORT_5_3)[number].out_of_range
    found = card_of(REPORT_5_3, *overrides)[number]
    assert found.out_of_range and found.value > found.limit and remedy in found.remedy


def test_no_line_asks_for_steps_that_another_refuses():
    """Cycles need steps 900 times as long; from 70 times on pressures ring, but by backward Euler."""
    short = ["method.coupling=fixed-point"]
    cycles = card_of(REPORT_5_3, *short)["coupling, transient"]
    assert "monolithic" in cycles.remedy and "ring" in cycles.remedy and "time_step above" not in cycles.remedy
    free = card_of(REPORT_5_3, *short, "stage.failure.kind=quasi-static")["coupling, transient"]
    assert "time_step above" in free.remedy
    long = card_of(REPORT_5_3, *short, f"stage.failure.time_step={0.01 * cycles.value / cycles.limit}")
    assert long["pressure ringing"].out_of_range


@pytest.mark.parametrize("setting", ["method.on_divergence=monolithic", "method.fixed_point=anderson"])
def test_what_takes_care_of_divergence_is_no_warning(setting):
    found = card_of(REPORT_5_3, "method.coupling=fixed-point", setting)["coupling, transient"]
    assert found.value > 100 and not found.out_of_range and found.note


def test_backward_euler_does_not_ring():
    found = card_of(REPORT_5_3, "stage.failure.kind=quasi-static", "stage.failure.time_step=10")["pressure ringing"]
    assert found.value > 1 and not found.out_of_range


@pytest.mark.parametrize("given", ["neither", "wide", "both"])
def test_where_pressure_is_prescribed_no_film_rings_and_no_fluid_has_inertia(given):
    """A wide fracture beside a narrow one: the warnings are of those whose film has an equation."""
    prescribed = {"pressure": [[0.0, 0.0], [1.0, 1e5]]}
    joint = {"normal_stiffness": 1e10, "shear_stiffness": 5e9, "friction_angle_deg": 30.0}
    scene = Scene.from_data({
        "geometry": {"domain": [0, 0, 10, 10], "size": 4, "fracture": [
            {"name": "wide", "points": [[2, 3], [8, 3]]}, {"name": "narrow", "points": [[2, 7], [8, 7]]}]},
        "rock": {"rock": {"youngs_modulus": 1e10, "poissons_ratio": 0.25, "density": 2500.0}},
        "fracture": {"wide": joint | {"aperture": 1e-2} | (prescribed if given != "neither" else {}),
                     "narrow": joint | {"aperture": 2e-3} | (prescribed if given == "both" else {})},
        "fluid": {"viscosity": 1e-3, "density": 1e3},
        "initial_stress": {"xx": -1e7, "yy": -1e7},
        "stage": [{"kind": "dynamic", "time_step": 1e-3, "end": 1.0}],
    })  # fmt: skip
    mesh = read_split(scene)
    card = {number.name: number for number in pre_run_checks(scene, mesh, {})}
    for name in ("pressure ringing", "fluid inertia"):
        assert card[name].out_of_range == (given != "both"), card[name]
        assert card[name].where.partition(",")[0] == {"neither": "wide", "wide": "narrow", "both": ""}[given]
    assert (card["pressure ringing"].note == "pressure is prescribed everywhere") == (given == "both")


def test_without_a_drop_of_strength_slip_needs_no_length():
    card = card_of(REPORT_5_3, "fracture.fault.stick_slip_ratio=1")
    assert not card["joint length scale"].out_of_range and not card["nucleation length"].out_of_range
    assert card["nucleation length"].value is None


FAULT = {
    "geometry": {
        "domain": [-20e3, -12e3, 20e3, 12e3], "size": 200.0, "cells": "quads",
        "fracture": [{"name": "fault", "points": [[-15e3, 0.0], [15e3, 0.0]]}],
    },
    "rock": {"rock": {"youngs_modulus": 80.1e9, "poissons_ratio": 0.25, "density": 2670.0}},
    "initial_stress": {"yy": -120e6, "xy": 70e6},
    "fracture": {"fault": {
        "law": "slip-weakening", "normal_stiffness": 1e12, "shear_stiffness": 1e12, "aperture": 1.0,
        "friction_coefficient": 0.677, "dynamic_friction_coefficient": 0.525, "slip_weakening_distance": 0.4,
    }},
    "stage": [{"kind": "dynamic", "time_step": 0.01, "steps": 600}],
}  # fmt: skip


def test_lengths_of_a_fault_that_weakens_with_slip():
    """mu* = 42.7 GPa, dtau = 0.152 x 120 MPa: Lambda_0 = (9 pi/32) mu* D_c/dtau = 828 m and L_c = 1.158 mu* D_c/dtau."""
    scene = Scene.from_data(FAULT)
    mesh = read_split(scene)
    card = {number.name: number for number in pre_run_checks(scene, mesh, {})}
    ratio = 80.1e9 / 2.5 / 0.75 * 0.4 / (0.152 * 120e6)
    zone, nucleation = card["cohesive zone"], card["nucleation length"]
    assert zone.value == pytest.approx(9 * np.pi / 32 * ratio / 200.0, rel=1e-6)
    assert not zone.out_of_range and zone.limit == 4.0
    assert nucleation.value == pytest.approx(1.158 * ratio, rel=1e-6)
    assert nucleation.limit == pytest.approx(1000.0) and not nucleation.out_of_range
    assert card["dissimilar rock"].value is None
    shorter = FAULT | {"fracture": {"fault": FAULT["fracture"]["fault"] | {"slip_weakening_distance": 0.3}}}
    card = {number.name: number for number in pre_run_checks(Scene.from_data(shorter), mesh, {})}
    assert card["cohesive zone"].out_of_range and card["nucleation length"].out_of_range
    length = 9 * np.pi / 32 * ratio
    finer, longer = 0.75 * length / 4.0, 0.4 * 800.0 / length
    assert (
        f"joints shorter than {finer:.3g} m, or slip_weakening_distance above {longer:.3g} m"
        in card["cohesive zone"].remedy
    )
    assert "fault" in card["cohesive zone"].where


def test_between_rigid_blocks_slip_that_weakens_has_no_length():
    """mu* D_c/dtau is infinite: no mesh could resolve it badly."""
    weakens = (
        "{law='slip-weakening', normal_stiffness=1, shear_stiffness=0.5, aperture=1, initial_normal_traction=-1,"
        " friction_coefficient=0.6, dynamic_friction_coefficient=0.5, slip_weakening_distance=1.5}"
    )
    card = card_of("meshes/report_5_2/scene.toml", f"fracture.default={weakens}")
    for name in ("nucleation length", "cohesive zone"):
        assert card[name].value is None and not card[name].out_of_range and card[name].note == "rigid rock"


def test_a_network_that_nothing_drains_has_no_fixed_point(tmp_path):
    found = card_of("meshes/crossings/scene.toml")["coupling, transient"]
    assert found.value == np.inf and not found.out_of_range


def test_what_is_infinite_is_null_for_scripts_with_its_text_beside():
    from fracflow.cli.app import app

    scene = "meshes/crossings/scene.toml"  # nothing drains it: rho_t is infinite

    def strict(word):
        raise AssertionError(f"{word} is no JSON")

    found = CliRunner().invoke(app, ["check", scene, "--json", "--set", "method.coupling=fixed-point"])
    numbers = {number["name"]: number for number in json.loads(found.output, parse_constant=strict)["card"]}
    assert all(not isinstance(number[key], str) for number in numbers.values() for key in ("value", "limit"))
    infinite = numbers["coupling, transient"]
    assert infinite["value"] is None and infinite["value_text"] == "inf" and infinite["limit"] == 0.5
    assert infinite["out_of_range"] and "no pressure is prescribed" in infinite["remedy"]
    shown = CliRunner().invoke(app, ["check", scene, "--set", "method.coupling=fixed-point"]).output
    assert any("coupling, transient" in line and " inf " in line for line in shown.splitlines())


@pytest.mark.parametrize("given, out", [("0.45 1/GPa", False), ("9e-7 1/Pa", False), ("1e-5 1/Pa", True)])
def test_a_fluid_as_compressible_as_a_gas_is_flagged(given, out):
    found = card_of(REPORT_5_3, f"fluid.compressibility={given}")["fluid compressibility"]
    share = float(given.split()[0]) * (1e-9 if "GPa" in given else 1.0)
    assert found.out_of_range is out and ("bar" in found.remedy) is out
    assert found.limit == (pytest.approx(found.value * 1e-6 / share) if out else None)


def test_a_bulk_modulus_in_place_of_a_compressibility_is_refused():
    with pytest.raises(
        InputError, match=r"fluid.compressibility = 4.59e7: is 9.59e\+05 1/Pa, .* 4.5e-10 1/Pa for water"
    ):
        load(REPORT_5_3, ["fluid.compressibility=4.59e7"])  # lbf/ft^2, of water


def test_the_card_is_printed_logged_and_stored(tmp_path):
    import fracflow
    from fracflow.cli.app import app

    asked = ["--set", "output.pictures=false", "--set", "stage.failure.steps=1"]
    shown = CliRunner().invoke(app, ["run", REPORT_5_3, "-o", str(tmp_path / "run"), *asked])
    assert shown.exit_code == 0
    lines = shown.output.splitlines()
    start = next(n for n, line in enumerate(lines) if "Pre-run checks" in line)
    rows = lines[start + 2 : start + 14]
    assert sum(row.startswith("!") for row in rows) == 4
    assert "joint time step" in rows[5] and "1.98" in rows[5] and "fault, failure" in rows[5]
    assert [line.split(":")[0] for line in lines[start + 14 : start + 18]] == [
        "! joint length scale", "! joint time step", "! fluid inertia", "! nucleation length",
    ]  # fmt: skip
    ran = fracflow.open(tmp_path / "run")
    checked = CliRunner().invoke(app, ["check", REPORT_5_3, "--json", *asked])
    assert ran.card == json.loads(checked.output)["card"]
    assert ran.card[0]["name"] == "joint/rock stiffness" and len(ran.card) == 12
    assert {decision["part"] for decision in ran.plan} >= {"flow", "inertia"}
    log = (tmp_path / "run" / "log.txt").read_text().splitlines()
    assert sum(line.startswith("check: ") for line in log) == 12


def _dense(matrix):
    return matrix.convert("dense").getDenseArray().copy()


def _dense_tangent(ops):
    rest = ops.joints.evaluate(np.zeros((len(ops.joints.weights), 2)), ops.joints.initial_history())
    total = _dense(ops.stiffness)
    for unknowns, blocks in ops.joints.tangent(rest.tangent):
        for numbers, block in zip(unknowns, blocks, strict=True):
            total[np.ix_(numbers, numbers)] += block
    return total


@pytest.mark.parametrize(("rate", "evolution"), [(1e-9, 0.012), (1e-6, 0.012), (1e-9, 0.006)])
def test_friction_with_a_state_tells_how_far_from_steady_it_starts(rate, evolution):
    """tau/sigma = f0 + a ln(V/V0) + b ln(V0 theta/D_c): V theta/D_c and theta by hand."""
    state = {
        "law": "rate-and-state", "normal_stiffness": 1e12, "shear_stiffness": 1e12, "aperture": 1.0,
        "friction_coefficient": 0.6, "reference_slip_rate": 1e-6, "direct_effect": 0.01, "evolution_effect": evolution,
        "characteristic_slip": 0.004, "initial_slip_rate": rate,
    }  # fmt: skip
    scene = Scene.from_data(FAULT | {"fracture": {"fault": state}})
    card = {number.name: number for number in pre_run_checks(scene, read_split(scene), {})}
    away = (70.0 / 120.0 - 0.6 - (0.01 - evolution) * np.log(rate / 1e-6)) / evolution
    start, dependence = card["state at the start"], card["rate dependence"]
    assert start.value == pytest.approx(np.exp(away), rel=1e-6)
    does = "speeds up" if away > 0.0 else "slows down"
    assert start.note == f"theta {scene.time_text(start.value * 0.004 / rate, 3)}; {does}"
    assert dependence.value == pytest.approx((0.01 - evolution) * 120e6, rel=1e-9)
    assert ("unstable" in dependence.note) == (evolution > 0.01) and "D_c 0.004" in dependence.note
    assert (card["creep nucleation"].value is None) == (evolution < 0.01)
    by_slip = Scene.from_data(FAULT | {"fracture": {"fault": state | {"state_law": "slip"}}})
    zone = {number.name: number for number in pre_run_checks(by_slip, read_split(by_slip), {})}[
        "state evolution length"
    ]
    falls = abs(np.log(start.value * 1e-6 / rate))  # ln(V0 theta/D_c)
    assert card["state evolution length"].value / zone.value == pytest.approx(max(falls, 1.0), rel=1e-6)
    assert zone.note == (f"slip law: D_c/{falls:.3g} at fronts" if falls > 1.0 else "")
