"""Finding, reading and writing files, whole or not at all."""
