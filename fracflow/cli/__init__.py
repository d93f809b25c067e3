"""The command line."""

from fracflow.cli.app import main

__all__ = ["main"]
