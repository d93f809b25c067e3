"""Programs in processes of their own, started from one that may be a rank."""

from __future__ import annotations

import os

OF_RANKS = ("OMPI_COMM", "OMPI_UNIVERSE", "PMIX", "PMI_")  # beginnings of what mpirun says to its processes


def without_ranks(*more: str) -> dict[str, str]:
    """The environment without what a rank has in it, nor names with ``more`` beginnings: so a child is none, or another's."""
    return {name: value for name, value in os.environ.items() if not name.startswith((*OF_RANKS, *more))}
