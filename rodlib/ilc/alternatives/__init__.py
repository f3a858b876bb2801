"""Other learning filters than the paper's, for the same law (23), and one judge for all of them.

What a design returns is a :class:`rodlib.ilc.filters.LearningOperator`, as a
:class:`rodlib.LearningFilter` is: it goes where L goes. A :class:`Rehearsal` runs the same trials
for one after the other, and :func:`tune` searches the tuning for which they are best.
"""
