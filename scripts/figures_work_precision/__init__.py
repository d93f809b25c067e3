"""The cost of accuracy of each method: error against CPU seconds and counted work, on problems with a known answer."""
