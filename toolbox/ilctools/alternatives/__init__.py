"""Other learning filters than the paper's, for the same law (23), and one judge for all of them.

What a design returns is a :class:`ilctools.filters.LearningOperator`, as a
:class:`ilctools.LearningFilter` is: it goes where L goes. A :class:`Rehearsal` runs the same trials
for one after the other, and :func:`tune` searches the tuning for which they are best.
"""

from ilctools import lazily

MODULES = {
    "inversion": "gradient stable_inversion zero_phase_inversion",
    "norm_optimal": "NormOptimal",
    "preview": "full_information generalised_plant h_infinity",
    "proportional": "p_type pd_type",
    "rehearsal": "Rehearsal Tuned lines tune",
    "two_sided": "TwoSidedFilter extent two_sided_taps",
}

__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
