"""The report of a run as one HTML file: its data, its words, its map, its catalogue and the page. Rank 0 only, plain NumPy."""

from fracflow.run_report.page import write_report

__all__ = ["write_report"]
