"""The run: its stages one after another, its record and its totals, signals, and the same on finer meshes."""
