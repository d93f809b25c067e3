"""Unit systems, and scene values that are plain numbers or strings with a unit such as ``"30 GPa"``."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

if TYPE_CHECKING:
    import pint

STRESS = "force/length**2"
COMPRESSIBILITY = "length**2/force"
STIFFNESS = "force/length**3"
DENSITY = "force*time**2/length**4"
WEIGHT = "force/length**3"
VISCOSITY = "force*time/length**2"
VOLUME = "length**3"
FLOW_RATE = "length**3/time"
CONDUCTANCE = "length**5/(force*time)"
INJECTIVITY = "length**5/force/time"
VELOCITY = "length/time"
ACCELERATION = "length/time**2"
RATE = "1/time"
LINE_FORCE = "force/length"
ENERGY = "force*length/length"  # per thickness
SURFACE_ENERGY = "force*length/length**2"
ENERGY_DENSITY = "force*length/length**3"
LENGTH = "length"
AREA = "length**2"
TIME = "time"
ANGLE = "angle"
PLAIN = "1"

EXAMPLES = {
    STRESS: "30 GPa",
    COMPRESSIBILITY: "0.45 1/GPa",
    STIFFNESS: "10 GPa/m",
    DENSITY: "2700 kg/m^3",
    VISCOSITY: "1e-3 Pa s",
    FLOW_RATE: "0.1 m^3/s",
    LINE_FORCE: "1 N/m",
    CONDUCTANCE: "1e-12 m^5/(N s)",
    VELOCITY: "1 mm/s",
    ACCELERATION: "9.81 m/s^2",
    RATE: "0.1 1/s",
    LENGTH: "1 mm",
    AREA: "1e-18 m^2",
    TIME: "10 ms",
    ANGLE: "30 deg",
}
TIME_UNITS = {
    "years": 31557600.0, "days": 86400.0, "h": 3600.0, "min": 60.0, "s": 1.0, "ms": 1e-3, "µs": 1e-6,
}  # fmt: skip
"""Names of units of time -> their seconds."""
_FEWEST = {"years": 2.0, "days": 2.0, "h": 2.0, "min": 3.0, "s": 0.5, "ms": 0.5, "µs": 0.0}  # of a unit of time
TIME_LADDER = tuple((fewest * TIME_UNITS[name], TIME_UNITS[name], name) for name, fewest in _FEWEST.items())
"""Seconds from which on a unit of time is used, its seconds and its name; the longest first."""
USUAL = {
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-06, "µm": 1e-06, "km": 1000.0},
    "s": {
        "s": 1.0,
        "ms": 0.001,
        "us": 1e-06,
        "min": 60.0,
        "h": 3600.0,
        "d": 86400.0,
        "days": 86400.0,
        "years": 31557600.0,
    },
    "N/m**2": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5},
    "m**2/N": {"1/Pa": 1.0, "1/MPa": 1e-06, "1/GPa": 1e-09},
    "N/m**3": {"Pa/m": 1.0, "kPa/m": 1e3, "MPa/m": 1e6, "GPa/m": 1e9, "MPa/mm": 1e9, "N/m^3": 1.0, "kN/m^3": 1e3},
    "N*s**2/m**4": {"kg/m^3": 1.0},
    "N*s/m**2": {"Pa s": 1.0, "mPa s": 0.001},
    "m**3/s": {"m^3/s": 1.0, "L/s": 0.0010000000000000002, "l/s": 0.0010000000000000002},
    "N/m": {"N/m": 1.0, "kN/m": 1e3, "MN/m": 1e6},
    "m/s": {"m/s": 1.0, "mm/s": 0.001, "km/s": 1e3},
    "m/s**2": {"m/s^2": 1.0},
    "m**2": {"m^2": 1.0},
    "degree": {"deg": 1.0},
    "ft": {"ft": 1.0},
    "lbf/ft**2": {"lbf/ft^2": 1.0},
    "lbf/ft**3": {"lbf/ft^3": 1.0},
    "lbf*s**2/ft**4": {"slug/ft^3": 1.0},
    "lbf*s/ft**2": {"lbf s/ft^2": 1.0},
    "ft**3/s": {"ft^3/s": 1.0},
}
"""Factors of usual units to those of SI and of the report, as pint gives them to the last bit: its registry costs more CPU than
a small run."""
DARCYS = {"mD": 9.869233e-16, "D": 9.869233e-13}
"""Factors to m^2 of units whose names mean others in pint: debyes."""
BASE = {
    "lbf/ft**2": 47.88025898033586,
    "ft**2/lbf": 0.02088543423315013,
    "ft/s**2": 0.30479999999999996,
    "lbf*ft": 1.3558179483314006,
    "ft": 0.30479999999999996,
    "lbf*s**2/ft**4": 515.3788183931964,
    "lbf*s/ft**2": 47.88025898033586,
    "lbf/ft**3": 157.08746384624627,
    "s": 1.0,
    "degree": math.pi / 180.0,
}
"""Units of the report -> SI, likewise."""
PARTS = {"[length]": ("m", "ft"), "[force]": ("N", "lbf"), "[time]": ("s",)}
HUGE = 1e100  # beyond it the square of a number may be none; no quantity of the field comes near
LONGEST = 100  # of a number and its unit, as text
_UNIT = re.compile(
    r"(?:1(?=\s*/)|[^\W\d]\w{0,29}(?!\w)|[ ()·°%/]|\*(?!\*)|(?:\^|\*\*) ?[-+]?\d(?:\.\d{1,3})?(?![\d.])(?! *(?:\^|\*\*))){1,40}"
)
_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?")


@cache
def _registry() -> pint.UnitRegistry[Any]:
    """Make the one unit registry; it takes a moment, so only when a string first asks for it."""
    import pint

    return pint.UnitRegistry()


@dataclass(frozen=True)
class UnitSystem:
    """Three units that all others follow from; ``name`` "none" has no units and takes plain numbers only."""

    name: str
    length: str = ""
    force: str = ""
    time: str = ""

    @staticmethod
    def parse(name: object) -> UnitSystem:
        """Read ``"SI"``, ``"none"`` or ``"LENGTH-FORCE-TIME"``; raises ValueError that says what fits."""
        fits = 'use "SI", "none" or LENGTH-FORCE-TIME such as "ft-lbf-s"'
        if name == "none":
            return UnitSystem("none")
        if name == "SI":
            return UnitSystem("SI", "m", "N", "s")
        parts = name.split("-") if isinstance(name, str) else []
        if len(parts) != 3:
            raise ValueError(f"not a unit system; {fits}")
        for part, dimension in zip(parts, ("[length]", "[force]", "[time]"), strict=True):
            try:
                known = part in PARTS[dimension] or (
                    _UNIT.fullmatch(part) is not None and _registry().Quantity(1.0, part).check(dimension)
                )
            except Exception:  # pint raises many kinds, from UndefinedUnitError to TokenError
                known = False
            if not known:
                raise ValueError(f'"{part}" is not a unit of {dimension[1:-1]}; {fits}')
        return UnitSystem(str(name), *parts)

    def unit(self, dimension: str) -> str:
        """Write the unit of a dimension: ``force/length**2`` in ft-lbf-s is ``lbf/ft**2``."""
        names = {"length": self.length, "force": self.force, "time": self.time, "angle": "degree"}
        return re.sub("[a-z]+", lambda word: names[word.group()], dimension)

    def behind(self, dimension: str) -> str:
        """The unit of a dimension to write behind a number, with a blank before it; empty in a system without units."""
        return f" {self.written(dimension)}" if self.length else ""

    def written(self, dimension: str) -> str:
        """The unit of a dimension as scenes write it, N/m^2."""
        return self.unit(dimension).replace("**", "^").replace("*", " ")

    def to_si(self, dimension: str) -> float:
        """Factor that brings a number of this system to SI."""
        if self.name == "SI" and "angle" not in dimension:
            return 1.0
        unit = self.unit(dimension)
        return BASE[unit] if unit in BASE else float(_registry().Quantity(1.0, unit).to_base_units().magnitude)

    def convert(self, text: str, dimension: str) -> float:
        """Turn ``"30 GPa"`` into a number of this system; raises ValueError that says what fits."""
        fits = what_fits(dimension, self)
        match = _NUMBER_AND_UNIT.fullmatch(text) if len(text) <= LONGEST else None
        if match is None:
            raise ValueError(f"must be {fits}")
        if dimension == PLAIN or self.name == "none":
            raise ValueError(f"takes no unit; must be {fits}")
        number, unit = float(match[1]), match[2]
        if unit is None:
            raise ValueError(f"a string needs a unit; must be {fits}")
        if unit.split("/")[0] == "mPa" and dimension in (STRESS, STIFFNESS):
            raise ValueError(f'"{unit}" is a thousandth of a pascal, not a million; did you mean "M{unit[1:]}"?')
        try:
            return number * _factor(unit, self.unit(dimension))
        except TypeError:
            raise ValueError(
                f'"{unit}" is not a unit of {dimension}; must be {fits}{self._meant(unit, dimension)}'
            ) from None
        except LookupError:
            raise ValueError(f'unknown unit "{unit}"; must be {fits}{self._meant(unit, dimension)}') from None

    def _meant(self, unit: str, dimension: str) -> str:
        """A question for a usual unit of the dimension in other capitals, where there is one."""
        names = [*USUAL.get(UnitSystem.parse("SI").unit(dimension), {}), *USUAL.get(self.unit(dimension), {})]
        return next((f'; did you mean "{name}"?' for name in names if name.casefold() == unit.casefold()), "")


def time_unit(text: str) -> str | None:
    """The name of the unit that a time such as "36 h" is written in; None of plain numbers and of units without a name."""
    match = _NUMBER_AND_UNIT.fullmatch(text) if len(text) <= LONGEST else None
    try:
        seconds = _factor(match[2], "s") if match and match[2] else 0.0
    except (LookupError, TypeError):
        return None
    return next((name for name, each in TIME_UNITS.items() if math.isclose(seconds, each)), None)


def stated_time(unit: str | None, seconds: float) -> tuple[float, str] | None:
    """Factor from seconds and name of a unit that the author has chosen, where it suits times of that size."""
    each = TIME_UNITS.get(unit or "")
    return (1.0 / each, str(unit)) if each and 0.1 <= (1.0 + 1e-9) * abs(seconds) / each < 1e4 else None


def suited_time(unit: str, time: float) -> tuple[float, str]:
    """Factor and name of the unit that suits a time, which is in ``unit``; others than seconds stay."""
    fits = ((1.0 / each, name) for least, each, name in TIME_LADDER if abs(time) >= least * (1.0 - 1e-12))
    return next(fits, (1.0, unit)) if unit == "s" and 0.0 < abs(time) < math.inf else (1.0, unit)


def unit_text(dimension: str, units: Mapping[str, str], is_printed: bool = False) -> str:
    """Unit of a dimension, N/m^2, or N/m² in print; empty for plain numbers and scenes without units.

    units  names of length, force and time
    """
    if dimension == PLAIN or not all(units.get(part) for part in ("length", "force", "time")):
        return ""
    signs = {"*": "·" if is_printed else " "}
    signs |= {f"**{n}": "⁰¹²³⁴⁵⁶⁷⁸⁹"[n] if is_printed else f"^{n}" for n in range(10)}
    return "".join({**units, **signs}.get(word, word) for word in re.split(r"(\*\*\d|\*|/)", dimension))


@lru_cache(maxsize=1000)
def _factor(unit: str, target: str) -> float:
    """The factor from one unit to another. Raises LookupError for an unknown one, TypeError for another dimension."""
    if unit in (usual := USUAL.get(target, {})):
        return usual[unit]
    if unit in DARCYS:
        return DARCYS[unit] * _factor("m^2", target)
    import pint

    if not _UNIT.fullmatch(unit):  # pint would work out any arithmetic
        raise LookupError(unit)
    try:
        return float(_registry().Quantity(1.0, _registry().parse_units(unit)).to(target).magnitude)
    except pint.DimensionalityError:
        raise TypeError(unit) from None
    except Exception:  # pint raises many kinds, from UndefinedUnitError to TokenError
        raise LookupError(unit) from None


def example(dimension: str) -> str:
    """A number with a unit of a dimension, such as ``"30 GPa"``."""
    return EXAMPLES.get(dimension) or f"1 {UnitSystem.parse('SI').written(dimension)}"


def what_fits(dimension: str, system: UnitSystem | None) -> str:
    """Say which values a dimension takes, with an example."""
    if dimension == PLAIN or system is None or system.name == "none":
        return "a plain number"
    return f'a number in {system.written(dimension)} or a string such as "{example(dimension)}"'


def fault(text: str, **context: object) -> PydanticCustomError:
    """Make the error that a validator raises; ``key`` in the context names the key inside a table."""
    return PydanticCustomError("fracflow", "{text}", {"text": text, **context})


def system_of(info: ValidationInfo) -> UnitSystem | None:
    """Take the unit system from the validation context, None where a table is built from Python."""
    return info.context.get("units") if isinstance(info.context, dict) else None


def plain(value: Any) -> Any:
    """Turn a value back into what a scene file holds; one with a form of its own has a method ``plain``."""
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    return value.plain() if hasattr(value, "plain") else value


class Annotation:
    """Base of the annotations of scene values: pydantic calls ``read``, writes with ``plain``, documents by ``schema``."""

    def read(self, value: object, info: ValidationInfo) -> Any:
        """The value that a scene file gives. Raises a fault."""
        raise NotImplementedError

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``; the base itself raises NotImplementedError."""
        raise NotImplementedError

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let pydantic read the value with ``read``."""
        writer = core_schema.plain_serializer_function_ser_schema(plain)
        return core_schema.with_info_plain_validator_function(self.read, serialization=writer)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        return self.schema()


@dataclass(frozen=True)
class Quantity(Annotation):
    """Annotation of a scene value: its dimension and the open or closed range it must lie in."""

    dimension: str = PLAIN
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None

    def read(self, value: object, info: ValidationInfo) -> float:
        """Validate a number or a string with unit."""
        system = system_of(info)
        if isinstance(value, str):
            try:
                number = (system or UnitSystem("none")).convert(value, self.dimension)
            except ValueError as error:
                raise fault(str(error)) from None
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise fault(f"must be {what_fits(self.dimension, system)}")
        else:
            number = float(value) if abs(value) <= HUGE else math.inf
        if not abs(number) <= HUGE:
            raise fault(f"must be finite, and at most {HUGE:g}")
        self._check_range(number)
        return number

    def _check_range(self, number: float) -> None:
        rules = (
            ("above", self.above, operator.gt),
            ("at least", self.at_least, operator.ge),
            ("below", self.below, operator.lt),
            ("at most", self.at_most, operator.le),
        )
        if 0.0 in (self.above, self.at_least) and 0.0 < number < 1.0 / HUGE:
            raise fault(f"out of range; must be at least {1.0 / HUGE:g}" + (" or 0" if self.above is None else ""))
        given = [(word, limit, holds) for word, limit, holds in rules if limit is not None]
        if not all(holds(number, limit) for _, limit, holds in given):
            words = " and ".join(f"{word} {limit:g}" for word, limit, _ in given)
            raise fault(f"out of range; must be {words}")

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        limits = {
            "exclusiveMinimum": self.above,
            "minimum": self.at_least,
            "exclusiveMaximum": self.below,
            "maximum": self.at_most,
        }
        return number_schema(self.dimension) | {word: limit for word, limit in limits.items() if limit is not None}


def number_schema(dimension: str) -> dict[str, Any]:
    """JSON schema of a number that may carry its unit; ``scene.editor`` says it in words that an editor knows."""
    if dimension == PLAIN:
        return {"type": "number", "dimension": "1"}
    return {"type": ["number", "string"], "dimension": dimension, "examples": [example(dimension)]}


def list_schema(*entries: Mapping[str, Any]) -> dict[str, Any]:
    """JSON schema of a list with so many entries, such as a point."""
    return {"type": "array", "prefixItems": list(entries), "minItems": len(entries), "maxItems": len(entries)}


def table_schema(keys: Mapping[str, Any], *optional: str) -> dict[str, Any]:
    """JSON schema of a table with these keys, all of which it must have but the ``optional`` ones."""
    required = [key for key in keys if key not in optional]
    return {"type": "object", "properties": dict(keys), "required": required, "additionalProperties": False}
