"""Studies: many scenarios, a row each, and tables of them. Sweeps, comparisons, faults, and the search for gains."""
