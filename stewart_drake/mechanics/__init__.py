"""Kinematics, force map, dynamics and friction of the closed chain."""
