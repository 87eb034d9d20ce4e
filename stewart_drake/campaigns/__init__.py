"""Many runs: sweeps, comparisons, the fault table."""
