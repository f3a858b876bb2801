"""Other learning filters than the paper's, for the same law (23), and one judge for all of them.

Each family in a module of its own: :mod:`proportional`, :mod:`inversion`, :mod:`adjoint`,
:mod:`norm_optimal`, :mod:`preview`. What a design returns is a
:class:`rodlib.filters.LearningOperator`, as a :class:`rodlib.LearningFilter` is: it goes where L
goes, into :func:`rodlib.update`, :func:`rodlib.run_trials`, :func:`rodlib.record` and
:func:`rodlib.converged_noise`. A :class:`Rehearsal` runs the same trials for one after the other,
and :func:`tune` searches the tuning of a design for which they are best.
"""

from rodlib.alternatives.adjoint import gradient
from rodlib.alternatives.inversion import outer_zeros, stable_inversion, zero_phase_inversion
from rodlib.alternatives.norm_optimal import NormOptimal
from rodlib.alternatives.preview import full_information, generalised_plant, h_infinity
from rodlib.alternatives.proportional import p_type, pd_type
from rodlib.alternatives.rehearsal import Rehearsal, lines
from rodlib.alternatives.tuning import Tuned, tune
from rodlib.alternatives.two_sided import TwoSidedFilter, extent, impulse_response

__all__ = [
    "NormOptimal",
    "Rehearsal",
    "Tuned",
    "TwoSidedFilter",
    "extent",
    "full_information",
    "generalised_plant",
    "gradient",
    "h_infinity",
    "impulse_response",
    "lines",
    "outer_zeros",
    "p_type",
    "pd_type",
    "stable_inversion",
    "tune",
    "zero_phase_inversion",
]
