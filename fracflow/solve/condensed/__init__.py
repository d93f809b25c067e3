"""The whole nonlinear step on the fractures alone, with the rock condensed to their jumps.

The rock with elastic joints, A = alpha_0 M + K_s + alpha_1 C + G' W D_0 G, is factored once. Nothing that slips, opens or
flows changes A: all of that acts on the rock through the joints alone, u = A^-1 (r - G' q). The jumps are
e = G u_free - G A^-1 G' q, q = W (t(e, p) - t_old - D_0 de). One dense compliance couples jumps and pressures, which Newton's
method of ``sections`` solves for; one more solve with the factors of A recovers the rock. Newton's method on all unknowns then
checks the full balances, and solves the step itself where they do not hold.
"""

from fracflow.solve.condensed.rock import CondensedRock
from fracflow.solve.condensed.step import Condensed

__all__ = ["Condensed", "CondensedRock"]
