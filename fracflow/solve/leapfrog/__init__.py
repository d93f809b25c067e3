"""Explicit steps in one sweep through memory: what moves in a step, and the few nodes where more than rock acts."""
