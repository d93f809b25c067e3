"""Element kernels: NumPy only, vectorised, first axis = element, dimension from array shapes."""
