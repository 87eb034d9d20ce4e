"""Many runs of one scenario with some of its keys drawn from distributions: one row a run, nothing dropped.

`load_sweep` (spec) reads a sweep, `run_sweep` (runner) runs it where an executor of `executors` says.
"""
