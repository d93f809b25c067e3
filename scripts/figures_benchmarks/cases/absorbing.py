"""A plane P wave meets an absorbing side at 60 degrees: dashpots (Lysmer and Kuhlemeyer 1969) send back what they must.

Motion that only leaves, with tractions C v against it, is not a plane wave at an angle: the reflected P and S waves balance
the tractions of all three, two equations for two amplitudes.
"""

from __future__ import annotations

import numpy as np
from figures_verification.case import Bar

from figures_benchmarks.benchmark import Benchmark, Floats, Line, Ran, clocked, rms

FAST, DENSITY, POISSON, ANGLE, PULSE, SPEED = 5000.0, 2700.0, 0.25, 60.0, 1e-3, 0.01
SLOW = FAST / np.sqrt(3.0)
WIDTH, HEIGHT, LEVEL, END = 7.5, 25.0, 22.5, 5.6e-3  # LEVEL of the probe on the side
WAY = np.array([np.cos(np.radians(ANGLE)), np.sin(np.radians(ANGLE))])
TIMES = np.linspace(0.0, PULSE, 41)
WAVE = f"""{{kind = "p", direction = {WAY.tolist()},
  velocity = {np.stack([TIMES, SPEED * np.sin(np.pi * TIMES / PULSE) ** 2], axis=1).tolist()}}}""".replace("\n", "")
SCENE = f"""
rock.rock = {{youngs_modulus = 56.25e9, poissons_ratio = {POISSON}, density = {DENSITY}}}
probe = [{{name = "side", at = [{WIDTH}, {LEVEL}], quantities = ["velocity"]}}]
geometry = {{domain = [0, 0, {WIDTH}, {HEIGHT}], size = SIZE, cells = "quads"}}
stage = [{{kind = "dynamic", time_step = STEP, end = {END}}}]
"""
BARE = f'absorbing=[{{on = ["west", "south", "north"], wave = {WAVE}}}, {{on = "east"}}]'
ALL = f'absorbing=[{{on = ["west", "south", "north", "east"], wave = {WAVE}}}]'


def sent_back() -> float:
    """Amplitude of the P wave that returns, over that which came."""
    shear, lame = DENSITY * SLOW**2, DENSITY * (FAST**2 - 2 * SLOW**2)
    slowness = np.sin(np.radians(ANGLE)) / FAST

    def left(direction: Floats, motion: Floats, speed: float) -> Floats:
        """Traction on the side x = 0 of a wave of unit velocity, and that of the dashpots."""
        strain = -(np.outer(direction, motion) + np.outer(motion, direction)) / (2 * speed)
        stress = lame * np.trace(strain) * np.eye(2) + 2 * shear * strain
        return stress[:, 0] + DENSITY * np.array([FAST, SLOW]) * motion

    p = np.array([-WAY[0], WAY[1]])
    s = np.array([-np.sqrt(1 - (slowness * SLOW) ** 2), slowness * SLOW])
    back = np.stack([left(p, p, FAST), left(s, np.array([-s[1], s[0]]), SLOW)], axis=1)
    return float(abs(np.linalg.solve(back, -left(WAY, WAY, FAST))[0]))


def run(size: float) -> Ran:
    """On cells of ``size`` metres: the difference that the bare side makes, taken apart by direction."""
    scene = SCENE.replace("SIZE", repr(size)).replace("STEP", repr(2e-4 * size))
    (bare, seconds), (alone, _) = clocked(scene, BARE), clocked(scene, ALL)
    time, back = bare.history["time"], bare.probe("side", "velocity") - alone.probe("side", "velocity")
    to_s = np.arcsin(np.sin(np.radians(ANGLE)) * SLOW / FAST)
    ways = np.array([[-WAY[0], WAY[1]], [-np.sin(to_s), -np.cos(to_s)]])
    amplitude = np.linalg.solve(ways.T, back.T)[0]
    arrives = np.array([WIDTH, LEVEL]) @ WAY / FAST

    def came(at: Floats) -> Floats:
        since = (at - arrives) / PULSE
        return np.where((since > 0) & (since < 1), SPEED * np.sin(np.pi * since) ** 2, 0.0)

    expected = sent_back() * came(time)
    found = amplitude * np.sign(amplitude @ expected)
    late = np.linspace(arrives - 0.2 * PULSE, END, 25)
    line = Line(
        "P wave that comes back",
        "time [ms]",
        "velocity [mm/s]",
        (time[time > late[0]] * 1e3, found[time > late[0]] * 1e3),
        (late * 1e3, sent_back() * came(late) * 1e3),
    )
    return Ran((rms(found - expected, expected),), seconds, (line,))


BENCHMARK = Benchmark(
    "Reflection at absorbing sides", "absorbing side",
    "Lysmer and Kuhlemeyer 1969; P at 60 degrees, Poisson's ratio 1/4: 0.134 comes back, by the balance of plane waves",
    "nothing", (Bar("reflected P", 0.0025, 1.5),), run, (0.5, 0.25, 0.125), (1.0, 0.5), "cells [m]",
)  # fmt: skip
