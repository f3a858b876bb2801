"""The solvers of the convex problems. They know bounds and multipliers; none is trusted."""
