"""Evidence for a learning filter that does not come from the solver.

Each question has its own module, whose docstring begins with the question. The modules receive a
problem and a solution, and nothing else. With the solvers they share only the function for the
singular values of a matrix. :mod:`~ilctools.evidence.certificate` combines the answers that exist
for every filter.
"""
