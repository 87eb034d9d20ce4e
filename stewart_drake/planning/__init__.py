"""What a robot can reach and whether a motion can be done."""
