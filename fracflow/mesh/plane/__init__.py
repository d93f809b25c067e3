"""Parts for the plane only: networks of traces, their near misses and mesh sizes; angles, quads and refinement of cells."""
