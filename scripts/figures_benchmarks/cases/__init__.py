"""One module a public problem, or some that share their runs: its source, and the runs that are held against it."""

from figures_benchmarks.cases import absorbing, beside, bp6, bp6_rate, known, network, rupture, t_of_two, task_b

BENCHMARKS = (
    t_of_two.BENCHMARK, *known.BENCHMARKS, task_b.BENCHMARK, bp6.BENCHMARK, *bp6_rate.BENCHMARKS, *beside.BENCHMARKS,
    rupture.BENCHMARK, network.BENCHMARK, absorbing.BENCHMARK,
)  # fmt: skip
