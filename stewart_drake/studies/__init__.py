"""Studies of many runs with a table of results: sweeps, comparisons, faults, and the search for gains."""
