"""[site] Where on Earth a scene lies, and when it begins: what a catalogue for seismologists needs."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from fracflow.scene.method import Table
from fracflow.scene.units import LENGTH, Quantity, fault


def instant(text: str) -> datetime:
    """The time of an ISO 8601 text with its zone, in UTC. Raises ValueError."""
    time = datetime.fromisoformat(text[:-1] + "+00:00" if text.endswith("Z") else text)
    if time.tzinfo is None:
        raise ValueError("no zone")
    return time.astimezone(timezone.utc)


def _epoch(text: str) -> str:
    try:
        instant(text)
    except (ValueError, OverflowError):
        raise fault('must be a time with its zone, such as "2026-03-01T08:00:00Z"') from None
    return text


class Site(Table):
    """[site] Where on Earth the origin (0, 0) of the scene lies, and when its time is 0; for fracflow export --quakeml."""

    longitude: Annotated[float, Quantity(at_least=-180.0, at_most=180.0)]
    """of the origin, east positive, WGS 84 [degrees]"""
    latitude: Annotated[float, Quantity(at_least=-89.0, at_most=89.0)]
    """of the origin, north positive, WGS 84 [degrees]"""
    depth: Annotated[float, Quantity(LENGTH)] = 0.0
    """of the origin below sea level, downward positive [length]"""
    azimuth: Annotated[float, Quantity(at_least=-360.0, at_most=360.0)] = 90.0
    """direction of x, clockwise from north [degrees]; 90 is east"""
    plane: Literal["map", "section"] = "map"
    """how the scene lies: a map, with y to the left of x as seen from above; or a vertical section, y upward"""
    epoch: Annotated[str, Field(max_length=40), AfterValidator(_epoch)]
    """when the time of the scene is 0: ISO 8601 with its zone, such as "2026-03-01T08:00:00Z"
    """
