"""Maps of where each method works: measured colour, predicted boundary on top."""
