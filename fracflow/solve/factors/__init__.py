"""Factorisations of our own, where those of PETSc's packages for sparse matrices are not the best."""
