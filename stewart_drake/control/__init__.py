"""Controllers and the tuner as pure functions of arrays."""
