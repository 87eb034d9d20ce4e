"""Data of a run: its log, metrics, outcome and warnings."""
