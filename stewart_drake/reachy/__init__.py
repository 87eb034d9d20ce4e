"""Reachy Mini: its daemon as a machine, recorded moves and dances, entered in `base.registry` like a user's parts."""
