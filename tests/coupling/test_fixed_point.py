"""(4.5) Its contraction against closed forms, its relaxations against the monolithic solver, and what it refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.diagnostics.fracture_flow import coupling_factor
from fracflow.errors import SolveError
from fracflow.integrators import BackwardEuler
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import run
from fracflow.solve.fixed_point.failure import cycles_needed
from fracflow.solve.fixed_point.iteration import FixedPoint
from fracflow.solve.options import set_defaults
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest, StepRule
from fracflow.solve.rock_cost import RockChoice

LENGTH, APERTURE, STIFFNESS, VISCOSITY, ELEMENTS = 40.0, 2e-4, 5e9, 1e-3, 10
FIXED = "method.coupling=fixed-point"


def film(method=None, ends=("start", "end"), rock=1.0, more=None, rate=1e-7, law=None, shear=0.0, **stage):
    """A film between rock far softer than its joint, so that each node has a spring of its own."""
    step = {"kind": "quasi-static", "time_step": 1.0, "steps": 1, **stage}
    return Scene.from_data(
        {
            "geometry": {
                "domain": [0.0, -4.0, LENGTH, 4.0], "size": LENGTH / ELEMENTS, "cells": "quads",
                "fracture": [
                    {"name": name, "points": points}
                    for name, points in {"film": [[0.0, 0.0], [LENGTH, 0.0]], **(more or {})}.items()
                ],
            },
            "method": {"coupling": "fixed-point", **(method or {})},
            "rock": {"rock": {"youngs_modulus": rock, "poissons_ratio": 0.0, "density": 1e-9}},
            "fracture": {"default": {
                "law": "linear", "normal_stiffness": STIFFNESS, "shear_stiffness": STIFFNESS, "aperture": APERTURE,
                **(law or {}),
            }},
            "initial_stress": {"xx": -shear, "yy": -shear, "zz": -shear, "xy": 0.44 * shear},
            "fluid": {"viscosity": VISCOSITY, "specific_weight": 1e4},
            "support": [{"on": ["south", "north"]}],
            "well": [
                {"name": "in", "at": [LENGTH / 2, 0.0], "flow_rate": rate},
                *({"name": end, "at": {"fracture": "film", "end": end}, "pressure": 0.0} for end in ends),
            ],
            "stage": [step],
        }
    )  # fmt: skip


def rho_of_film(alpha_1, kappa):
    """12 mu alpha_1 / (d^3 kappa^2 k_n) with the wave number that lumped nodes see, 2/h sin(kappa h/2)."""
    h = LENGTH / ELEMENTS
    seen = 2.0 / h * np.sin(0.5 * kappa * h)
    return 12.0 * VISCOSITY * alpha_1 / (APERTURE**3 * seen**2 * STIFFNESS)


@pytest.mark.parametrize(("ends", "kappa"), [(("start", "end"), np.pi / LENGTH), (("start",), np.pi / 2 / LENGTH)])
def test_prediction_is_the_closed_form(ends, kappa, comm):
    """Longest mode between two fixed pressures, and with one end closed; rho goes as 1/dt."""
    scene = film(ends=ends)
    model = prepare(scene, comm)
    state = equilibrium_state(model)
    coupling = FixedPoint(scene, model.operators, model.loads)
    for dt in (1e-3, 1.0):
        problem = StepProblem(
            model.operators, state, StepRequest(dt, dt, {}, model.loads), StepRule(BackwardEuler().alphas(dt))
        )
        problem.evaluate()
        found = coupling._prediction(problem)
        expected = rho_of_film(1.0 / dt, kappa)
        assert abs(found.factor / expected - 1.0) <= 1e-3 and found.fracture == "film"
        problem.destroy()
    coupling.destroy()


def test_a_compressible_fluid_lowers_the_factor_as_the_card_says(comm):
    """alpha_1/((C kappa^2 + alpha_1 c_f d) k_n): here the fluid stores half as much as the walls, and rho < 2 at any step."""
    held = 0.5 / STIFFNESS
    scene = film()
    fluid = scene.fluid.model_copy(update={"compressibility": held / APERTURE})
    model = prepare(scene.model_copy(update={"fluid": fluid}), comm)
    refuse_imbalance(model)
    coupling = FixedPoint(model.scene, model.operators, model.loads)
    conducting = APERTURE**3 / (12.0 * VISCOSITY)
    kappa = 2.0 * ELEMENTS / LENGTH * np.sin(0.5 * np.pi / ELEMENTS)
    for dt in (10.0, 1e-3):
        problem = StepProblem(
            model.operators,
            equilibrium_state(model),
            StepRequest(dt, dt, {}, model.loads),
            StepRule(BackwardEuler().alphas(dt)),
        )
        problem.evaluate()
        expected = coupling_factor(1.0 / dt, np.array([conducting]), np.array([kappa]), np.array([STIFFNESS]), held)[0]
        assert abs(coupling._prediction(problem).factor / expected - 1.0) <= 1e-3
        problem.destroy()
    assert 1.9 < expected < 2.0
    coupling.destroy()


def test_refusal_names_the_number_and_the_limit(comm):
    """Massless walls: the factor is 1 at dt = 2 tau_d of the trapezoid, tau_d of backward Euler, and less only above."""
    scene = film()
    limit = rho_of_film(1.0, np.pi / LENGTH)
    model = prepare(scene, comm)
    refuse_imbalance(model)
    stepping, state = Stepping(model), equilibrium_state(model)
    with pytest.raises(SolveError, match="diverges") as caught:
        stepping.step(state, StepRequest(0.1 * limit, 0.1 * limit, {}, stepping.model.loads), BackwardEuler())
    found = re.search(
        r"multiplied by ([\d.e+-]+) a cycle \(predicted; ([\d.e+-]+) measured\), most in film; it must be below 1, as for a"
        r" time_step > ([\d.e+-]+) s, not for a smaller one: .*monolithic.*aitken",
        str(caught.value),
    )
    assert found and abs(float(found[1]) - 10.0) <= 0.1 and abs(float(found[3]) / limit - 1.0) <= 0.06
    assert 1.0 < float(found[2]) <= 10.1
    new, report = stepping.step(state, StepRequest(2.0 * limit, 2.0 * limit, {}, stepping.model.loads), BackwardEuler())
    assert abs(report.predicted - 0.5) <= 0.01 and abs(report.measured - 0.5) <= 0.05 and report.cycles > 20
    new.destroy()
    stepping.destroy()


@pytest.mark.parametrize(
    "name, factor, most, rock_solver",
    [
        ("aitken", 50.0, 45, "direct"),
        ("anderson", 200.0, 15, "direct"),
        ("added-storage", 200.0, 6, "direct"),
        ("added-storage", 200.0, 6, "multigrid"),
        ("plain", 0.5, 45, "multigrid"),
    ],
)
def test_relaxed_cycles_find_what_the_monolithic_solver_finds(name, factor, most, rock_solver, comm):
    """The film where plain cycles diverge by a factor, in at most so many cycles; with both ends closed too."""
    for ends in (("start", "end"), ()):
        if not ends and name != "added-storage":
            continue
        by_turns = film({"fixed_point": name, "rock_solver": rock_solver}, ends, 1e8)
        scenes = [by_turns, film({"coupling": "monolithic"}, ends, 1e8)]
        found, model = [], prepare(scenes[0], comm)  # one partition for both
        dt = rho_of_film(1.0, np.pi / LENGTH) / factor
        for scene in scenes:
            set_defaults(scene.petsc, RockChoice.of(scene.method, 0))
            stepping, state = Stepping(replace(model, scene=scene)), equilibrium_state(model)
            new, report = stepping.step(state, StepRequest(dt, dt, {}, stepping.model.loads), BackwardEuler())
            found.append((new.pressure.getArray().copy(), new.motion.displacement.getArray().copy(), report))
            new.destroy()
            stepping.destroy()
        assert 1 < found[0][2].cycles <= most and found[0][2].flow_residual <= scenes[0].accuracy.residual
        for by_turns, at_once in zip(found[0][:2], found[1][:2], strict=True):
            size = comm.allreduce(np.abs(at_once).max(initial=0.0), op=MPI.MAX)
            assert size > 0.0
            assert comm.allreduce(np.abs(by_turns - at_once).max(initial=0.0), op=MPI.MAX) <= 1e-8 * size


@pytest.mark.parametrize("factor, rate", [(2.0, 1e-5), (20.0, 1e-4)])
def test_factor_with_added_storage_is_that_of_its_end(factor, rate, comm):
    """The film widens by a twentieth and more: its conductance, and so the factor, are no longer those of the start."""
    model = prepare(film({"fixed_point": "added-storage"}, rate=rate), comm)
    stepping, dt = Stepping(model), rho_of_film(1.0, np.pi / LENGTH) / factor
    new, report = stepping.step(equilibrium_state(model), StepRequest(dt, dt, {}, model.loads), BackwardEuler())
    assert report.grown > 1.05 and report.cycles > 6
    assert 1e-3 < report.made < 1.0 and 0.8 < report.made / report.measured < 1.25
    new.destroy()
    stepping.destroy()


def test_nothing_slides_for_a_pressure_that_was_on_its_way(comm, monkeypatch):
    """The first pressures are 1.6 times the last ones, and the film slides under them. Once it does, it slides on under less.

    It sticks at the last ones, of 1.9 kPa: 4.4 kPa of shear are below tan 30 (10 - 1.9) = 4.7, and above 0.6 times that.
    """
    law = {"law": "hyperbolic-coulomb", "friction_angle_deg": 30.0, "stick_slip_ratio": 0.6}
    scene = film(rock=1e8, rate=2e-7, law=law, shear=1e4)
    scene = scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"max_cycles": 200})})
    model, dt, seen = prepare(scene, comm), rho_of_film(1.0, np.pi / LENGTH) / 0.6, []
    walls = FixedPoint._walls

    def watched(coupling, problem, keeps):
        report = walls(coupling, problem, keeps)
        seen.append((slides(problem.trial_status), keeps))
        return report

    def slides(history):
        return comm.allreduce(int(sum(part["sliding"].any(axis=-1).sum() for part in history)))

    monkeypatch.setattr(FixedPoint, "_walls", watched)
    stepping = Stepping(model)
    new, report = stepping.step(
        equilibrium_state(model), StepRequest(dt, dt, {}, stepping.model.loads), BackwardEuler()
    )
    assert report.cycles > 20 and all(count > 0 and keeps for count, keeps in seen[1:-1]) and seen[0][0] > 0
    assert seen[-1] == (0, False) and slides(new.sections.history) == 0
    new.destroy()
    stepping.destroy()


@pytest.mark.parametrize("name", ["plain", "anderson"])
def test_sealed_network_is_refused_by_name(name, comm):
    scene = film({"fixed_point": name}, ())
    model = prepare(scene, comm)
    stepping = Stepping(model)
    with pytest.raises(SolveError, match=r"time 1 s: .* no pressure is prescribed in film \(11 nodes.*added-storage"):
        stepping.step(equilibrium_state(model), StepRequest(1.0, 1.0, {}, stepping.model.loads), BackwardEuler())
    stepping.destroy()


def test_all_fractures_of_a_sealed_part_are_named(comm):
    model = prepare(film(ends=(), more={"cross": [[20.0, -4.0], [20.0, 4.0]]}), comm)
    stepping = Stepping(model)
    with pytest.raises(SolveError, match=r"prescribed in cross, film \(\d+ nodes around \(20, 0\)\)"):
        stepping.step(equilibrium_state(model), StepRequest(1.0, 1.0, {}, stepping.model.loads), BackwardEuler())
    stepping.destroy()


def test_cycles_that_run_out_tell_how_many_it_takes(comm):
    """rho = 0.8: told after 8 cycles, within a tenth of what it takes; with so many the step is done."""
    dt = rho_of_film(1.0, np.pi / LENGTH) / 0.8
    told, took = [], []
    for most in (8, None):
        scene = film()
        accuracy = scene.accuracy.model_copy(update={"max_cycles": most or told[0]})
        model = prepare(scene.model_copy(update={"accuracy": accuracy}), comm)
        stepping = Stepping(model)
        if most is None:
            new, report = stepping.step(
                equilibrium_state(model), StepRequest(dt, dt, {}, stepping.model.loads), BackwardEuler()
            )
            took.append(report.cycles)
            new.destroy()
        else:
            with pytest.raises(SolveError, match=r"did not converge in 8 cycles") as caught:
                stepping.step(equilibrium_state(model), StepRequest(dt, dt, {}, stepping.model.loads), BackwardEuler())
            told.append(int(re.search(r"set accuracy.max_cycles = (\d+),", str(caught.value))[1]))
        stepping.destroy()
    assert 50 < took[0] <= told[0] <= 1.1 * took[0]


@pytest.mark.serial
@pytest.mark.parametrize(
    "factor, left, expected", [(0.5, 2.0**10, 16), (0.1, 1.5, 7), (1.0, 10.0, None), (0.5, 0.5, None)]
)
def test_cycles_needed_by_a_geometric_series(factor, left, expected):
    assert cycles_needed([factor**n for n in range(6)], left) == expected


def test_steps_are_handed_over_and_counted(shared_tmp):
    """5.3: what the fixed point will not do, the monolithic solver does, to the same numbers."""
    histories = {}
    for name, method in {"handed": [FIXED, "method.on_divergence=monolithic"], "monolithic": []}.items():
        scene = load("meshes/report_5_3/scene.toml", ["output.pictures=false", "stage.failure.steps=4", *method])
        run(scene, shared_tmp / name, MPI.COMM_WORLD)
        MPI.COMM_WORLD.barrier()
        histories[name] = read_history(shared_tmp / name / "history.h5")
    handed, at_once = histories["handed"], histories["monolithic"]
    dynamic = handed["step/kind"] == 2
    assert dynamic.sum() >= 4
    assert handed["step/handed_over"][dynamic].all() and not at_once["step/handed_over"].any()
    assert (handed["step/predicted_factor"][dynamic] > 100.0).all() and np.isnan(at_once["step/predicted_factor"]).all()
    for field in ("pressure", "opening", "slip", "normal_traction"):
        for node in range(1, 6):
            key = f"probe/node{node}/{field}"
            assert np.abs(handed[key] - at_once[key]).max() <= 1e-8 * max(np.abs(at_once[key]).max(), 1e-3), key
    log = (shared_tmp / "handed" / "log.txt").read_text(encoding="utf-8")
    assert log.count("handed over to the monolithic solver") == 2 and f"{dynamic.sum()} steps were handed over" in log
    assert re.search(r'stage failure: time \S+ s: coupling = "fixed-point"', log)
    assert "none is measured" in log and "nan" not in log
