"""Parts of the rock on which nothing acts that changes: they are in balance from the start, and stay there."""

from __future__ import annotations

from fracflow.reduction.decision import Decision, Facts


def decide_parts(facts: Facts) -> list[Decision]:
    """How many of them there are, and how many are held."""
    parts = facts.parts
    idle = parts.count - parts.loaded
    value = f"{parts.loaded} of {parts.count}" if parts.count > 1 else "all of it is one"
    saves = f"{parts.unknowns} unknowns, which are held" if idle else "nothing: each part is loaded"
    criterion = "parts of the rock that hang together, and carry a load, a support that moves, a wave or a well"
    return [
        Decision("parts of the rock that nothing loads", idle > 0, criterion, value, "all parts", "none: exact", saves)
    ]
