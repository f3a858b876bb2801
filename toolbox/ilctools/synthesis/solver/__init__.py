"""The solver of the convex problems. The certificate checks its results independently."""
