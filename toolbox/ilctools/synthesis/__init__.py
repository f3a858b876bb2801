"""Synthesis of the learning filter: the convex problems (39), (45) and (46) of the paper.

M = Q (I - P L), (40) of the paper, is affine in the coefficients of L. A bound on the largest
singular value of M or of L is a linear matrix inequality at each frequency. The problems are
therefore semidefinite programs. :mod:`~ilctools.synthesis.design` calls all steps: make the
problem, formulate a semidefinite program, solve this program by an interior-point method, and
certify the result. The certificate checks every result without the solver.
"""
