"""W10: SEAS BP6-QD-A, slow slip by rate-and-state friction on a fault into which fluid spreads, over joints and steps.

The reference is boundary elements of 12.5 m, by the slip law of 6.25 m; see ``figures_benchmarks.cases.bp6_rate``. The error is
the largest of those of slip and potency, half that of the largest rate, and a hundredth of the joints by which the front is
off: 0.01 is what the benchmark's users ask for. By the slip law slip and potency alone are known. Its slip runs farther and
faster, in five times as many steps, and has errors of its own: it is a second problem in the same figure. Its front is L_b/17 =
30 m long and comes to 8.3 km. So its order is that from joints of 100 m to 50 m, on a fault of 18 km.

Most of the error of unmeshed rock is of the joints. The fault of 12 km leaves out what the front does not reach. The default is
rock without sides, as the benchmark has it.
"""

from __future__ import annotations

from figures_benchmarks.benchmark import table_of
from figures_benchmarks.cases.bp6 import HALF
from figures_benchmarks.cases.bp6_rate import FRONT_COLUMN, Ended, ended

from figures_work_precision.problem import Answer, Method, Order, Problem

SHARES = (0.9, 0.4)
OF_RATE, OF_FRONT = 0.5, 0.01
"""Weights of the errors of the largest rate, and of the front in joints."""


def errors(found: Ended, size: float, law: str) -> dict[str, float]:
    """Relative errors, of the front in joints; by observable."""
    if law == "slip":
        right = table_of("bp6_slip_law.csv")
        return {name: abs(getattr(found, name) / right[name][-1] - 1.0) for name in ("slip", "potency")}
    right = table_of("bp6_rate_and_state.csv")
    return {
        "slip": abs(found.slip / right["slip_0_m"][-1] - 1.0),
        "potency": abs(found.potency / right["potency_m2"][-1] - 1.0),
        "rate": abs(found.fastest / right["max_rate_m_per_s"].max() - 1.0),
        "front": abs(found.front - right[FRONT_COLUMN][-1]) / size,
    }


def worst(errors_of: dict[str, float]) -> float:
    """The largest of these errors, by their weights."""
    weights = {"rate": OF_RATE, "front": OF_FRONT}
    return max(weights.get(name, 1.0) * value for name, value in errors_of.items())


def method(
    name: str, size: float, shares: tuple[float, ...] = SHARES, meshed: bool = False, law: str = "ageing",
    half: float = HALF, default: bool = False,
) -> Method:  # fmt: skip
    """A size of joints, by a law of the state, on a fault of two halves [m], with cells or without: its ``worst`` error."""

    def run(share: float) -> Answer:
        found = ended(size, share, meshed, law, half)
        return Answer(worst(errors(found, size, law)), found.seconds)

    return Method(name, run, shares, default=default)


AGEING = ("unmeshed, 200 m", "unmeshed, 100 m")
SLIP = {200.0: "slip law, 200 m", 100.0: "slip law, 100 m", 50.0: "slip law, 50 m"}
FAR = 9000.0  # half of the fault by the slip law [m]
PROBLEM = Problem(
    "W10", "BP6-QD-A: slow slip by rate-and-state friction as fluid spreads", "slip_share",
    "the worst of slip, potency, half the largest rate, the front in hundred joints",
    (
        method("meshed, 100 m", 100.0, meshed=True),
        method(AGEING[0], 200.0),
        method(AGEING[1], 100.0, default=True),
        method("unmeshed, 70 m, fault of 12 km", 70.0, half=6000.0),
        *(method(name, size, (0.9,), law="slip", half=FAR) for size, name in SLIP.items()),
    ),
    0.06,
    orders=(
        Order(*AGEING, level=SHARES[-1], ratio=2.0, least=1.5),
        Order(SLIP[100.0], SLIP[50.0], level=SHARES[0], ratio=2.0, least=1.5),
    ),
)  # fmt: skip
