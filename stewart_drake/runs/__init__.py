"""One run of a scenario, and what it leaves."""
