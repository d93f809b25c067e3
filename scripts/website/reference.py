"""Pages made of docstrings, in Markdown: the names for Python, and the equations with links to the code."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from itertools import pairwise
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

import write_pages
from website.pages import ROOT, Page

PACKAGES = ("laws", "integrators", "elements")  # importable parts that laws and rules of one's own are made with
ENTRY = re.compile(
    r"(\S+(?:, \S+)*(?: ->? \S+)?) {2,}(\S.*)"
)  # a line of a table in a docstring: a name, and its meaning
LONGEST = 88  # letters of a signature on one line
NEW = "\n"


def made_pages() -> dict[str, Page]:
    """The pages by path; they stand in the folder ``fracflow``."""
    fracflow = import_module("fracflow")
    texts = {"python": _page("From Python", fracflow, fracflow.__all__)}
    texts["equations"] = equations()
    for name in PACKAGES:
        texts[name] = package_page(f"fracflow.{name}")
    paths = {name: f"fracflow/{name}.md" for name in texts}
    return {paths[name]: Page(paths[name], text, "docstrings") for name, text in texts.items()}


def equations() -> str:
    """The index of equations, each with the line of its code."""
    rows = []
    for entry in write_pages.chosen():
        name, anchor = (f" `{entry.name}`", f"#{entry.name}") if entry.name else ("", "")
        rows.append(f"| {entry.shown} | [{escaped(entry.path)}{name}]({entry.path}{anchor}) | {escaped(entry.line)} |")
    head = "# Equations of the report\n\nEach equation of UC SESM 76-5 stands where it is computed, a few where they are used."
    return "\n".join([head, "", "| equation | place | |", "|---|---|---|", *rows])


def package_page(name: str) -> str:
    """The public names of a package, or of the modules of one that has none of its own."""
    package = import_module(name)
    title = name.rpartition(".")[2].capitalize()
    if hasattr(package, "__all__"):
        return _page(title, package, package.__all__)
    parts = [f"# {title}", described(package)]
    for module in (import_module(f"{name}.{each.name}") for each in iter_modules(package.__path__)):
        parts += [f"## {module.__name__.removeprefix(f'{name}.')}", described(module)]
        ours = [key for key, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        for key in (key for key in ours if not key.startswith("_")):
            parts += _name(getattr(module, key), key, "###")
    return "\n\n".join(parts)


def _page(title: str, module: ModuleType, names: list[str]) -> str:
    """A page of a module: its functions as the source has them, its classes, its tables of names."""
    members = [(name, getattr(module, name)) for name in names if not name.startswith("__")]
    parts = [f"# {title}", described(module)]
    for name, each in sorted((one for one in members if not isinstance(one[1], dict)), key=_place):
        parts += _name(
            each, f"fracflow.{name}" if inspect.isfunction(each) and module.__name__ == "fracflow" else name, "##"
        )
    for name, each in (one for one in members if isinstance(one[1], dict)):
        entries = "\n".join(f'    "{key}": {value.__name__},' for key, value in each.items())
        parts += [
            f"## {name}",
            escaped(_below(module, name)),
            f"```python signature\n{name} = {{{f'{NEW}{entries}{NEW}' if entries else ''}}}\n```",
        ]
    return "\n\n".join(parts)


def _below(module: ModuleType, name: str) -> str:
    """The string below the line that gives a name of a module its value; empty where none stands there."""
    for line, text in pairwise(ast.parse(inspect.getsource(module)).body):
        if isinstance(line, ast.AnnAssign) and ast.unparse(line.target) == name and isinstance(text, ast.Expr):
            return " ".join(str(ast.literal_eval(text.value)).split())
    return ""


def _place(one: tuple[str, Any]) -> tuple[bool, str, int]:
    """Functions before classes, then by file and line; a type that is an alias has no place of its own."""
    each = inspect.unwrap(one[1])
    is_ours = inspect.isfunction(each) or inspect.isclass(each)
    return inspect.isclass(each), each.__module__ if is_ours else "", inspect.getsourcelines(each)[1] if is_ours else 0


def _name(each: Any, name: str, head: str) -> Iterator[str]:
    """Heading, signature, docstring and source of a function or a class, and of the members that the class defines."""
    if not (inspect.isfunction(each) or inspect.isclass(each)):
        return
    yield f"{head} {name}"
    shown = signature(each, name.rpartition(".")[2])
    if shown:
        yield f"```python signature\n{shown}\n```"
    yield described(each)
    source = inspect.getsourcefile(inspect.unwrap(each)) or ""
    path = source.removeprefix(f"{ROOT}/fracflow/")
    if path != source:
        yield f"Source: [{escaped(path)}]({path}#{each.__qualname__})"
    if inspect.isclass(each):
        for key, member in vars(each).items():
            inner = (
                getattr(member, "fget", None) or getattr(member, "func", None) or getattr(member, "__func__", member)
            )
            if key.startswith("_") or not inspect.isfunction(inner) or not inner.__doc__:
                continue
            yield f"{head}# {name}.{key}"
            yield f"```python signature\n{signature(inner, key, inner is not member and not hasattr(member, '__func__'))}\n```"
            yield described(inner)


def signature(each: Any, name: str, is_property: bool = False) -> str:
    """A function as it is called, with types as they are written; a property as its name and type; else nothing.

    A protocol and an error are not called.
    """
    if inspect.isclass(each) and (getattr(each, "_is_protocol", False) or issubclass(each, BaseException)):
        return ""
    found = inspect.signature(each)
    result = written(found.return_annotation)
    if is_property:
        return f"{name}: {result}"
    words = [_parameter(one) for one in found.parameters.values() if one.name not in ("self", "cls")]
    tail = f" -> {result}" if result not in ("", "None") else ""
    line = f"{name}({', '.join(words)}){tail}"
    return line if len(line) <= LONGEST else f"{name}(\n    " + ",\n    ".join(words) + f",\n){tail}"


def _parameter(one: inspect.Parameter) -> str:
    stars = {one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "")
    kind = f": {written(one.annotation)}" if one.annotation is not one.empty else ""
    if one.default is one.empty:
        return f"{stars}{one.name}{kind}"
    value = repr(one.default)
    return f"{stars}{one.name}{kind} = {'...' if value.startswith('<') else value}"


def written(annotation: Any) -> str:
    """A type as the source has it; empty without one."""
    if annotation in (inspect.Signature.empty, None):
        return ""
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation).rpartition(".")[2]


def described(each: Any) -> str:
    """A docstring in Markdown: its tables as tables, its errors at the end."""
    parts = []
    for paragraph in re.split(r"\n\s*\n", inspect.getdoc(each) or ""):
        parts += _paragraph(paragraph)
    return "\n\n".join(sorted(parts, key=lambda part: part.startswith("**Raises**")))


def _paragraph(paragraph: str) -> Iterator[str]:
    lines: list[str] = []
    for line in paragraph.splitlines():
        if line.startswith(" ") and lines:
            lines[-1] += " " + line.strip()
        else:
            lines.append(line.rstrip())
    entries = [ENTRY.fullmatch(line) for line in lines]
    if all(entries):
        rows = [f"| {_in_code(match[1])} | {escaped(match[2])} |" for match in entries if match]
        yield "\n".join(["| name | meaning |", "|---|---|", *rows])
        return
    sentences = re.split(r"(?<=\.) (?=[A-Z])", " ".join(lines))
    errors = [each for each in sentences if each.startswith("Raises")]
    text = " ".join(each for each in sentences if each not in errors)
    if text:
        yield escaped(text)
    for each in errors:
        named = re.sub(r"\b(\w+Error|Interrupted)\b", r"``\1``", each.removeprefix("Raises"))
        yield f"**Raises**{escaped(named)}"


def _in_code(names: str) -> str:
    return ", ".join(f"`{name}`" for name in names.split(", "))


def escaped(text: str) -> str:
    """A docstring's text as Markdown that shows it as it is, code in double backticks aside."""
    parts = re.split(r"(``.*?``)", text)
    return "".join(part if at % 2 else re.sub(r"([\\`*_{}\[\]<>#|~])", r"\\\1", part) for at, part in enumerate(parts))
