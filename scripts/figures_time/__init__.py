"""Figures of stepping in time: what the location of events is worth, and application 5.5 by refinement."""
