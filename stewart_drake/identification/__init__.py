"""Masses, inertias, friction and torque constants of a robot from logs of its crank angles and torques."""
