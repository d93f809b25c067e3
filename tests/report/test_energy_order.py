"""(2.33b) is a trapezoid rule of the closure law: its distance to the closed form falls with dt squared."""

import numpy as np


def test_closed_form_residual_is_second_order(ran):
    """The block of 5.2 free across the joints, pushed by a smooth sin^2: nothing slips."""
    times = np.linspace(0.0, 4.0, 161)
    table = [[float(t), float(0.4 * np.sin(np.pi * t / 4.0) ** 2)] for t in times]
    worst = []
    for dt in (0.1, 0.05, 0.025):
        history = ran(
            "report_5_2",
            'support.1.components=["x", "rotation"]',
            f"load.0.traction=[0, {table}]",
            "stage.0.end=6",
            f"stage.0.time_step={dt}",
        ).history
        assert np.abs(history["energy/residual"]).max() < 1e-10
        worst.append(np.abs(history["energy/residual_closed"]).max())
    orders = np.log2(np.array(worst[:-1]) / worst[1:])
    assert worst[0] > 1e-7
    assert (orders > 1.8).all() and (orders < 2.3).all(), worst
