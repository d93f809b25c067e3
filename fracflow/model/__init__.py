"""The discrete model of a scene: unknowns, operators, loads, energy, and the state of a run."""
