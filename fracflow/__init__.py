"""fracflow: fluid flow in systems of deformable fractured rock, after UC SESM 76-5 (Hilber and Taylor, 1976).

From Python: ``load`` a scene, ``run`` it, or ``open`` the folder of a run. Both ``run`` and ``open`` give a ``Run``.
``converge`` runs a scene on finer meshes and estimates errors.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fracflow._version import __version__

__all__ = [
    "DiskError", "InputError", "Interrupted", "Run", "SolveError", "__version__", "converge", "load", "open", "run",
]  # fmt: skip

if TYPE_CHECKING:
    from fracflow.api import Run, converge, load, open, run
    from fracflow.errors import DiskError, InputError, Interrupted, SolveError


def __getattr__(name: str) -> Any:
    """A user's function, imported when it is first asked for: PETSc is not needed to open a run."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("fracflow.errors" if name[0].isupper() and name != "Run" else "fracflow.api"), name)
