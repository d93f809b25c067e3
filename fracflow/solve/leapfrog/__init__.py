"""Explicit steps of rock without a fluid, each in one sweep through memory; see ``steps.Leapfrog``."""
