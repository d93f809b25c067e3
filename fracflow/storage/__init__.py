"""Files as they lie on disk: opened with care, sealed, and whole whatever happens."""
