"""The fault table: faults injected into a running loop, and what the safety layer makes of them."""
