"""Reachy Mini: its daemon as a machine, its recorded moves and dances. It enters by `base.registry`, as others may."""
