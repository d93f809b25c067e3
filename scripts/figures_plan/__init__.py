"""Twin runs: what a scene needs against the same with ``model = "full"``, which leaves nothing out."""
