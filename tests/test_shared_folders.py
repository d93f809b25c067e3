"""A test of all ranks writes the files of its shared folder on rank 0 alone: a second writer empties one under a reader."""

import ast
from pathlib import Path

import pytest

WRITERS = {"write_text", "write_bytes", "copy", "copytree"}


def unguarded(source):
    """Lines of a test of all ranks that write below `shared_tmp` outside a branch that asks for the rank."""
    for test in ast.parse(source).body:
        if not isinstance(test, ast.FunctionDef) or "shared_tmp" not in [argument.arg for argument in test.args.args]:
            continue
        if any(word in ast.unparse(mark) for mark in test.decorator_list for word in ("serial", "starts_ranks")):
            continue
        branches = [node for node in ast.walk(test) if isinstance(node, (ast.If, ast.IfExp))]
        guarded = {id(part) for node in branches if "rank" in ast.unparse(node.test).lower() for part in ast.walk(node)}
        for call in ast.walk(test):
            writes = isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr in WRITERS
            if writes and id(call) not in guarded and "shared_tmp" in ast.unparse(call):
                yield f"{test.name}, line {call.lineno}: {ast.unparse(call)}"


@pytest.mark.serial
def test_one_rank_writes():
    alone = "def test_it(shared_tmp):\n    if comm.rank == 0:\n        (shared_tmp / 'a').write_text('')\n"
    assert not list(unguarded(alone))
    assert len(list(unguarded(alone.replace("comm.rank == 0", "True")))) == 1
    files = Path(__file__).parent.rglob("test_*.py")
    assert not [f"{file.name}: {line}" for file in files for line in unguarded(file.read_text(encoding="utf-8"))]
