"""Parameters of steppers: fields of their dataclasses that know the key of the scene and the range they must lie in."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any

from fracflow.errors import InputError

RULES = {"above": operator.gt, "at_least": operator.ge, "below": operator.lt, "at_most": operator.le}


def parameter(default: float, key: str, description: str, **limits: float) -> Any:
    """A field that [method] has as ``key``; ``limits`` are above, at_least, below or at_most."""
    return field(default=default, metadata={"key": key, "description": description, "limits": limits})


def check_parameters(stepper: Any) -> None:
    """Raise InputError for a parameter out of its range."""
    for each in fields(stepper):
        value, limits = getattr(stepper, each.name), each.metadata["limits"]
        if not all(RULES[word](value, limit) for word, limit in limits.items()):
            words = " and ".join(f"{word.replace('_', ' ')} {limit:.6g}" for word, limit in limits.items())
            raise InputError(f"{each.metadata['key']} = {value}: must be {words}")


def keys_of(steppers: Mapping[str, type[Any]]) -> dict[str, tuple[Any, str, dict[str, float]]]:
    """Key -> (default, description, limits) of every parameter of ``steppers``."""
    return {
        each.metadata["key"]: (each.default, each.metadata["description"], each.metadata["limits"])
        for kind in steppers.values()
        for each in fields(kind)
    }
