"""Fractures that can neither slip, open nor conduct are tied: their walls are one, and the rock goes on across them.

Their compliance must not matter. A fracture of stiffness k adds its length over k times the area of the rock to 1/E' of
the rock (Goodman 1976). It relieves the stress within its own length by E'/(k length), and reflects pi E'/(k w) of a
wave of length w (Schoenberg 1980). So L in E'/(k L) is the least of three lengths. These are the area of the rock over the
length of the locked fractures, the fracture's own length, with inertia w/pi of the shortest resolved wave.

The measured effect may be less than that of all of the rock. At a distance r a jump of 1/k over a length l adds a
strain of about 1/(k r), and moves the rock by 1/k. From farther than l/2 it moves it by l/(2 k r) at most, half of it
by the mirror image in a support (Crouch & Starfield 1983, 5). Whatever loads it, the rock strains there by 1/E', and
moves by r/E' where supports are no nearer than r. So L is no more than the distance of the nearest probe, and what all
of them do at a probe is the sum of E' l/(k r max(2 r, l)). All that deforms may lie between a support and a fracture d
apart. So L is no more than d, on average along the fracture, and they add to the compliance of a layer d deep.

Their strength must suffice for all that the scene may add to the initial stress. Loads and supports add to it, and
fractures that are not locked, which slip or are pumped into, shed some. A crack of half length a sheds x/sqrt(x^2 -
a^2) - 1 of what it loses at a distance x from its middle, along its own line, where that is most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import hypot, inf

import numpy as np

from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.reduction.decision import Decision, LockedFractures, ReductionInput
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable

PART = "locked fractures"
EARLIER = "tied fractures"  # its name in the checkpoints of earlier versions
SHARE = 0.2  # of all jumps: fewer would save little
USE = 0.9  # of the strength, before a run and in every step of it
NEARBY = 2.0  # what corners of the rock, ends of fractures and neighbours may make of a stress
AT_ONCE = 2.0  # what a load that comes at once does, over what it does slowly (Biggs 1964, 2.3)
LEAST = 2000  # displacements: fewer are solved for sooner than set up anew
NONE = 1e-300  # instead of a length of zero
CELLS = 10.0  # cells that resolve a wave
BARRED = (
    "each is too soft, or a probe, a well or rigid rock is on it, or on what it meets,"
    ' or method.contact = "redistributed" moves the mass of its walls'
)
LISTED = 5  # names that a record lists

Use = Callable[[Floats], Floats]
"""Stress (f,) added to the initial one -> the largest share of its strength that each fracture (f,) uses."""


@dataclass(frozen=True)
class Fractures:
    """Values of each fracture (f,), and of the rock around them, that the plan decides by.

    group      which hang together
    jumps      components of their joints' jumps
    length     of each [length]
    facet      mean length of its facets [length]
    stiffness  the least at the start [stress/length]
    shear      largest initial shear traction [stress]
    barred     a well, a probe or rigid rock meets it, a term drains it, or its walls' mass is carried by the rock behind
    apart      (g, f) distance from each group [length]
    reach      (g,) half the extent of each group [length]
    held       to supports, and terms that hold sides, on average along it; infinite without any [length]
    probed     (p, f) from each probe [length]
    area, size of the rock: its area, and its smaller extent [length^2, length]
    modulus    largest E' of the rock [stress]
    impedance  largest rho c_p of the rock [stress time/length]
    """

    names: tuple[str, ...]
    group: Ints
    jumps: Ints
    length: Floats
    facet: Floats
    stiffness: Floats
    shear: Floats
    barred: Bools
    apart: Floats
    reach: Floats
    held: Floats
    probed: Floats
    area: float
    size: float
    modulus: float
    impedance: float


def why_none(facts: ReductionInput) -> str:
    """Why no fracture may be tied, whatever its stress; empty where that decides."""
    scene = facts.scene
    if scene.model != "default":
        return f'model = "{scene.model}" leaves nothing out'
    if scene.is_unbounded:
        return "rock that is not meshed is as large without them"
    if facts.unknowns < LEAST:
        return f"{facts.unknowns} displacements are solved for in no time, below {LEAST}"
    if scene.initial is not None or scene.equilibrates or scene.carries_unbalanced:
        return "a start that is not at rest"
    if scene.creeps:
        return "a fracture that creeps"
    if scene.output.fields_every:
        return "output.fields_every asks for the fields of all of them"
    if any(load.control is not None or load.force is not None for load in scene.load):
        return "a [control] or a force on a rock, whose stress nothing bounds"
    if scene.has_flow and any(table.pressure is not None for table in scene.fracture.values()):
        return "pressures prescribed along a fracture"
    for well in scene.well if scene.has_flow else ():
        if well.flow_rate is not None:
            into = max(well.flow_rate.values) > 0.0 or well.control is not None
            out = min(well.flow_rate.values) < 0.0 or well.control is not None
            if (into and well.maximum_pressure is None) or (out and well.minimum_pressure is None):
                return f"nothing bounds the pressure at well.{well.name}: give a maximum_pressure or minimum_pressure"
    return ""


def _most(table: TimeTable) -> float:
    return float(np.abs(table.values).max())


def stress_of_loads(scene: Scene, rock: Fractures) -> float:
    """Most that loads, supports and waves add to the initial stress, far from fractures [stress]."""
    found = 0.0
    for load in scene.load:
        if load.pressure is not None:
            found += _most(load.pressure)
        elif isinstance(load.traction, tuple):
            found += hypot(*map(_most, load.traction))
    for support in scene.support:
        moved = sum(map(_most, (support.displacement or {}).values()))
        rows = support.displacement_gradient or ()
        found += rock.modulus * (moved / rock.size + sum(_most(entry) for row in rows for entry in row))
    return found + sum(2.0 * rock.impedance * _most(wave) for each in scene.terms for wave in each.waves)


def pressure_of_wells(scene: Scene, start: Mapping[str, float | Floats]) -> float:
    """Most that wells change the pressure by, from what there was at the ``start`` at the nodes (n,) of each [stress]."""
    found = 0.0
    for well in scene.well if scene.has_flow else ():
        given = [limit for limit in (well.maximum_pressure, well.minimum_pressure) if limit is not None]
        if isinstance(well.pressure, TimeTable):
            given += well.pressure.values
        found = max([found, *(float(np.max(np.abs(value - start[well.name]))) for value in given)])
    return found


def shed(distance: Floats, reach: Floats) -> Floats:
    """Share (n,) of the stress that a crack of half length ``reach`` (n,) sheds, at a distance (n,); infinite at its tip."""
    x = distance + reach
    with np.errstate(divide="ignore"):
        found: Floats = x / np.sqrt(np.maximum(x**2 - reach**2, 0.0)) - 1.0
    return found


def compliance(rock: Fractures, inertia: bool) -> Floats:
    """E'/(k L) of each fracture (f,) by itself, and by what it adds to the rock's compliance."""
    least = np.minimum(rock.length, rock.area / np.maximum(rock.length, NONE))
    least = np.minimum(np.minimum(least, rock.held), rock.probed.min(axis=0, initial=inf))
    if inertia:
        least = np.minimum(least, CELLS * rock.facet / np.pi)
    return rock.modulus / (rock.stiffness * np.maximum(least, NONE))


def together(rock: Fractures) -> Floats:
    """The share of each fracture (m, f), over the rock's own, in the compliance of the rock and in each probe."""
    rooms = np.vstack([rock.held * rock.size, rock.probed * np.maximum(2.0 * rock.probed, rock.length)])
    found: Floats = rock.modulus * rock.length / (rock.stiffness * np.clip(rooms, NONE, rock.area))
    return found


