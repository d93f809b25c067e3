"""One step of a run: its parts and events, the solvers it is made with, and what the tables ask of it."""
