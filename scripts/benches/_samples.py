"""CPU seconds of ranks without the kernel, by samples of perf: a rank that waits sleeps in the kernel, or polls in Open MPI."""

from __future__ import annotations

import subprocess
from pathlib import Path

RATE = 250  # samples a second
OF_MPI = ("libmpi.", "libmpi_", "libopen-", "libevent", "mca_")


def sampled(words: list[str], out: Path) -> list[str]:
    """A command for mpirun, whose ranks are sampled into ``out`` with their number."""
    record = f'exec perf record -q -e cpu-clock:u -F {RATE} -o "$0.$OMPI_COMM_WORLD_RANK" "$@"'
    return ["bash", "-c", record, str(out), *words]


def seconds(out: Path, ranks: int) -> list[dict[str, float]]:
    """For each rank the "computed_s" and the "messages_s", which Open MPI takes."""
    found = []
    for rank in range(ranks):
        words = ["perf", "report", "-i", f"{out}.{rank}", "--sort", "dso", "--stdio", "-q", "-n"]
        text = subprocess.run(words, check=True, capture_output=True, text=True).stdout
        lines = [line.split() for line in text.splitlines() if line.strip()]
        of = {True: 0, False: 0}
        for _, count, library, *_ in lines:
            of[library.startswith(OF_MPI)] += int(count)
        found.append({"computed_s": round(of[False] / RATE, 1), "messages_s": round(of[True] / RATE, 1)})
    return found
