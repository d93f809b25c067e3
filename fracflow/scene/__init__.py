"""The scene file, validated, with units."""

from fracflow.scene.scene import Scene, load

__all__ = ["Scene", "load"]
