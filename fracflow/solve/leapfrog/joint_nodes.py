"""Passes of an explicit step over nodes that joints push, by compiled loops where nodes allow it, else by NumPy and PETSc."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fracflow.mesh.data import Floats, Ints
from fracflow.solve.leapfrog.compiled import address, library
from fracflow.solve.leapfrog.nodes import Nodes

Array = NDArray[Any]


class Pushed(NamedTuple):
    """Changes by loads and joints in a step, at ``Nodes.pushed``.

    force  (p,) of their forces [force per thickness];  ``added`` (p,) of displacements by that [length]
    moved  (n,) motion of ``Nodes.every`` [length]
    """

    force: Floats
    added: Floats
    moved: Floats


class JointNodes(Protocol):
    """Both ways give the same but for round-off."""

    def predicted(self, v: Floats, dt: float) -> Floats:
        """Motion (n,) of ``Nodes.every`` in a time dt by the velocities of the rock [length]."""
        ...

    def jump(self, moved: Floats) -> Floats:
        """Changes of strains (s, dim) by a motion (n,) [length]. Collective."""
        ...

    def pull(self, step: Pushed, before: Floats, after: Floats, share: float) -> Floats:
        """Sums of sizes (s, dim) of what makes the strains, once sections have other tractions (s, dim). Collective.

        share  S of ``integrators.explicit``; what is pushed changes in place
        """
        ...

    def resist(self, traction: Floats, force: Floats) -> None:
        """Take G' W f of tractions (s, dim) off forces (m,) on the first of ``Nodes.every``. Collective."""
        ...

    def shift(self, added: Floats) -> None:
        """Bring what is added to displacements (p,) to the rock."""
        ...

    def place(self, force: Floats) -> None:
        """Bring those forces (m,) to the rock."""
        ...

    def accelerated(self) -> Floats:
        """f/m (p,) at ``Nodes.pushed`` by the forces of the rock, 0 where held and on bodies."""
        ...

    def gain(self, force: Floats, before: Floats, after: Floats) -> float:
        """Sum of forces (p,) times accelerations (p,) before and after a step, of what is neither held nor on a body."""
        ...

    def given(self) -> dict[str, int] | None:
        """Counts and addresses by their names in ``steps.c``; None where that has no loops."""
        ...


class PlainJointNodes:
    """By NumPy, and by PETSc where other ranks have nodes of joints."""

    def __init__(self, nodes: Nodes) -> None:
        """Nothing is copied."""
        self.nodes, self._shape = nodes, (-1, nodes.operators.joints.dim)
        self._weights = nodes.operators.joints.weights[:, None]

    def predicted(self, v: Floats, dt: float) -> Floats:
        """Motion (n,) of ``Nodes.every`` in a time dt by the velocities of the rock [length]."""
        found: Floats = dt * v[self.nodes.places]
        return found

    def jump(self, moved: Floats) -> Floats:
        """Changes of strains (s, dim) by a motion (n,) [length]. Collective."""
        return self.nodes.jump.times(moved[self.nodes.at_jump]).reshape(self._shape)

    def pull(self, step: Pushed, before: Floats, after: Floats, share: float) -> Floats:
        """Sums of sizes (s, dim) of what makes the strains, once sections have other tractions (s, dim). Collective.

        share  S of ``integrators.explicit``; what is pushed changes in place
        """
        nodes, force = self.nodes, np.zeros(len(step.force))
        force[nodes.by_joints] = nodes.jump.transposed((self._weights * (before - after)).ravel())
        more = share * nodes.accelerated(force)
        np.add(step.force, force, out=step.force)
        np.add(step.added, more, out=step.added)
        step.moved[nodes.pushed] += more
        return nodes.sizes.times(np.abs(step.moved[nodes.at_jump])).reshape(self._shape)

    def resist(self, traction: Floats, force: Floats) -> None:
        """Take G' W f of tractions (s, dim) off forces (m,) on the first of ``Nodes.every``. Collective."""
        force[self.nodes.at_jump] -= self.nodes.jump.transposed((self._weights * traction).ravel())

    def shift(self, added: Floats) -> None:
        """Bring what is added to displacements (p,) to the rock."""
        self.nodes.rock.u[self.nodes.places_pushed] += added

    def place(self, force: Floats) -> None:
        """Bring those forces (m,) to the rock."""
        self.nodes.rock.e[self.nodes.places_forced] = force

    def accelerated(self) -> Floats:
        """f/m (p,) at ``Nodes.pushed`` by the forces of the rock, 0 where held and on bodies."""
        found: Floats = self.nodes.inverse * self.nodes.rock.f[self.nodes.places_pushed]
        return found

    def gain(self, force: Floats, before: Floats, after: Floats) -> float:
        """Sum of forces (p,) times accelerations (p,) before and after a step, of what is neither held nor on a body."""
        at = self.nodes.free
        return float(force[at] @ (before[at] + after[at]))

    def given(self) -> dict[str, int] | None:
        """None: it has no loops."""
        return None


