"""The simulated machine around the mechanism: sensors, bus, motors, pushes, and how they fail."""
