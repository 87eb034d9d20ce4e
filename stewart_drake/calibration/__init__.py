"""Lengths, positions and homing offsets of the six legs from poses that were measured from outside."""
