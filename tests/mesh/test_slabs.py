"""Arrays of all ranks, written and read by slabs: the file of one rank, and to each rank its rows."""

from __future__ import annotations

import errno
from weakref import finalize

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.mesh.slabs import Order, on_rank_0
from fracflow.output import checkpoint
from fracflow.storage import sealed
from fracflow.storage.sealed import SealedFile, slabs_of, write_sealed, write_slabs

TOTAL = 125_000  # rows, of two slabs and of one
KINDS = {
    "vector": ((TOTAL, 3), "f8"),
    "flag": ((TOTAL, 1), "?"),
    "number": ((TOTAL,), "i8"),
    "none": ((TOTAL, 0), "f8"),
}


@pytest.fixture(params=["mixed", "ascending"])
def arrays(comm, request):
    """The same on all ranks: whole arrays and, of rows dealt out at random, the order; the last has no rank."""
    dice = np.random.default_rng(3)
    whole = {name: (1e3 * dice.random(shape)).astype(kind) for name, (shape, kind) in KINDS.items()}
    for values in whole.values():
        values[-1] = 0
    mine = dice.permutation(TOTAL - 1)[comm.rank :: comm.size]
    mine = np.sort(mine) if request.param == "ascending" else mine
    return whole, Order(comm, mine, TOTAL), mine


def test_a_file_by_slabs_is_that_of_one_rank_to_the_byte(arrays, comm, shared_tmp):
    whole, order, mine = arrays
    kind, shape = whole["vector"].dtype, whole["vector"].shape
    assert len(list(slabs_of(kind, shape))) == 2
    with on_rank_0(comm, {name: order.of(values[mine]) for name, values in whole.items()}) as there:
        assert (there is None) == (comm.rank > 0)
        if there is not None:
            write_slabs(shared_tmp / "slabs.h5", there, {"note": "x"})
    for name, values in whole.items():
        found = order.whole(values[mine])
        assert (found is None) == (comm.rank > 0)
        assert found is None or (found.dtype == values.dtype and np.array_equal(found, values)), name
    if comm.rank == 0:
        write_sealed(shared_tmp / "whole.h5", whole, {"note": "x"})
        assert (shared_tmp / "slabs.h5").read_bytes() == (shared_tmp / "whole.h5").read_bytes()
        file = SealedFile(shared_tmp / "slabs.h5", "is no file of ours")
        assert all(np.array_equal(file.array(name), values) for name, values in whole.items())


class _Computed:
    """Values that count how often they are computed, all of a rank at once; ``alive`` has the names of those there are."""

    def __init__(self, name, values, alive):
        self.name, self.values, self.alive, self.times = name, values, alive, 0
        self.dtype, self.shape = values.dtype, values.shape

    def __getitem__(self, rows):
        assert rows == slice(None)
        self.times += 1
        found = self.values.copy()
        self.alive.add(self.name)
        finalize(found, self.alive.discard, self.name)
        return found


def test_each_rank_computes_an_array_once_in_its_turn(arrays, comm):
    """Also a rank without a row of the first slab, which the others then wait for less; and one array at a time."""
    whole, _, _ = arrays
    mine = np.arange(TOTAL) * comm.size // TOTAL == comm.rank
    order, alive = Order(comm, np.flatnonzero(mine), TOTAL), set()
    here = {name: _Computed(name, whole[name][mine], alive) for name in ("vector", "number")}
    with on_rank_0(comm, {name: order.of(values) for name, values in here.items()}) as there:
        for name, each in (there or {}).items():
            for (first, last), slab in zip(slabs_of(each.kind, each.shape), each.parts, strict=True):
                assert np.array_equal(slab, whole[name][first:last]) and alive == {name}
    assert [each.times for each in here.values()] == [1, 1]


def test_each_rank_is_handed_its_rows(arrays):
    whole, order, mine = arrays
    for name, values in whole.items():
        found = np.zeros_like(values[mine])
        for number, (first, last) in enumerate(slabs_of(values.dtype, values.shape)):
            root = number % order.comm.size
            order.hand_out(values[first:last] if order.comm.rank == root else None, first, last, found, root)
        assert np.array_equal(found, values[mine]), name


@pytest.mark.parametrize("reach", ["all ranks", "rank 0"])
def test_ranks_read_slabs_of_a_large_checkpoint_where_all_reach_it(arrays, comm, shared_tmp, monkeypatch, reach):
    whole, order, mine = arrays
    file, read = None, []
    if comm.rank == 0:
        write_sealed(shared_tmp / "state.h5", whole, {"note": "x"})
        file = SealedFile(shared_tmp / "state.h5", "is no file of ours")
    elif reach == "rank 0":
        monkeypatch.setattr(checkpoint, "SealedFile", lambda *given, ours: SealedFile(shared_tmp / "none", "is none"))
    comm.Barrier()
    monkeypatch.setattr(checkpoint, "SHARED", 0)
    monkeypatch.setattr(SealedFile, "rows", lambda *given, of=SealedFile.rows: read.append(given[1:]) or of(*given))
    saved = checkpoint._SavedArrays(comm, file)
    for name, values in whole.items():
        assert np.array_equal(saved.rows(name, order), values[mine]), name
    slabs = [("vector", *each) for each in slabs_of(whole["vector"].dtype, whole["vector"].shape)]
    readers = comm.size if reach == "all ranks" else 1
    assert [each for each in read if each[0] == "vector"] == slabs[comm.rank :: readers] * (comm.rank < readers)

    monkeypatch.setattr(SealedFile, "rows", lambda self, name, first, last: np.full((last - first, 3), np.nan))
    with pytest.raises(InputError, match="vector has values that are no finite numbers"):
        saved.rows("vector", order)


def test_a_fault_of_rank_0_at_any_slab_leaves_none_waiting(arrays, comm):
    whole, order, mine = arrays
    for reads in range(3):
        fault = None
        try:
            with on_rank_0(comm, {"vector": order.of(whole["vector"][mine])}) as there:
                for count, _ in enumerate(there["vector"].parts if there is not None else ()):
                    if count == reads:
                        raise OSError(errno.ENOSPC, "No space left on device")
        except OSError as error:
            fault = error.errno
        assert comm.bcast(fault, root=0) == (errno.ENOSPC if reads < 2 else None)


@pytest.mark.serial
def test_a_damaged_row_is_named_whichever_slab_it_is_in(tmp_path, arrays):
    whole, _, _ = arrays
    path, place = tmp_path / "a.h5", TOTAL - 5
    write_sealed(path, whole, {})
    bits = whole["vector"][place].tobytes()
    data = path.read_bytes()
    path.write_bytes(data.replace(bits, bytes(len(bits)), 1))
    file, rows = SealedFile(path, "is no file of ours"), sealed.piece_rows("<f8", (TOTAL, 3))
    first = place // rows * rows
    slabs = list(slabs_of(np.dtype("f8"), (TOTAL, 3)))
    file.rows("vector", *slabs[0])
    with pytest.raises(sealed.InputError, match=f"a.h5: vector, rows {first} to {TOTAL - 1}, is not as it was sealed"):
        file.rows("vector", *slabs[1])
