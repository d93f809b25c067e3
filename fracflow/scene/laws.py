"""Keys of a fracture's table that the joint laws themselves declare."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from difflib import get_close_matches
from typing import Annotated, Any, Literal

from pydantic import Field

from fracflow.laws import FLOW_LAWS, JOINT_LAWS, Key, keys_of, parameters_of
from fracflow.scene.profiles import Along, Profile
from fracflow.scene.units import Quantity, fault

Property = float | Profile
KEYS: dict[str, dict[str, Key]] = {name: keys_of(law) for name, law in JOINT_LAWS.items()}
FLOW_KEYS: dict[str, dict[str, Key]] = {name: keys_of(law) for name, law in FLOW_LAWS.items()}
OTHERWISE = {"friction_angle_deg": "friction_coefficient"}
"""Keys of a table that stand for one of a law's."""


def known_law(name: str) -> str:
    """The name of a law. Raises a fault for an unknown one, and RuntimeError for one registered too late."""
    if name not in JOINT_LAWS:
        allowed = ", ".join(JOINT_LAWS)
        near = get_close_matches(name, JOINT_LAWS, n=1, cutoff=0.4)
        meant = f'; did you mean "{near[0]}"?' if near else ""
        raise fault(
            f"unknown; allowed: {allowed}{meant}; a law from outside is known only to the script that registers it"
        )
    if name not in KEYS:
        late = "was registered after the keys of scenes were made: register it before"
        raise RuntimeError(f"the joint law {name} {late}")
    return name


def law_fields() -> dict[str, Any]:
    """Name -> (annotation, Field) of all keys that laws declare; None where a table has none of it."""
    found: dict[str, Any] = {}
    declared = KEYS | {f"method.conductance = {law}": keys for law, keys in FLOW_KEYS.items()}
    for name in dict.fromkeys(name for keys in declared.values() for name in keys):
        meanings: dict[str, list[str]] = {}
        for law, keys in declared.items():
            if name in keys:
                meanings.setdefault(keys[name].meaning, []).append(law)
        key = next(keys[name] for keys in declared.values() if name in keys)
        text = "; ".join(f"{meaning} ({', '.join(laws)})" for meaning, laws in meanings.items())
        value = next((defaults(law)[name] for law in KEYS if name in defaults(law)), None)
        if key.choices:
            described = Field(default=None, description=text, json_schema_extra={"default": value})
            found[name] = (Literal[key.choices] | None, described)
            continue
        unit = "" if key.dimension == "1" else f" [{key.dimension}]"
        along = Along(Quantity(key.dimension, **key.limits))
        described = Field(default=None, description=text + unit, json_schema_extra={"default": value})
        found[name] = (Annotated[Property | None, along], described)
    return found


def describe_laws() -> str:
    """A description of each law: the first line of its own documentation."""
    own = {name: law.__doc__ or "" for name, law in JOINT_LAWS.items()}
    # without docstrings, python -OO, a dataclass has its signature there
    known = {name: doc for name, doc in own.items() if doc and not doc.startswith(f"{JOINT_LAWS[name].__name__}(")}
    return "; ".join(f"{name}: {known[name].splitlines()[0].rstrip('.')}" if name in known else name for name in own)


def foreign_keys(law: Any) -> set[str]:
    """Keys of a table that other laws declare, and this one has no use for; none where there is no such law."""
    if not isinstance(law, str) or law not in JOINT_LAWS:
        return set()
    declared = {name for keys in KEYS.values() for name in keys} - set(KEYS[law])
    return declared | {key for key, meant in OTHERWISE.items() if meant in declared}


def defaults(law: str) -> dict[str, float | str]:
    """The defaults of a law's own keys; friction has to be given."""
    given = {field.name: field.default for field in parameters_of(JOINT_LAWS[law]) if field.name in KEYS[law]}
    return {name: v for name, v in given.items() if v is not MISSING and name not in OTHERWISE.values()}


def check(law: str, table: Mapping[str, Any]) -> None:
    """Raise the fault of a table that has too little, too much, or what contradicts itself, for its law."""
    for name in sorted(() if JOINT_LAWS[law].passes_over else foreign_keys(law)):
        if table.get(name) is not None:
            users = ", ".join(each for each, keys in KEYS.items() if OTHERWISE.get(name, name) in keys)
            raise fault(f'is no key of law = "{law}", but of {users}; remove it, or set law', key=name)
    for other, name in OTHERWISE.items():
        if table.get(other) is not None and table.get(name) is not None:
            raise fault(f"contradicts {name}; give one of them", key=other)
    for field in parameters_of(JOINT_LAWS[law]):
        other = next((other for other, meant in OTHERWISE.items() if meant == field.name), "")
        if other and table.get(other) is None and table.get(field.name) is None:
            raise fault(f"missing; give it or {field.name}", key=other)
        if not other and field.default is MISSING and table.get(field.name) is None:
            raise fault(f"missing; the law {law} needs it", key=field.name)


def check_dilation(dilates: bool, has_distance: bool, steepest: float, friction: float) -> None:
    """Raise the fault of a table that does not say over which slip its walls dilate, or whose slip would give energy.

    steepest  largest angle of dilation [degree]
    friction  smallest coefficient of friction: walls that ride up more steeply lift more than friction takes
    """
    if dilates and math.tan(math.radians(steepest)) > friction:
        most = math.degrees(math.atan(friction))
        text = (
            f"must be at most the angle of friction, {most:.3g} degrees: steeper walls would give energy as they slip"
        )
        raise fault(f"out of range; {text}", key="dilation_angle_deg")
    if dilates and not has_distance:
        raise fault("missing; dilation_angle_deg needs it: give the slip that wears the walls", key="dilation_distance")


def check_flow(law: str, table: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Keys of a fracture's table that its flow law needs, or does not know, each with what is wrong."""
    for name in sorted({name for keys in FLOW_KEYS.values() for name in keys} - set(FLOW_KEYS[law])):
        if table.get(name) is not None:
            users = " or ".join(f'"{each}"' for each, keys in FLOW_KEYS.items() if name in keys)
            yield name, f"is a key of method.conductance = {users}; remove it, or set that"
    for field in parameters_of(FLOW_LAWS[law]):
        if field.name in FLOW_KEYS[law] and field.default is MISSING and table.get(field.name) is None:
            yield field.name, f'missing; method.conductance = "{law}" needs it'


def check_order(law: str, values: Mapping[str, Any]) -> None:
    """Raise the fault of a value above one that its law says it may not exceed; ``values`` of the law's own names."""
    for name, key in KEYS[law].items():
        if key.not_above and _exceeds(values[name], values[key.not_above]):
            raise fault(f"must not exceed {key.not_above}; lower it", key=name)


def _exceeds(one: Property, other: Property) -> bool:
    """Whether a value is above another anywhere along the fracture: both are linear between rows."""
    tables = [value for value in (one, other) if isinstance(value, Profile)]
    places = sorted({place for table in tables for place in table.along}) or [0.0]

    def at(value: Property, place: float) -> float:
        return float(value(place)) if isinstance(value, Profile) else value  # type: ignore[arg-type]

    return any(at(one, place) > at(other, place) for place in places)
