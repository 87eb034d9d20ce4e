"""The mathematics of one tick compiled by numba: what the loop needs at a kilohertz, scalar by scalar.

Each function has its reference in pure numpy elsewhere in the package, named in its docstring, and is tested against
it. numba takes half a second to import and some to compile (kept on disk afterwards), so nothing imports this package
before it is needed.
"""