class CompiledJointNodes:
    """By ``nodes.c``: joints in the plane whose nodes are all of this rank, and no rigid bodies."""

    def __init__(self, nodes: Nodes) -> None:
        """Bring G into the order of ``Nodes.every`` and of ``Nodes.pushed``."""
        loops, rock = library(), nodes.rock
        assert loops is not None
        self._loops = loops
        starts, columns, entries = _by_sections(nodes)
        numbers = starts, nodes.at_jump[columns], nodes.by_joints[columns], nodes.pushed
        starts, at, to, pushed = (_kept(each, np.int32) for each in numbers)
        entries, weights = _kept(entries, float), _kept(nodes.operators.joints.weights, float)
        places = [_kept(each, np.int64) for each in (nodes.places, nodes.places_forced, nodes.places_pushed)]
        self._sections, self._counts = len(weights), [len(each) for each in places]
        self._scratch, self._inverse = np.zeros(len(nodes.pushed)), _kept(nodes.inverse, float)
        self._arrays = [starts, at, to, entries, weights, pushed, *places]  # alive as long as their addresses
        first, at_all, at_pushed, values, self._weights, self._of_pushed, *self._places = map(address, self._arrays)
        self._rows, self._both = (first, at_all, values), (first, at_all, at_pushed, values, self._weights)
        self._rock = {name: address(getattr(rock, name)) for name in "uef"}  # they stay where they are

    def predicted(self, v: Floats, dt: float) -> Floats:
        """Motion (n,) of ``Nodes.every`` in a time dt by the velocities of the rock [length]."""
        moved = np.empty(self._counts[0])
        self._loops.fracflow_predict(len(moved), self._places[0], address(v), dt, address(moved))
        return moved

    def jump(self, moved: Floats) -> Floats:
        """Changes of strains (s, dim) by a motion (n,) [length]."""
        found = np.empty((self._sections, 2))
        self._loops.fracflow_jumps(self._sections, *self._rows, address(moved), address(found))
        return found

    def pull(self, step: Pushed, before: Floats, after: Floats, share: float) -> Floats:
        """Sums of sizes (s, dim) of what makes the strains, once sections have other tractions (s, dim).

        share  S of ``integrators.explicit``; what is pushed changes in place
        """
        sizes, before, after = np.empty((self._sections, 2)), _kept(before, float), _kept(after, float)
        given = address(before), address(after), address(self._inverse)
        changed = map(address, (self._scratch, *step, sizes))
        counts = self._sections, self._counts[2]
        self._loops.fracflow_pull(*counts, *self._both, *given, share, self._of_pushed, *changed)
        return sizes

    def resist(self, traction: Floats, force: Floats) -> None:
        """Take G' W f of tractions (s, dim) off forces (m,) on the first of ``Nodes.every``."""
        traction = _kept(traction, float)
        given = self._weights, address(traction), address(force)
        self._loops.fracflow_resist(self._sections, *self._rows, *given)

    def shift(self, added: Floats) -> None:
        """Bring what is added to displacements (p,) to the rock."""
        self._loops.fracflow_put(self._counts[2], 1, self._places[2], address(added), self._rock["u"])

    def place(self, force: Floats) -> None:
        """Bring those forces (m,) to the rock."""
        self._loops.fracflow_put(self._counts[1], 0, self._places[1], address(force), self._rock["e"])

    def accelerated(self) -> Floats:
        """f/m (p,) at ``Nodes.pushed`` by the forces of the rock, 0 where held."""
        found = np.empty(self._counts[2])
        given = self._places[2], address(self._inverse), self._rock["f"], address(found)
        self._loops.fracflow_accelerate(len(found), *given)
        return found

    def gain(self, force: Floats, before: Floats, after: Floats) -> float:
        """Sum of forces (p,) times accelerations (p,) before and after a step, of what is neither held nor on a body."""
        given = map(address, (self._inverse, force, before, after))
        return float(self._loops.fracflow_gain(len(force), *given))

    def given(self) -> dict[str, int] | None:
        """Counts and addresses by their names in ``steps.c``."""
        names = "starts", "at", "to", "entries", "weights", "of_pushed", "places", "places_forced", "places_pushed"
        counts = dict(zip(("every", "forced", "pushed"), self._counts, strict=True), sections=self._sections)
        arrays = dict(zip(names, map(address, self._arrays), strict=True))
        return counts | arrays | {"inverse_pushed": address(self._inverse)}


def shares_columns(nodes: Nodes) -> bool:
    """Whether both rows of G of each section in the plane have the same columns, as ``model.joints`` makes them."""
    starts, columns, _ = nodes.jump.own_rows()
    counts = np.diff(starts)
    even = np.repeat(np.arange(len(counts)) % 2 == 0, counts)
    return np.array_equal(counts[::2], counts[1::2]) and np.array_equal(columns[even], columns[~even])


def _by_sections(nodes: Nodes) -> tuple[Ints, Ints, Floats]:
    """Starts (s + 1,), columns (k,) among those of G, and entries (k, 2) of both rows of each section."""
    starts, columns, entries = nodes.jump.own_rows()
    even = np.repeat(np.arange(len(starts) - 1) % 2 == 0, np.diff(starts))
    return starts[::2] // 2, columns[even], np.stack([entries[even], entries[~even]], axis=1)


def joint_nodes(nodes: Nodes) -> JointNodes:
    """The compiled passes where they serve on all ranks, else the others. Collective."""
    comm, dim, is_own = nodes.operators.layout.comm, nodes.operators.joints.dim, nodes.jump.is_own
    lacks = library() is None or dim != 2 or len(nodes.bodies) > 0 or not is_own or not shares_columns(nodes)
    return PlainJointNodes(nodes) if comm.allreduce(int(lacks)) else CompiledJointNodes(nodes)


def _kept(values: Array, kind: DTypeLike) -> Array:
    """Values (...) as the loops take them: themselves where they are so."""
    return np.ascontiguousarray(values, kind)
