"""What a robot can do, and how far a loop is from instability."""
