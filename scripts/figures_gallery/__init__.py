"""The gallery: each scene of meshes/, before its run and after it."""
