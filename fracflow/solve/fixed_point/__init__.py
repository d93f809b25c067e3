"""The coupling of the report: rock and fracture flow in turn, by a fixed-point iteration."""
