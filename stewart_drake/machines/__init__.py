"""Real machines, and the simulation as one of them: what they are to whoever drives them, and how they are reached."""
