"""fracflow: fluid flow in systems of deformable fractured rock, after UC SESM 76-5 (Hilber and Taylor, 1976)."""

__version__ = "0.1.0"
