"""Meanings of the keys of a scene: the docstrings below them, which are read from the sources when somebody asks."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise
from textwrap import dedent

from pydantic import BaseModel


@cache
def meanings(table: type[BaseModel]) -> Mapping[str, str]:
    """Meaning of each key of a table, on one line; keys without one, and without sources, are left out.

    pydantic would read them at each start of the program, which takes a tenth of a second (``use_attribute_docstrings``).
    """
    below = {key: text for base in reversed(table.__mro__) for key, text in _docstrings(base)}
    given = {key: field.description for key, field in table.model_fields.items() if field.description}
    return {key: " ".join(text.split()) for key, text in {**below, **given}.items() if key in table.model_fields}


def _docstrings(table: type) -> Iterator[tuple[str, str]]:
    """The keys that stand in the source of a class, each with the text below it."""
    if not issubclass(table, BaseModel) or table is BaseModel:
        return
    try:
        source = dedent(inspect.getsource(table))
    except (OSError, TypeError):  # made by a program, or installed without sources
        return
    (found,) = ast.parse(source).body
    assert isinstance(found, ast.ClassDef)
    for key, text in pairwise(found.body):
        if isinstance(key, ast.AnnAssign) and isinstance(key.target, ast.Name) and isinstance(text, ast.Expr):
            if isinstance(text.value, ast.Constant) and isinstance(text.value.value, str):
                yield key.target.id, text.value.value
