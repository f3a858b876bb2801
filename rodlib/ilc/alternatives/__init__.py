"""Other learning filters than the paper's, for the same law (23), and one judge for all of them.

What a design returns is a :class:`rodlib.ilc.filters.LearningOperator`, as a
:class:`rodlib.LearningFilter` is: it goes where L goes. A :class:`Rehearsal` runs the same trials
for one after the other, and :func:`tune` searches the tuning for which they are best.
"""

from rodlib.ilc.alternatives.adjoint import gradient
from rodlib.ilc.alternatives.inversion import stable_inversion, zero_phase_inversion
from rodlib.ilc.alternatives.norm_optimal import NormOptimal
from rodlib.ilc.alternatives.preview import full_information, generalised_plant, h_infinity
from rodlib.ilc.alternatives.proportional import p_type, pd_type
from rodlib.ilc.alternatives.rehearsal import Rehearsal, lines
from rodlib.ilc.alternatives.tuning import Tuned, tune
from rodlib.ilc.alternatives.two_sided import TwoSidedFilter, extent, two_sided_taps

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
    "lines",
    "p_type",
    "pd_type",
    "stable_inversion",
    "tune",
    "two_sided_taps",
    "zero_phase_inversion",
]
