"""Leak-off of fractures into the rock behind their walls: what a step loses is known by a memory at each joint end."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI
from fracflow.integrators import first_rate
from fracflow.laws import JOINT_LAWS
from fracflow.laws.leak_off import (
    RANGE,
    Exponentials,
    exponentials,
    leak_off_coefficient,
    leaked_volume,
    memory_after,
    memory_of,
)
from fracflow.mesh.data import Floats, Ints
from fracflow.model.operators import Operators
from fracflow.model.properties import along_fractures
from fracflow.model.terms.term import Leaving, Term, TermStep
from fracflow.remarks import note
from fracflow.scene.scene import Scene

SHORTEST = 1e-3  # of the least step of the stages: substeps are shorter
PROMPT = 1e-12  # the same where substeps are as short as slip or errors ask for
LONGEST = 10.0  # times the time of the stages: runs are gone on with
PRESSURE, RATE, MEAN, LOWEST = -4, -3, -2, -1
"""Columns of a memory behind those of the exponentials: the pressure, the rate, and the mean rate over the last step. The last
is the number of the slowest exponential that fades."""
FEWEST = 6  # columns: with one exponential that fades, and one that does not


class LeakOff(Term):
    """The leak-off of all fractures of a scene that have it."""

    name, entry = "leak_off", "leak_off"
    drains = has_memory = True

    def __init__(self, operators: Operators, scene: Scene, permeability: Floats, storage: Floats) -> None:
        """Sample permeability and storage (j, 2) at the joint ends."""
        network = operators.network
        per_area = leak_off_coefficient(permeability, storage, network.viscosity)
        self._coefficient = 0.5 * network.length[:, None] * per_area
        self._kernel = kernel_of(scene)
        assert scene.fluid is not None
        self._start = scene.fluid.initial_pressure + network.resting_end
        leaks = permeability > 0.0
        diffusivity = float((permeability[leaks] / (network.viscosity * storage[leaks])).max(initial=0.0))
        self._length = f" {scene.unit_system.length}".rstrip()
        self._reach = float(np.sqrt(operators.layout.comm.allreduce(diffusivity, op=MPI.MAX) * _end(scene)))

    @property
    def notes(self) -> tuple[str, ...]:
        """How far the pressure goes, for half spaces know no other fracture."""
        line = f"leak_off: by the end pressure goes about {self._reach:.3g}{self._length} into the rock,"
        return (note(f"{line} which is taken to be free of other fractures"),)

    def joints(self) -> Ints:
        """Numbers (k,) of this rank's joints that lose fluid."""
        return np.flatnonzero(self._coefficient.any(axis=1))

    def memory(self) -> Floats:
        """Memory (j, 2, m) at the start: the rock is at the initial pressure, and so is the fluid."""
        return self._at_rest(self._start)

    def _at_rest(self, pressure: Floats) -> Floats:
        found = np.zeros((*self._coefficient.shape, len(self._kernel.rates) + 4))
        found[..., PRESSURE], found[..., LOWEST] = pressure, self._kernel.lowest
        return found

    def leaving(self, pressure: Floats, aperture: Floats, step: TermStep) -> Leaving:
        """Fluid that leaves at the ends of this rank's joints (j, 2)."""
        memory, none = step.memory[self.name], np.zeros(pressure.shape)
        if step.alphas is None or step.alphas.b1 == 0.0:
            is_steady = step.alphas is not None and step.alphas.b4 == 0.0
            return Leaving(none if is_steady else memory[..., RATE], none, none)
        volume, slope = self._volume(memory, pressure, step.dt)
        rate = first_rate(step.alphas, volume, 0.0, memory[..., RATE], memory[..., MEAN])
        return Leaving(rate, step.alphas.b1 * slope, none)

    def memory_after(self, pressure: Floats, step: TermStep) -> Floats:
        """Memory (j, 2, m) after a step to these pressures (j, 2) at the joint ends; a steady one leaves rock all its time."""
        memory = step.memory[self.name]
        if step.alphas is None or step.alphas.b1 == 0.0:
            is_steady = step.alphas is not None and step.alphas.b4 == 0.0
            return self._at_rest(pressure) if is_steady else memory
        volume, _ = self._volume(memory, pressure, step.dt)
        new = memory.copy()
        new[..., :PRESSURE] = memory_after(
            self._kernel, memory[..., :PRESSURE], pressure - memory[..., PRESSURE], step.dt
        )
        new[..., PRESSURE], new[..., MEAN] = pressure, volume / step.dt
        new[..., RATE] = first_rate(step.alphas, volume, 0.0, memory[..., RATE], memory[..., MEAN])
        return new

    def restored(self, saved: Floats, first: Floats) -> Floats:
        """Memory (j, 2, m) with this scene's exponentials; see ``Term``. Raises ValueError if it is none."""
        lowest = float(first[..., LOWEST].flat[0])
        is_one = bool((saved[..., LOWEST] == lowest).all())
        if saved.shape[-1] < FEWEST or not is_one or lowest % 1.0 != 0.0 or abs(lowest) > RANGE:
            raise ValueError("leak_off")
        memory = saved
        new = self._at_rest(memory[..., PRESSURE])
        new[..., :PRESSURE] = memory_of(self._kernel, memory[..., :PRESSURE], int(lowest))
        new[..., RATE], new[..., MEAN] = memory[..., RATE], memory[..., MEAN]
        return new

    def lost(self, memory: Floats, dt: float) -> float:
        """Volume that this rank's joints lost in a step of length ``dt``, by the memory (j, 2, m) after it [area]."""
        return float(memory[..., MEAN].sum()) * dt

    def _volume(self, memory: Floats, pressure: Floats, dt: float) -> tuple[Floats, Floats]:
        volume, slope = leaked_volume(self._kernel, memory[..., :PRESSURE], pressure - memory[..., PRESSURE], dt)
        return self._coefficient * volume, self._coefficient * slope


def leak_off(operators: Operators, scene: Scene) -> tuple[LeakOff, ...]:
    """The term of a scene with fractures that lose fluid."""
    if operators.flow is None or not scene.leaks_off:
        return ()
    ends = np.array([-1.0, 1.0])
    given = [
        np.nan_to_num(along_fractures(operators.blocks, scene, key, ends))
        for key in ("leak_permeability", "leak_storage")
    ]
    return (LeakOff(operators, scene, *given),)


def kernel_of(scene: Scene) -> Exponentials:
    """The exponentials for the times of a scene's stages; where these take none, any will do."""
    lengths = [step for stage in scene.stage for step in (stage.time_step, stage.dynamic_time_step) if step]
    is_prompt = scene.accuracy.tolerance is not None or any(
        [stage.kind == "auto" for stage in scene.stage]
        + [JOINT_LAWS[table.law].creeps for table in scene.fracture.values()]
    )
    least = min(lengths, default=1.0)
    longest = max(_end(scene), least, *lengths)
    return exponentials((PROMPT if is_prompt else SHORTEST) * least, LONGEST * longest)


def _end(scene: Scene) -> float:
    end = 0.0
    for stage in scene.stage:
        end = stage.finish(end)
    return end
