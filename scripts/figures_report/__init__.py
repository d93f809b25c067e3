"""The report's figures from runs: a module a group, each with ``draw(folder) -> checks``."""
