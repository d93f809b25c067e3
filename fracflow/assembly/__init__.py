"""From element kernels to PETSc operators and residuals."""
