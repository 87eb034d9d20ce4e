"""Controllers against each other: the same motions under the same conditions, one table."""
