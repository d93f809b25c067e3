"""Figures of friction that depends on the rate of slip: inertia in an event that injection sets off."""
