"""`scripts/bench large` on a small mesh: its parts, the resume, sliding, and the fit; no times or sizes are asserted."""

import json
import subprocess
import sys
from pathlib import Path

import large
import messages
import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_small_run_in_all_ways(tmp_path):
    found, facts = list[dict](), {}
    clean = without_ranks()
    for ranks, ways in (("2", ["explicit", "resume"]), ("1", ["quasi-static"])):
        words = [
            sys.executable,
            large.__file__,
            "400",
            "--ranks",
            ranks,
            "--steps",
            "8",
            "--out",
            tmp_path,
            "--ways",
            *ways,
        ]
        done = subprocess.run(
            words,
            capture_output=True,
            text=True,
            timeout=200,
            env=clean | {"PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
        )
        assert done.returncode == 0, done.stderr
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        facts |= {line["way"]: line for line in lines if "steps" in line}
        found += [line for line in lines if "part" in line]
    assert facts["explicit"]["steps"] == 5 and facts["resume"]["steps"] == 8 and facts["quasi-static"]["steps"] == 1
    assert all(facts[way]["slipping"] > 0 for way in ("explicit", "quasi-static"))
    assert facts["quasi-static"]["krylov"] > 0  # multigrid
    rows = {(line["way"], line["part"]): line for line in found}
    assert {part for way, part in rows if way == "explicit"} == {*large.PARTS, large.REST, "whole"}
    for way in facts:
        parts = [rows[key]["cpu_s"] for key in rows if key[0] == way and key[1] != "whole"]
        assert rows[way, "whole"]["cpu_s"] == pytest.approx(sum(parts), abs=0.01 * len(parts))
        assert rows[way, "whole"]["cells"] == facts["explicit"]["cells"] and facts[way]["cells"] % 4 == 0
    record = json.loads((tmp_path / "large.json").read_text(encoding="utf-8"))
    assert record["command"].startswith("scripts/bench large 400") and len(record["rows"]) == len(lines) - 2


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_a_saved_mesh(tmp_path):
    words = [sys.executable, large.__file__, "400", "--saved", "--refine", "0", "--ranks", "2", "--steps", "4"]
    words += ["--ways", "explicit", "--out", str(tmp_path)]
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        timeout=200,
        env=without_ranks() | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "network-400.h5").exists()
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    (whole,) = (line for line in lines if line.get("part") == "whole")
    assert whole["ratio"] > 0.0 and whole["cells"] == lines[-2]["cells"] > 400


@pytest.mark.serial
def test_fit():
    rows = [
        {"way": "explicit", "part": "whole", "cells": cells, "ranks": ranks}
        | {"rank0_GB": 0.1 + (1300 * cells / ranks + 17 * cells) / 2**30}
        for cells in (4e5, 1.6e6)
        for ranks in (1, 2, 4)
    ]
    assert large.fitted(rows)["explicit"] == {"c_GB": 0.1, "a": 1300, "b": 17}
    assert large.fitted(rows[:2]) == {}


@pytest.mark.serial
def test_messages_of_each_rank_are_summed_over_those_that_it_sends_to(tmp_path):
    text = "# POINT TO POINT\nE\t{0}\t1\t400 bytes\t7 msgs sent\t1,2\nE\t{0}\t2\t20 bytes\t3 msgs sent\t1,2\n"
    for rank in range(3):
        more = f"# COLLECTIVES\nC\t{rank}\t0\t9 bytes\t1 msgs sent\n"  # which are among those above
        (tmp_path / f"sent.{rank}.prof").write_text(text.format(rank) + more)
    assert messages.sent(tmp_path / "sent") == 3 * [(10, 420)] and not list(tmp_path.iterdir())
