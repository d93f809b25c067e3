"""The preconditioner of large scenes: the intact rock, the jumps across its fractures, and strips of rock along them."""

from fracflow.solve.fractured_rock.preconditioner import FracturedRock, parts_of

__all__ = ["FracturedRock", "parts_of"]
