"""Estimates of a robot from measurements: geometry from poses, bodies and friction from torques."""
