"""Strength drops, walls that part and meet, an absorbing side with a wave, and a support that moves: the books, order two."""

import numpy as np

from .conftest import JOINT, ROCK


def _smooth(length, rows, shape):
    """A table of a function of t/length."""
    times = np.linspace(0.0, length, rows)
    return [[float(t), float(shape(t / length))] for t in times]


WAVE = _smooth(1e-3, 81, lambda x: -0.2 * np.sin(np.pi * x) ** 2)  # of tension, down from the north
MOVE = [*_smooth(4e-3, 161, lambda x: 8e-4 * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi))), [1.0, 8e-4]]
SCENE = (
    ROCK
    + JOINT
    + f"""
stick_slip_ratio = 0.9
[geometry]
domain = [0, 0, 4, 3]
size = 1
[[geometry.fracture]]
name = "fault"
points = [[0, 1], [4, 2]]
[initial_stress]
xx = -1e6
yy = -1e6
xy = -4.5e5
[[load]]
on = ["east", "west"]
traction = "initial-stress"
[[support]]
on = "south"
displacement = {{x = {MOVE}, y = 0}}
[[absorbing]]
on = "north"
[absorbing.wave]
kind = "p"
direction = [0, -1]
velocity = {WAVE}
[[probe]]
name = "middle"
at = [2, 1.5]
[[stage]]
kind = "dynamic"
time_step = 1e-4
end = 3e-3
"""
)


def test_books_close_in_steps_and_to_second_order_in_closed_form(run_scene):
    steps, closed = np.array([1e-4, 5e-5, 2.5e-5]), []
    for step in steps:
        found = run_scene(SCENE, f"stage.0.time_step={step}")
        kinds = [event["kind"] for event in found.events]
        met = [event for event in found.events if event["kind"] == "open" and event["end"] is not None]
        assert kinds.count("slip") >= 6 and kinds.count("open") >= 3 and met
        assert found.closes(1e-10)
        entries = {name: np.abs(v).max() for name, v in found.history.items() if name.startswith("energy/")}
        for name in ("friction", "radiated", "work_incident", "work_boundaries", "kinetic", "rock_strain"):
            assert entries[f"energy/{name}"] > 0.02 * max(entries.values()), name
        closed.append(entries["energy/residual_closed"] / max(entries.values()))
    assert np.polyfit(np.log(steps), np.log(closed), 1)[0] > 1.8 and closed[-1] < 1e-8, closed
