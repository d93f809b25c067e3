"""R02 B: the block of 5.2 under a half sine of 2.64 for 3.4 s: second order through slip."""

import numpy as np
from scipy.integrate import solve_ivp

PEAK, LASTS, END, STRENGTH = 2.64, 3.4, 12.0, 2.0


def _force(t):
    return PEAK * np.sin(np.pi * t / LASTS) if t < LASTS else 0.0


def _exact(samples):
    """Displacement of u'' + F = P, F = u - u_p, |F| <= 2 perfectly plastic: DOP853 from event to event."""
    t, state, offset, sliding = 0.0, [0.0, 0.0], 0.0, 0.0
    out = np.zeros_like(samples)
    while t < END - 1e-12:
        stop = LASTS if t < LASTS - 1e-12 else END
        force = (lambda u, s=sliding: s * STRENGTH) if sliding else (lambda u, o=offset: u - o)
        event = (lambda t, y: y[1]) if sliding else (lambda t, y, o=offset: abs(y[0] - o) - STRENGTH)
        event.terminal, event.direction = True, -sliding if sliding else 1.0
        piece = solve_ivp(
            lambda t, y, f=force: [y[1], _force(t) - f(y[0])],
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
                offset, state[1], sliding = state[0] - sliding * STRENGTH, 0.0, 0.0
            else:
                sliding = float(np.sign(state[0] - offset))
    return out


def _error(ran, time_step, *overrides):
    """Largest error of the displacement over its largest value."""
    times = np.linspace(0.0, LASTS, 545)  # every time step falls on one of these
    table = [[float(t), max(0.0, float(PEAK * np.sin(np.pi * t / LASTS)))] for t in times]
    pushed = (f"load.0.traction=[{table}, 0]", f"stage.0.time_step={time_step}", f"stage.0.end={END}")
    history = ran("report_5_2", *pushed, *overrides).history
    right = _exact(history["time"])
    return np.abs(history["probe/block/displacement"][:, 0] - right).max() / np.abs(right).max()


def test_second_order_through_slip(ran):
    steps = np.array([0.1, 0.05, 0.025, 0.0125])
    errors = [_error(ran, dt) for dt in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 1.8, errors
    assert errors[0] < 5e-3 and errors[-1] < 1e-4, errors
