"""python -m fracflow."""

from fracflow.cli import main

main()
