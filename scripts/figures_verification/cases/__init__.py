"""One module a reference: its closed form with its source, and the runs that are held against it."""
