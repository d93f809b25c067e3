"""Files of a run changed by someone who makes their seals anew: only what they hold can give them away."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path

from fracflow.storage.sealed import read_sealed, write_sealed


@contextmanager
def resealed(path: Path):
    """The arrays and attributes of a sealed file, to be changed; it is then written with a seal that fits them."""
    found = read_sealed(path, "is no file of a run")
    arrays, notes = dict(found.arrays), dict(found.notes)
    yield arrays, notes
    write_sealed(path, arrays, notes)


@contextmanager
def changed_notes(path: Path):
    """The notes of a checkpoint, to be changed."""
    with resealed(path) as (_, attributes):
        notes = json.loads(attributes["notes"])
        yield notes
        attributes["notes"] = json.dumps(notes)
