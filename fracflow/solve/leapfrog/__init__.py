"""Explicit steps of rock and joints, each in one sweep through memory; see ``steps.Leapfrog``."""
