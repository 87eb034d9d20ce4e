"""Real and simulated machines behind one interface: over UDP, a serial line, or a user's class."""
