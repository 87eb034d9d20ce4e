"""The LeafSystems of the loop, one a file: thin shells around the pure modules."""
