"""The command line."""

from fracflow.cli.main import main

__all__ = ["main"]
