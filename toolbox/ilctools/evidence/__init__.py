"""Evidence for a learning filter that does not come from the solver.

Each question has a module of its own, which begins with it; a problem and a solution are all that
they are handed, and the function for the singular values of a matrix all that they share with the
solvers. :mod:`~ilctools.evidence.certificate` puts the answers together that every filter has.
"""
