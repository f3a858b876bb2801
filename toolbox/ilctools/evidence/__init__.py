"""Evidence for a learning filter that does not come from the solver.

Each question has its own module, whose docstring begins with the question. These modules and the
solver, :mod:`ilctools.synthesis.solver`, share only the function for the largest singular values of
a matrix. The synthesis takes the worst case over the plants from
:mod:`~ilctools.evidence.robustness`, to find which plants and frequencies need bounds.
:mod:`~ilctools.evidence.certificate` combines the answers that exist for every filter.
"""
