"""A saved mesh read in slices: each rank reads, numbers, partitions and sends on its own, and none has all of it."""
