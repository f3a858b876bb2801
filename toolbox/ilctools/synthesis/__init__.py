"""Synthesis of the learning filter: the convex problems (39), (45) and (46).

M of (40) is affine in the coefficients of L. A bound on the largest singular value of M or of L is
a linear matrix inequality, one per frequency. The problems are therefore semidefinite programs.
:mod:`~ilctools.synthesis.design` contains all steps: state the problem, formulate a program, solve
the program by an interior-point method, and certify the result. The solver is not trusted: every
result has a certificate.
"""
