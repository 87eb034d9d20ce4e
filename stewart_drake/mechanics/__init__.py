"""Kinematics, force map and dynamics of the closed chain, on arrays."""
