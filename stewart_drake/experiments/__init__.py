"""Experiments made of many runs: one module each."""
