"""Synthesis of the learning filter: the convex problems (39), (45) and (46).

M of (40) is affine in the coefficients of L. A bound on the largest singular value of either is a
linear matrix inequality, one per frequency, and the problems are semidefinite programs.
:mod:`~ilctools.synthesis.design` is the way through. Three modules solve the problems:
`interior_point`, which is fast and the default;
`active_set`, which adds digits to its solution, and is faster still from
that of a similar problem; and :mod:`~ilctools.synthesis.statement`, in CVXPY. None of them is
trusted: what is returned has a certificate.
"""
