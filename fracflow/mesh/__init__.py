"""From a geometry to distributed blocks: read, split, distribute."""
