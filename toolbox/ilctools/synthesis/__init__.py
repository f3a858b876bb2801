"""Synthesis of the learning filter: the convex problems (39), (45) and (46).

M of (40) is affine in the coefficients of L. A bound on the largest singular value of either is a
linear matrix inequality, one per frequency, and the problems are semidefinite programs.
:mod:`~ilctools.synthesis.design` is the way through: state the problem, formulate it as a program,
solve that by an interior-point method, and certify the result. The solver is not trusted: what is
returned has a certificate.
"""
