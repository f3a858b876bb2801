"""The solvers of the convex problems, in terms of bounds and multipliers; none is trusted."""
