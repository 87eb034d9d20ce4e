"""Numbers that the compiled functions share with their references in pure numpy; here once, and free of numba."""

SMALLEST_SINGULAR_VALUE = 1e-13
"""Of M^-1 tau, as a share of the largest; below it the map counts as singular."""
UNSETTLED = 1e-3
"""Relative step of a root after the last iteration above which it counts as not found."""
MEAN_FLOOR = 1e-9
"""Window means below this share of the signal's scale count as zero; the density is 1 there."""
SAME_BRANCH = 1.0 - 1e-6
"""Cosine between a crank and the inverse kinematics of the pose found from it; below, it is the other branch's."""
