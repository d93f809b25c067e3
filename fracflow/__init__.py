"""fracflow: fluid flow in systems of deformable fractured rock, after Hilber & Taylor, UC SESM 76-5 (1976)."""

__version__ = "0.1.0"