def choose(facts: ReductionInput, rock: Fractures, start: Mapping[str, float | Floats], use: Use) -> LockedFractures:
    """The fractures that may be tied, by whole groups; ``start`` (n,) as in ``pressure_of_wells``. Collective if ``use`` is."""
    scene, groups = facts.scene, len(rock.reach)
    if why := why_none(facts) or ("" if groups else "there are none"):
        return LockedFractures(why=why)
    soft = compliance(rock, scene.has_dynamics)
    kept = np.zeros(groups, dtype=bool)
    kept[rock.group[rock.barred | (soft > facts.tolerance)]] = True
    adds = np.array([np.bincount(rock.group, row, groups) for row in together(rock)])  # (m, g)
    adds[:, kept] = 0.0
    order = np.argsort(adds.max(axis=0), kind="stable")
    kept[order[(np.cumsum(adds[:, order], axis=1) > facts.tolerance).any(axis=0)]] = True
    if kept.all():
        return LockedFractures(why=BARRED, compliance=float(soft.min()))
    loads, fluid = stress_of_loads(scene, rock), pressure_of_wells(scene, start)
    factor = NEARBY * (AT_ONCE if scene.has_dynamics else 1.0)
    while True:
        lost = loads + fluid + float(rock.shear[kept[rock.group]].max(initial=0.0))
        shares = shed(rock.apart[kept], rock.reach[kept, None]).sum(axis=0)
        shares[kept[rock.group]] = 0.0
        stress = factor * (loads + lost * shares)
        found = use(stress)
        fails = ~kept[rock.group] & (found > USE)
        if not fails.any():
            break
        kept[rock.group[fails]] = True
        if kept.all():
            why, use_of = "their strength might not suffice", float(found[fails].min())
            return LockedFractures(why=why, use=use_of, stress=float(stress.min()))
    tied = ~kept[rock.group]
    share = float(rock.jumps[tied].sum() / rock.jumps.sum())
    softest = max(float(soft[tied].max()), float(adds[:, ~kept].sum(axis=1).max()))
    jumps, used = int(rock.jumps[tied].sum()), float(found[tied].max())
    record = LockedFractures((), share, jumps, softest, used, float(stress[tied].max()), "")
    if share < SHARE:
        return replace(record, why=f"they would be {share:.2g} of all jumps, below {SHARE:g}")
    if tied.all() and scene.has_flow:
        return replace(record, why="no fracture would be left for the fluid")
    return replace(record, names=tuple(np.array(rock.names)[tied].tolist()))


def decide_locked(facts: ReductionInput) -> Iterator[Decision]:
    """Whether fractures are locked, and which."""
    shut = facts.locked
    more = len(shut.names) - LISTED
    criterion = "E'/(k L); share of the strength used, under the loads of the scene; share of all jumps"
    if shut.names:
        names = ", ".join(shut.names[:LISTED]) + (f" and {more} more" if more > 0 else "")
        criterion = f"of {names}: {criterion}; no fluid, and nothing of the scene that names them"
    saves = f"{shut.jumps} of the jumps of joints" if shut.names else f"nothing: {shut.why}"
    value = f"{shut.compliance:.2g}; {shut.use:.2g}, by {shut.stress:.3g} of stress; {shut.share:.2g}"
    found = value if not shut.why or shut.share else shut.why
    limit = f"{facts.tolerance:g}; {USE:g}; > {SHARE:g}"
    error = "of displacements and stresses, relative: E'/(k L); their own fields are not written"
    yield Decision(PART, bool(shut.names), criterion, found, limit, error, saves)
