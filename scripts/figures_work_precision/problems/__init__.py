"""One module a problem or two: what is solved, how its error is known, and the methods that solve it."""

from figures_work_precision.problems import w1, w2, w3, w4, w5, w6, w7, w9, w10

PROBLEMS = (
    w1.PROBLEM,
    w2.PROBLEM,
    w3.PROBLEM,
    w4.PROBLEM,
    *w5.PROBLEMS,
    w6.PROBLEM,
    w7.PROBLEM,
    w9.PROBLEM,
    w10.PROBLEM,
)
