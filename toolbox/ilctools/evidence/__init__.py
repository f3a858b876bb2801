"""Evidence about a learning filter, computed independently of the solver.

Each module answers one question, with which its docstring begins. These modules and the solver,
:mod:`ilctools.synthesis.solver`, share only the function for the largest singular values of a
matrix. The synthesis uses the worst case over the plants from :mod:`~ilctools.evidence.robustness`
to find the plants and frequencies that need bounds. :mod:`~ilctools.evidence.certificate` combines
the answers into the certificate of a filter.
"""
