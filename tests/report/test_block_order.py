"""R02: the block of 5.2 pushed until it slips: second order in the step, with a strength drop where events are located."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

STRENGTH = 2.0
STEPS = np.array([0.2, 0.1, 0.05, 0.025])


@dataclass(frozen=True)
class Push:
    """A force on the block, with the instants at which it has a kink, until ``end``."""

    force: Callable[[float], float]
    kinks: tuple[float, ...]
    end: float


HALF_SINE = Push(lambda t: 2.64 * np.sin(np.pi * t / 3.4) if t < 3.4 else 0.0, (3.4,), 12.0)
HARMONIC = Push(lambda t: 1.2 * np.sin(0.8 * t), (), 20.0)


def exact(samples, push, ratio):
    """Displacement of u'' + F = P, F = u - u_p, |F| <= 2, then ``ratio`` of it: DOP853 from event to event."""
    t, state, offset, sliding = 0.0, [0.0, 0.0], 0.0, 0.0
    out = np.zeros_like(samples)
    while t < push.end - 1e-12:
        stop = min([kink for kink in push.kinks if kink > t + 1e-12], default=push.end)
        force = (lambda u, s=sliding: s * ratio * STRENGTH) if sliding else (lambda u, o=offset: u - o)
        event = (lambda t, y: y[1]) if sliding else (lambda t, y, o=offset: abs(y[0] - o) - STRENGTH)
        event.terminal, event.direction = True, -sliding if sliding else 1.0
        piece = solve_ivp(
            lambda t, y, f=force: [y[1], push.force(t) - f(y[0])],
            (t, stop),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            events=event,
            dense_output=True,
            max_step=0.05,
        )
        here = (samples >= t) & (samples <= piece.t[-1])
        if here.any():
            out[here] = piece.sol(samples[here])[0]
        t, state = piece.t[-1], list(piece.y[:, -1])
        if piece.status == 1:
            if sliding:
                offset, state[1], sliding = state[0] - sliding * ratio * STRENGTH, 0.0, 0.0
            else:
                sliding = float(np.sign(state[0] - offset))
    return out


def errors(ran, push, ratio, *overrides):
    """Largest error of the displacement over its largest value, for each of the steps."""
    times = np.linspace(0.0, push.end, round(push.end / (STEPS[-1] / 2)) + 1)  # every time step falls on one of these
    table = [[float(t), float(push.force(t))] for t in times]
    found = []
    for dt in STEPS:
        pushed = (f"load.0.traction=[{table}, 0]", f"stage.0.time_step={dt}", f"stage.0.end={push.end}")
        history = ran("report_5_2", *pushed, f"fracture.default.stick_slip_ratio={ratio}", *overrides).history
        right = exact(history["time"], push, ratio)
        found.append(np.abs(history["probe/block/displacement"][:, 0] - right).max() / np.abs(right).max())
    return np.array(found)


def order(found):
    """Slope of the errors over the steps."""
    return np.polyfit(np.log(STEPS), np.log(found), 1)[0]


@pytest.mark.parametrize("events", ["located", "at-step-ends"])
def test_second_order_through_slip_without_a_drop(ran, events):
    found = errors(ran, HALF_SINE, 1.0, f"method.events={events}")
    assert order(found) > 1.8, found
    assert found[0] < 2e-2 and found[-1] < 4e-4, found


@pytest.mark.parametrize("push, ratio", [(HALF_SINE, 0.8), (HARMONIC, 0.9)], ids=["half-sine 0.8", "harmonic 0.9"])
def test_second_order_through_strength_drops(ran, push, ratio):
    found = errors(ran, push, ratio)
    assert order(found) > 1.9, found
    assert found[0] < 2e-2 and found[-1] < 4e-4, found


def test_first_order_only_where_drops_wait_for_the_end_of_a_step(ran):
    found, located = (errors(ran, HARMONIC, 0.9, f"method.events={how}") for how in ("at-step-ends", "located"))
    assert order(found) < 1.5 and found[-1] > 10 * located[-1], (found, located)
