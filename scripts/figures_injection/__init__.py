"""Figures of a well in a network of faults: thirty days of pressure and slip, and the events in them."""
