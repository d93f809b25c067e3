"""Fields that come from all ranks by slabs: the files that one rank would write of whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from fracflow.mesh import slabs
from fracflow.mesh.slabs import Order, on_rank_0
from fracflow.output.fields import FieldWriter, stored
from fracflow.output.vtkhdf import GRID, VtkHdf
from fracflow.storage.sealed import whole

POINTS, CELLS = 40, 90


@pytest.mark.parametrize("sizes", [(3,), (2, 3, 4)])
def test_files_are_those_of_whole_arrays_to_the_byte(comm, shared_tmp, monkeypatch, sizes):
    # slabs of 7 rows
    monkeypatch.setattr(slabs, "slabs_of", lambda _, shape: [(k, min(k + 7, shape[0])) for k in range(0, shape[0], 7)])
    dice = np.random.default_rng(5)
    cells = dice.integers(0, POINTS, (CELLS, max(sizes)))
    cells[np.arange(max(sizes)) >= dice.choice(sizes, CELLS)[:, None]] = -1
    arrays = stored(
        {"": dice.random((POINTS, 2)), "motion": dice.random((POINTS, 2))},
        {"": cells, "stress": dice.random((CELLS, 3, 3)), "is open": dice.random(CELLS) > 0.5},
    )
    here = {}
    for place, total in (("point", POINTS), ("cell", CELLS)):
        mine = dice.permutation(total)[comm.rank :: comm.size]
        order = Order(comm, mine, total)
        here |= {name: order.of(each[mine]) for name, each in arrays.items() if name.startswith(place)}
    with on_rank_0(comm, here) as found:
        if found is None:
            return
        for folder, given in (("slabs", found), ("whole", {name: whole(each) for name, each in arrays.items()})):
            geometry = [given[f"{place}/"] for place in ("point", "cell")]
            writer = FieldWriter(shared_tmp / folder, "rock", *geometry, {"rocks": ["A"]})
            writer.write_stored(4, 1.5, {name: each for name, each in given.items() if not name.endswith("/")})
            VtkHdf(shared_tmp / folder, [writer, writer])
            again = FieldWriter(shared_tmp / folder, "rock", *geometry, {"rocks": ["A"]}, resume=True)
            assert again.steps == writer.steps and len(again.steps) == 1
        names = ["rock.xdmf", GRID, "fields/rock_mesh.h5", "fields/rock_000004.h5"]
        for name in names:
            assert (shared_tmp / "slabs" / name).read_bytes() == (shared_tmp / "whole" / name).read_bytes(), name
