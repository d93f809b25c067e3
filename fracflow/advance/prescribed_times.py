"""Times of tables at which substeps end, and bends that shorten them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable

AT_A_TIME = 1e-12  # of a time: others so near are the same
STEEP = 5e-4  # of a step: a ramp that is shorter is a jump
RISES = 1e-2  # of the spread of its table, at least


@dataclass(frozen=True)
class PrescribedTimes:
    """Times at which the tables of a scene end the substeps of a stage.

    ends    times, ascending, at which parts end
    jumps   those at which the state is taken over anew
    tables  those that may not bend within a part by over ``share`` of their spread
    """

    ends: tuple[float, ...] = ()
    jumps: tuple[float, ...] = ()
    tables: tuple[TimeTable, ...] = ()
    share: float = 1.0

    def is_straight(self, begin: float, end: float) -> bool:
        """Whether no table bends between two times by more than a substep resolves."""
        return end <= begin or all(table.departs(begin, end) <= self.share for table in self.tables)


def prescribed(
    scene: Scene, inertia: bool, splits: bool, share: float | None, filled_in: float = 0.0
) -> PrescribedTimes:
    """For a stage whose steps are cut at jumps where it ``splits``, and to a tolerance where it has a ``share``.

    Steps of the length ``filled_in`` fill fractures. They end at both ends of a ramp that is a jump beside them, since a
    pressure at the end of a step holds in all of it.

    With inertia jumps that are not split at are taken by their means, so that no part has to end there. Without it, jumps
    that are small are no reason for a new beginning.
    """
    jumps = scene.jump_times if splits else ()
    if share is None:
        ramps = {time for table in scene.time_tables for ramp in table.ramps(STEEP * filled_in, RISES) for time in ramp}
        return PrescribedTimes(tuple(sorted({*jumps, *ramps})), jumps)
    seen = tuple(t for t in scene.time_tables if splits or not inertia or not len(t.jumps[0]))
    bends = bends_of(seen, share)
    if not inertia:
        jumps = tuple(time for time in scene.jump_times if time in bends)
    return PrescribedTimes(tuple(sorted({*jumps, *bends})), jumps, seen, share)


def bends_of(tables: Iterable[TimeTable], share: float) -> dict[float, float]:
    """Times at which tables jump or bend by over a share of their spread, and the share by which they do, the largest."""
    found: dict[float, float] = {}
    for table in tables:
        for time, size in table.bends(share).items():
            found[time] = max(size, found.get(time, 0.0))
    return found


def latest(times: Iterable[float], time: float) -> float | None:
    """The latest of some times that is not after ``time``."""
    return max((each for each in times if each <= time + AT_A_TIME * abs(time)), default=None)
