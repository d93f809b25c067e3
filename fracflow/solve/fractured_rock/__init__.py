"""The preconditioner of large scenes: the intact rock, the jumps across its fractures, and strips of rock along them."""

from fracflow.solve.fractured_rock.preconditioner import FracturedRock

__all__ = ["FracturedRock"]
