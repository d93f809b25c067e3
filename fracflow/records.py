"""Dataclasses whose methods are written at their first use: most of a run's are never used, and to write all took long."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, **options: Any) -> Any:
        """``dataclasses.dataclass``, put off until an instance, ``fields`` or a class made of this one asks for it."""

        def put_off(cls: type) -> type:
            if "__init__" in cls.__dict__ or "slots" in options:
                return dataclasses.dataclass(**options)(cls)
            cls.__dataclass_fields__ = _Fields(cls, options)

            def __init__(self: Any, *values: Any, **named: Any) -> None:
                cls.__dataclass_fields__  # noqa: B018 - writes the __init__ that comes next
                cls.__init__(self, *values, **named)

            def __setstate__(self: Any, state: dict[str, Any]) -> None:
                cls.__dataclass_fields__  # noqa: B018 - of the first instance, which another rank has sent
                self.__dict__.update(state)

            cls.__init__, cls.__setstate__ = __init__, __setstate__
            return cls

        return put_off if cls is None else put_off(cls)

    class _Fields:
        """In the place of a class's ``__dataclass_fields__`` until they are asked for."""

        def __init__(self, cls: type, options: dict[str, Any]) -> None:
            self.cls, self.options = cls, options

        def __get__(self, instance: object, owner: type) -> dict[str, Any]:
            cls = self.cls
            if cls.__dict__.get("__dataclass_fields__") is self:
                del cls.__dataclass_fields__, cls.__init__, cls.__setstate__
                dataclasses.dataclass(**self.options)(cls)
            return owner.__dataclass_fields__
